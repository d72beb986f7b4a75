//! Problems of a launch file, and their display.

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use foreign::ForeignText;
use mapping::names::nearest;
use std::{fmt, io, ops::Range, path::PathBuf};

/// Error when reading a launch file.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The file could not be read.
    #[error(
        "reading the launch file {}: {cause}; check that it exists, is readable by this user and is UTF-8",
        foreign::path(path)
    )]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The file contains invalid entries.
    #[error(transparent)]
    Problems(#[from] Problems),
}

/// All problems of a launch file, in line order. They are displayed in the style of rustc errors,
/// without colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Problems {
    pub(crate) file_name: ForeignText,
    pub(crate) text: String,
    pub(crate) list: Vec<Problem>,
}

/// Problem with its location. Spans are byte ranges.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Problem {
    pub(crate) title: String,
    pub(crate) span: Range<usize>,
    pub(crate) label: String,
    pub(crate) context: Option<(Range<usize>, String)>,
    pub(crate) help: Option<String>,
    pub(crate) note: Option<String>,
}

impl Problem {
    pub(crate) fn new(span: Range<usize>, title: impl Into<String>, label: impl Into<String>) -> Self {
        Self { title: title.into(), span, label: label.into(), context: None, help: None, note: None }
    }

    /// Creates a problem that reports an unknown name, with a suggestion and the allowed names.
    pub(crate) fn unknown(span: Range<usize>, title: impl Into<String>, found: &str, allowed: &[&str]) -> Self {
        Self {
            help: nearest(found, allowed.iter().copied()).map(|name| format!("did you mean {name:?}?")),
            note: Some(format!("allowed: {}", quoted(allowed))),
            ..Self::new(span, title, "not known here")
        }
    }

    /// Creates the problem of a TOML syntax error.
    pub(crate) fn syntax(error: &toml::de::Error, text: &str) -> Self {
        let (what, label) = match error.message().split_once(", expected ") {
            Some((what, expected)) => (what, format!("expected {expected}")),
            None => (error.message(), "here".into()),
        };
        Self::new(error.span().unwrap_or(text.len()..text.len()), format!("not valid TOML: {what}"), label)
    }

    fn render(&self, file_name: &str, text: &str) -> String {
        // The title, the labels and the hints can quote the file.
        let escaped = |text: &String| ForeignText::from(text.as_str()).to_string();
        let [title, label] = [&self.title, &self.label].map(escaped);
        let [help, note] = [&self.help, &self.note].map(|hint| hint.as_ref().map(escaped));
        // The renderer shows lines of the file. The replacements keep the length of the text, so
        // that the spans remain valid.
        let text = &*foreign::masked(&text.replace("\r\n", " \n"));
        let primary = AnnotationKind::Primary.span(within(&self.span, text)).label(label);
        let context = self
            .context
            .iter()
            .map(|(span, label)| AnnotationKind::Context.span(within(span, text)).label(escaped(label)));
        let report = Level::ERROR
            .primary_title(title)
            .element(Snippet::source(text).path(file_name).annotation(primary).annotations(context))
            .elements(help.iter().map(|help| Level::HELP.message(help)))
            .elements(note.iter().map(|note| Level::NOTE.message(note)));
        Renderer::plain().render(&[report])
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.list {
            writeln!(f, "{}\n", problem.render(&self.file_name.to_string(), &self.text))?;
        }
        write!(f, "{}: {}", self.file_name, pluralize(self.list.len() as u64, "problem"))
    }
}

impl std::error::Error for Problems {}

/// Formats a count with its noun: `1 fix`, `2 fixes`.
pub fn pluralize(count: u64, noun: &str) -> String {
    let ending = match count {
        1 => "",
        _ if noun.ends_with(['x', 's']) => "es",
        _ => "s",
    };
    format!("{count} {noun}{ending}")
}

/// Formats names as a comma-separated list, each name in quotes.
pub(crate) fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ")
}

/// Clamps a span to the text and extends it to character boundaries.
fn within(span: &Range<usize>, text: &str) -> Range<usize> {
    let is_boundary = |index: &usize| text.is_char_boundary(*index);
    let start = (0..=span.start.min(text.len())).rev().find(is_boundary).unwrap_or(0);
    start..(span.end.max(start)..text.len()).find(is_boundary).unwrap_or(text.len())
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    #[test]
    fn problems_of_hostile_launch_file_are_escaped() {
        let text = r#"
            "a\u001b[2J\nforged" = 1
            services = ["b\u001b[2J\nforged"]
            [fuser]
            stage = "c\u001b[2J\nforged"
            [stages."d\u001b[2J\nforged"]
            slot = "fuser"
            command = ["e\u001b[2J\nforged"]
            [gateway]
            connect = ["f\u001b[2J\nforged"]
        "#;
        for (file_name, text) in [("launch\x1b[2J\nforged", text), ("launch.toml", "a\x1b[2J\u{9b}2J = \u{202e}\r")] {
            let shown = Launch::parse(file_name, text).unwrap_err().to_string();
            let is_control = |letter: char| letter.is_control() && letter != '\n' || letter == '\u{202e}';
            assert!(!shown.contains(is_control), "{shown:?}");
            assert!(!shown.lines().any(|line| line.trim_start().starts_with("forged")), "{shown}");
        }
    }
}
