//! Files that the folder contains after a paper has been reproduced.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{fs, path::Path};

use papers::{Paper, page::INDEX_FILE, picture::Picture, reproduce};

/// Returns the names in a folder, sorted.
fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_part_has_svg_and_page_entry() {
    let folder = tempfile::tempdir().unwrap();
    let mut progress = Vec::new();
    let parts = reproduce(Paper::S1, folder.path(), &mut |done, total| progress.push((done, total))).unwrap();
    let page = fs::read_to_string(folder.path().join(INDEX_FILE)).unwrap();
    let paper_folder = folder.path().join("s1");
    for part in &parts {
        let svg = fs::read_to_string(paper_folder.join(part.name).with_extension("svg")).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{}", part.name);
        assert!(page.contains(&format!("id=\"s1-{}\"", part.name)), "{}", part.name);
    }
    for number in [4, 5, 6, 7, 8, 9, 10] {
        assert!(parts.iter().any(|part| part.name == format!("figure-{number}")), "figure {number}");
    }
    let (done, total) = *progress.last().unwrap();
    assert!(done == total && progress.windows(2).all(|pair| pair[0].0 + 1 == pair[1].0), "{progress:?}");
}

#[test]
fn page_contains_all_papers_without_external_resources() {
    let folder = tempfile::tempdir().unwrap();
    for paper in [Paper::S2, Paper::S1] {
        reproduce(paper, folder.path(), &mut |_, _| {}).unwrap();
    }
    let page = fs::read_to_string(folder.path().join(INDEX_FILE)).unwrap();
    let position = |name: &str| page.find(&format!("<h2 id=\"{name}\"")).unwrap();
    assert!(position("s1") < position("s2"));
    assert!(!page.contains("src=") && !page.contains("<script") && page.contains("default-src 'none'"));
    assert_eq!(files(folder.path()), ["index.html", "s1", "s2"]);
}

#[test]
fn table_display_shows_computed_values() {
    let folder = tempfile::tempdir().unwrap();
    let parts = reproduce(Paper::S1, folder.path(), &mut |_, _| {}).unwrap();
    let table = parts.iter().find(|part| part.name == "table-parameters").unwrap();
    let Picture::Table(table) = &table.picture else { panic!("a table") };
    assert!(table.to_string().contains("25    -0.267949192  -0.267949192"), "{table}");
}

#[test]
fn unwritable_folder_error_names_path_and_option() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let error = reproduce(Paper::S2, file.path(), &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains(&*file.path().to_string_lossy()) && error.contains("--out"), "{error}");
}
