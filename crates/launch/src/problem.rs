//! Problems of a launch file, and their display.

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use std::{fmt, io, ops::Range, path::PathBuf};

/// Error when reading a launch file.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The file could not be read.
    #[error(
        "reading the launch file {}: {cause}; check that it exists, is readable by this user and is UTF-8",
        path.display()
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

/// All problems of a launch file in the order of its lines, displayed like those of rustc, without
/// colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Problems {
    pub(crate) file_name: String,
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
            help: nearest(found, allowed).map(|name| format!("did you mean {name:?}?")),
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
        let primary = AnnotationKind::Primary.span(within(&self.span, text)).label(&self.label);
        let context =
            self.context.iter().map(|(span, label)| AnnotationKind::Context.span(within(span, text)).label(label));
        let report = Level::ERROR
            .primary_title(&self.title)
            .element(Snippet::source(text).path(file_name).annotation(primary).annotations(context))
            .elements(self.help.iter().map(|help| Level::HELP.message(help)))
            .elements(self.note.iter().map(|note| Level::NOTE.message(note)));
        Renderer::plain().render(&[report])
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.list {
            writeln!(f, "{}\n", problem.render(&self.file_name, &self.text))?;
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

/// Returns the allowed name most similar to `found`, if any.
///
/// A name is similar if it differs in at most a third of its letters. A name that begins with
/// `found` is also similar, because a unit suffix is easily forgotten.
pub fn nearest<'a>(found: &str, allowed: &[&'a str]) -> Option<&'a str> {
    let found = found.to_lowercase();
    let close = |name: &str, edits: usize| edits <= name.len().max(found.len()).max(3) / 3;
    allowed
        .iter()
        .map(|&name| (strsim::damerau_levenshtein(&found, name), name))
        .filter(|&(edits, name)| close(name, edits) || (!found.is_empty() && name.starts_with(&found)))
        .min_by_key(|&(edits, _)| edits)
        .map(|(_, name)| name)
}

/// Clamps a span to the text and extends it to character boundaries.
fn within(span: &Range<usize>, text: &str) -> Range<usize> {
    let is_boundary = |index: &usize| text.is_char_boundary(*index);
    let start = (0..=span.start.min(text.len())).rev().find(is_boundary).unwrap_or(0);
    start..(span.end.max(start)..text.len()).find(is_boundary).unwrap_or(text.len())
}
