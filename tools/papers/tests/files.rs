//! What is in the folder when a paper has been made.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{fs, path::Path};

use papers::{Paper, make, page::INDEX, picture::Picture};

/// The files of a folder, by name.
fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_part_is_an_svg_and_a_png_and_stands_on_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let mut told = Vec::new();
    let made = make(Paper::S1, folder.path(), &mut |done, of| told.push((done, of))).unwrap();
    let page = fs::read_to_string(folder.path().join(INDEX)).unwrap();
    let own = folder.path().join("s1");
    for part in &made.parts {
        let svg = fs::read_to_string(own.join(part.name).with_extension("svg")).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{}", part.name);
        assert!(page.contains(&format!("id=\"s1-{}\"", part.name)), "{}", part.name);
        match made.without_png {
            Some(ref missing) => assert!(missing.contains("apt-get install"), "{missing}"),
            None => {
                let png = fs::read(own.join(part.name).with_extension("png")).unwrap();
                assert!(png.starts_with(b"\x89PNG\r\n\x1a\n") && png.ends_with(b"IEND\xaeB`\x82"), "{}", part.name);
                // Something is drawn: a picture of one colour is a few hundred bytes.
                assert!(png.len() > 10_000, "{}: {} bytes", part.name, png.len());
            }
        }
    }
    for number in [4, 5, 6, 7, 8, 9, 10] {
        assert!(made.parts.iter().any(|part| part.name == format!("figure-{number}")), "figure {number}");
    }
    let (done, of) = *told.last().unwrap();
    assert!(done == of && told.windows(2).all(|pair| pair[0].0 + 1 == pair[1].0), "{told:?}");
}

#[test]
fn the_page_holds_every_paper_of_its_folder_and_asks_nobody_for_anything() {
    let folder = tempfile::tempdir().unwrap();
    for paper in [Paper::S2, Paper::S1] {
        make(paper, folder.path(), &mut |_, _| {}).unwrap();
    }
    let page = fs::read_to_string(folder.path().join(INDEX)).unwrap();
    let at = |name: &str| page.find(&format!("<h2 id=\"{name}\"")).unwrap();
    assert!(at("s1") < at("s2"));
    assert!(!page.contains("src=") && !page.contains("<script") && page.contains("default-src 'none'"));
    assert_eq!(files(folder.path()), ["index.html", "s1", "s2"]);
}

#[test]
fn a_table_is_told_as_text() {
    let folder = tempfile::tempdir().unwrap();
    let made = make(Paper::S1, folder.path(), &mut |_, _| {}).unwrap();
    let table = made.parts.iter().find(|part| part.name == "table-parameters").unwrap();
    let Picture::Table(table) = &table.picture else { panic!("a table") };
    assert!(table.to_string().contains("25    -0.267949192  -0.267949192"), "{table}");
}

#[test]
fn a_folder_that_cannot_be_is_named() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let error = make(Paper::S2, file.path(), &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains(&*file.path().to_string_lossy()) && error.contains("--out"), "{error}");
}
