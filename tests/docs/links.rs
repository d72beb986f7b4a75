//! Links of the Markdown files: each file and each anchor exists.

use std::{collections::HashMap, fs, path::Path};

use super::{
    markdown::{self, Line},
    root,
};

/// Beginnings of links to other hosts, which are not checked.
const EXTERNAL: [&str; 3] = ["https://", "http://", "mailto:"];

/// Returns the targets of all links and images of a text, with their line numbers.
fn targets(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in (1..).zip(markdown::lines(text)) {
        let Line::Prose(line) = line else { continue };
        let line = without_code(line);
        let inline = line.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
        let attributes = ["href=\"", "src=\"", "srcset=\""].into_iter().flat_map(|name| line.split(name).skip(1));
        let html = attributes.filter_map(|rest| rest.split_once('"'));
        let definition = line.starts_with('[').then(|| line.split_once("]: ")).flatten();
        let all = inline.map(|(target, _)| target).chain(html.map(|(target, _)| target));
        for target in all.chain(definition.map(|(_, target)| target)) {
            // A title may follow the target.
            found.push((number, target.split(' ').next().unwrap_or_default().to_owned()));
        }
    }
    found
}

/// Removes inline code from a line.
fn without_code(line: &str) -> String {
    let (mut text, mut rest) = (String::new(), line);
    while let Some(start) = rest.find('`') {
        let ticks = rest[start..].chars().take_while(|letter| *letter == '`').count();
        let (before, code) = (&rest[..start], &rest[start + ticks..]);
        let Some(end) = code.find(&"`".repeat(ticks)) else { break };
        text += before;
        rest = &code[end + ticks..];
    }
    text + rest
}

/// Describes why a link in `file` is broken, or returns `None` if the link's target exists.
fn link_fault(file: &str, target: &str, anchors: &HashMap<String, Vec<String>>) -> Option<String> {
    if EXTERNAL.iter().any(|scheme| target.starts_with(scheme)) {
        return None;
    }
    let (path, anchor) = target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    if path.starts_with('/') {
        return Some("is not relative".into());
    }
    let folder = root().join(file).parent().map(Path::to_owned).unwrap_or_default();
    let linked = if path.is_empty() { root().join(file) } else { folder.join(path) };
    let Ok(linked) = fs::canonicalize(&linked) else { return Some("does not exist".into()) };
    let root = fs::canonicalize(root()).unwrap();
    let Ok(name) = linked.strip_prefix(&root) else { return Some("is outside of the tree".into()) };
    let anchor = anchor?;
    match anchors.get(&name.display().to_string()) {
        Some(anchors) if anchors.iter().any(|known| known == anchor) => None,
        Some(_) => Some(format!("has no heading with the anchor #{anchor}")),
        None => Some("has an anchor, but is not a Markdown file".into()),
    }
}

#[test]
fn links_and_anchors_resolve() {
    let files = markdown::files();
    let anchors = files.iter().map(|(file, text)| (file.clone(), markdown::anchors(text))).collect();
    let (mut faults, mut count) = (Vec::new(), 0);
    for (file, text) in &files {
        for (line, target) in targets(text) {
            count += 1;
            faults.extend(link_fault(file, &target, &anchors).map(|fault| format!("{file}:{line}: {target} {fault}")));
        }
    }
    assert!(faults.is_empty(), "{} broken links:\n{}", faults.len(), faults.join("\n"));
    assert!(count > 100, "{count} links");
}

#[test]
fn index_links_every_chapter() {
    let files = markdown::files();
    let index = files.iter().find(|(file, _)| file == "docs/README.md").map(|(_, text)| targets(text));
    let index = index.expect("docs/README.md lists the chapters");
    let is_linked = |name: &str| index.iter().any(|(_, target)| target.split('#').next() == Some(name));
    let chapters = files.iter().filter_map(|(file, _)| file.strip_prefix("docs/"));
    let missing: Vec<_> = chapters.filter(|name| *name != "README.md" && !is_linked(name)).collect();
    assert!(missing.is_empty(), "docs/README.md does not link {missing:?}");
}

#[test]
fn targets_finds_links_outside_of_code() {
    let text = "[`a](x)`](b.md#c) ![d](e.svg \"f\")\n    [g](h.md) `[i](j.md)`\n<img src=\"k.png\">\n[l]: m.md\n\n    [n](o.md)\n";
    let found: Vec<_> = targets(text).into_iter().map(|(line, target)| format!("{line} {target}")).collect();
    assert_eq!(found, ["1 b.md#c", "1 e.svg", "2 h.md", "3 k.png", "4 m.md"]);
}
