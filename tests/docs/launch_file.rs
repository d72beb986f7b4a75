//! Chapter on the launch file, and `launch.toml` itself. Both are rendered from the declarations of
//! the launch crate.

use std::collections::HashSet;

use launch::{KeyDescription, Launch, SectionDescription};

use super::reference::{self, code, plain, table, wrap, wrap_to};

/// Column at which comments begin in `launch.toml`.
const COMMENT_COLUMN: usize = 24;
/// Maximum width of a line of `launch.toml`, in columns.
const MAX_COLUMNS: usize = 100;
/// Minimum width, in columns, of a comment that begins on the line of its key.
const MIN_COMMENT_COLUMNS: usize = 30;

/// Renders the chapter.
pub(super) fn chapter() -> String {
    let introduction = "This chapter lists every key of `launch.toml`. All keys are optional, except those that are \
        required in their section. Without a launch file, the defaults apply. `plumb config check` reports each \
        invalid key with its line.";
    let mut text = reference::chapter("Launch file", introduction);
    text += "\n    plumb config check\n";
    for section in launch::describe() {
        if section.keys.is_empty() {
            continue;
        }
        // A user-defined stage can have any name.
        let title = header(&section).replace("my-fuser", "NAME");
        text += &format!("\n## {}\n", if title.is_empty() { "Top level" } else { &title });
        if !section.doc.is_empty() {
            text += &format!("\n{}\n", wrap(&with_links(&plain(&section.doc))));
        }
        text += &format!("\n{}", table(["key", "default", "allowed", "meaning"], section.keys.iter().map(row)));
    }
    text
}

fn row(key: &KeyDescription) -> [String; 4] {
    let default = match &key.default {
        Some(default) => code(default),
        None if key.is_required => "required".into(),
        None => "not set".into(),
    };
    let mut meaning: Vec<_> = Some(with_links(&plain(&key.doc))).filter(|doc| !doc.is_empty()).into_iter().collect();
    let explained = key.values.iter().filter(|(_, doc)| !doc.is_empty());
    meaning.extend(explained.map(|(name, doc)| format!("{}: {}", code(&format!("{name:?}")), plain(doc))));
    if !key.conditions.is_empty() {
        let conditions: Vec<_> = key.conditions.iter().map(|condition| code(condition)).collect();
        meaning.push(format!("Only with {}.", conditions.join(" or ")));
    }
    if key.default.is_none() && !key.example.is_empty() {
        meaning.push(format!("Example: {}.", code(key.example)));
    }
    [code(&key.name), default, allowed(key, code), meaning.join(" ")]
}

/// Returns the allowed values of a key: the names, or the range with its unit.
fn allowed(key: &KeyDescription, format_name: impl Fn(&str) -> String) -> String {
    let names: Vec<_> = key.values.iter().map(|(name, _)| format_name(&format!("{name:?}"))).collect();
    let parts = [key.allowed.as_str(), &names.join(", "), key.unit];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ")
}

/// Returns the TOML header of a section; empty for the top level.
fn header(section: &SectionDescription) -> String {
    match (section.path.as_str(), section.is_array) {
        ("", _) => String::new(),
        (path, true) => format!("[[{path}]]"),
        (path, false) => format!("[{path}]"),
    }
}

/// Renders `launch.toml`. Keys that are not set by default are commented out, if they have an
/// example.
pub(super) fn launch_toml() -> String {
    let introduction = "Declaration of everything that runs. Keys that are commented out are not set. Check changes with \
        `plumb config check`. docs/reference/launch-file.md lists every key.";
    let mut text = commented(introduction);
    let (sections, mut explained) = (launch::describe(), HashSet::new());
    for section in &sections {
        let lines = section.keys.iter().filter(|key| key.conditions.is_empty()).filter_map(|key| {
            let value = key.default.as_deref().filter(|_| !section.is_optional || key.example.is_empty());
            let is_set = value.is_some() && !section.is_optional;
            Some((key, value.or(Some(key.example).filter(|example| !example.is_empty()))?, is_set))
        });
        let lines: Vec<_> = lines.collect();
        let is_set = lines.iter().any(|(_, _, is_set)| *is_set);
        if lines.is_empty() {
            continue;
        }
        text.push('\n');
        if !section.doc.is_empty() {
            text += &commented(&section.doc);
            text += &format!("{}{}\n", if is_set { "" } else { "#" }, header(section));
        }
        for (key, value, is_set) in lines {
            // A key that occurs in several sections is explained only in the first of these
            // sections.
            let mut comment = comment(key);
            if !explained.insert((section.is_optional, comment.clone())) {
                comment.clear();
            }
            text += &line(&format!("{} = {value}", key.name), is_set, &comment);
        }
    }
    text
}

fn comment(key: &KeyDescription) -> String {
    let explained = key.values.iter().filter(|(_, doc)| !doc.is_empty());
    let mut parts = vec![key.doc.clone()];
    parts.extend(explained.map(|(name, doc)| format!("{name:?}: {doc}")));
    let is_range = key.allowed.starts_with(|first: char| first.is_ascii_digit() || "-\"".contains(first));
    if parts.len() == 1 && (is_range || !key.values.is_empty()) {
        parts.push(format!("Allowed: {}.", allowed(key, str::to_owned)));
    }
    parts.join(" ").trim().to_owned()
}

/// Returns a line of `launch.toml` with its comment, which may continue on further lines.
fn line(setting: &str, is_set: bool, comment: &str) -> String {
    let prefix = if is_set { "" } else { "#" };
    let mut line = format!("{prefix}{setting}");
    let mut lines = wrap_to(comment, MAX_COLUMNS - COMMENT_COLUMN - 2);
    let width = line.chars().count().max(COMMENT_COLUMN - 1) + 1;
    if width > COMMENT_COLUMN && MAX_COLUMNS > width + 2 + MIN_COMMENT_COLUMNS {
        // The first line of the comment is shorter than the others.
        let first = wrap_to(comment, MAX_COLUMNS - width - 2).lines().next().unwrap_or_default().to_owned();
        let rest = comment.strip_prefix(first.as_str()).unwrap_or_default();
        lines = format!("{first}\n{}", wrap_to(rest, MAX_COLUMNS - COMMENT_COLUMN - 2));
    } else if width > COMMENT_COLUMN {
        lines.insert(0, '\n');
    }
    for (index, comment) in lines.trim_end().lines().enumerate().filter(|(_, comment)| !comment.is_empty()) {
        line += &match index {
            0 => format!("{:width$}# {comment}", "", width = width - line.chars().count()),
            _ => format!("\n{prefix:COMMENT_COLUMN$}# {comment}"),
        };
    }
    line + "\n"
}

fn commented(text: &str) -> String {
    wrap_to(text, MAX_COLUMNS - 2).lines().map(|line| format!("# {line}\n")).collect()
}

/// Replaces names of chapters by links.
fn with_links(text: &str) -> String {
    let link = |word: &str| {
        let end = word.find(".md").map_or(0, |start| start + ".md".len());
        let (path, rest) = word.split_at(end);
        path.strip_prefix("docs/").map_or_else(|| word.to_owned(), |path| format!("[{path}](../{path}){rest}"))
    };
    text.split(' ').map(link).collect::<Vec<_>>().join(" ")
}

#[test]
fn built_in_launch_file_equals_default() {
    let launch = Launch::parse("launch.toml", &launch_toml()).unwrap_or_else(|problems| panic!("{problems}"));
    assert_eq!(launch, Launch::default());
    assert_eq!(launch, Launch::parse("launch.toml", "").unwrap());
}

#[test]
fn comment_continues_below_its_key() {
    let words = "word ".repeat(30);
    let shown = line("key = 1", false, &words);
    let lines: Vec<_> = shown.lines().collect();
    assert!(lines[0].starts_with("#key = 1                # word"), "{shown}");
    assert!(lines[1].starts_with("#                       # word"), "{shown}");
    assert!(lines.iter().all(|line| line.len() <= MAX_COLUMNS), "{shown}");
    assert_eq!(shown.matches("word").count(), 30);
}
