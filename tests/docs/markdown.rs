//! Markdown files of the tree, and the parts of Markdown that the tests need.

use std::{collections::HashMap, fs, path::Path};

use super::root;

/// Line of a Markdown text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Line<'t> {
    /// Line outside of code blocks.
    Prose(&'t str),
    /// Opening fence, with the word after it, or closing fence.
    Fence(&'t str),
    /// Line of a code block, without its indentation.
    Code(&'t str),
}

/// Code block.
#[derive(Debug, PartialEq)]
pub(super) struct Block {
    /// File and line.
    pub(super) location: String,
    /// Word after the opening fence; empty for indented blocks and for a fence without a word.
    pub(super) language: String,
    pub(super) text: String,
}

/// Returns the names and texts of all Markdown files of the tree, sorted by name.
///
/// Names are relative to the root. Hidden folders and build folders are skipped.
pub(super) fn files() -> Vec<(String, String)> {
    let mut files = Vec::new();
    collect(root(), &mut files);
    files.sort();
    files
}

fn collect(folder: &Path, files: &mut Vec<(String, String)>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name());
        let is_skipped = name.to_string_lossy().starts_with('.') || name == "target";
        if entry.file_type().unwrap().is_dir() && !is_skipped {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            let name = path.strip_prefix(root()).unwrap().display().to_string();
            files.push((name, fs::read_to_string(&path).unwrap()));
        }
    }
}

/// Classifies each line of a text.
///
/// A code block is fenced, or indented by four spaces after an empty line.
pub(super) fn lines(text: &str) -> Vec<Line<'_>> {
    let (mut is_fenced, mut is_indented, mut was_empty) = (false, false, true);
    let mut classified = Vec::new();
    for line in text.lines() {
        let indented = line.strip_prefix("    ").filter(|_| is_indented || was_empty);
        let kind = match (line.strip_prefix("```"), indented) {
            (Some(language), _) => {
                is_fenced = !is_fenced;
                Line::Fence(language.trim())
            }
            _ if is_fenced => Line::Code(line),
            (None, Some(code)) => Line::Code(code),
            // An indented block continues after empty lines.
            (None, None) if line.is_empty() && is_indented => Line::Code(line),
            (None, None) => Line::Prose(line),
        };
        is_indented = !is_fenced && matches!(kind, Line::Code(_));
        was_empty = line.is_empty();
        classified.push(kind);
    }
    classified
}

/// Returns the code blocks of a file.
pub(super) fn blocks(file: &str, text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let (mut is_fenced, mut is_open) = (false, false);
    for (number, line) in (1..).zip(lines(text)) {
        let mut open = |language: &str| {
            blocks.push(Block { location: format!("{file}:{number}"), language: language.into(), text: String::new() });
        };
        match line {
            Line::Prose(_) => is_open = false,
            Line::Fence(language) => {
                is_fenced = !is_fenced;
                is_open = is_fenced;
                if is_fenced {
                    open(language);
                }
            }
            Line::Code(code) => {
                if !is_open {
                    open("");
                }
                is_open = true;
                if let Some(block) = blocks.last_mut() {
                    block.text += code;
                    block.text.push('\n');
                }
            }
        }
    }
    blocks
}

/// Returns the anchors of the headings of a text, as GitHub creates them.
pub(super) fn anchors(text: &str) -> Vec<String> {
    let mut counts: HashMap<String, usize> = HashMap::new();
    let heading = |line: Line<'_>| match line {
        Line::Prose(line) if line.starts_with('#') => {
            line.trim_start_matches('#').strip_prefix(' ').map(|title| slug(title.trim()))
        }
        _ => None,
    };
    let headings: Vec<_> = lines(text).into_iter().filter_map(heading).collect();
    let unique = |slug: String| {
        let count = counts.entry(slug.clone()).or_default();
        *count += 1;
        if *count == 1 { slug } else { format!("{slug}-{}", *count - 1) }
    };
    headings.into_iter().map(unique).collect()
}

/// Returns the anchor of a heading.
pub(super) fn slug(title: &str) -> String {
    // A link contributes only its text.
    let mut text = String::new();
    let mut rest = title;
    while let Some((before, after)) = rest.split_once("](") {
        text += before;
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    text += rest;
    let is_kept = |letter: &char| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_');
    text.to_lowercase().chars().filter(is_kept).map(|letter| if letter == ' ' { '-' } else { letter }).collect()
}

#[test]
fn code_blocks_are_fenced_or_indented() {
    let text = "a\n    no\n\n    b\n\n    c\nd\n```toml\n    e\n\n```\n```\nf\n```\n";
    let block = |line, language: &str, text: &str| Block {
        location: format!("x.md:{line}"),
        language: language.into(),
        text: text.into(),
    };
    let expected = [block(4, "", "b\n\nc\n"), block(8, "toml", "    e\n\n"), block(12, "", "f\n")];
    assert_eq!(blocks("x.md", text), expected);
}

#[test]
fn anchors_follow_github() {
    let text = "# A `b_c` (d), e\n\n    # no\n## [ingest.sim]\n## See [this](x.md#y) — now\n# Überblick\n# A\n# A\n";
    assert_eq!(anchors(text), ["a-b_c-d-e", "ingestsim", "see-this--now", "überblick", "a", "a-1"]);
}
