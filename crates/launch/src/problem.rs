//! What is wrong with a file, and how it is shown.

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use std::{fmt, io, ops::Range, path::PathBuf};

/// Why there is no launch.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The file could not be read.
    #[error(
        "reading the launch file {}: {cause}; check that it exists, that this user may read it and that it is UTF-8",
        path.display()
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
    },
    /// The file says something that is not allowed.
    #[error(transparent)]
    Problems(#[from] Problems),
}

/// Everything that is wrong with a launch file, in the order of its lines; displayed as rustc does, without colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Problems {
    pub(crate) file_name: String,
    pub(crate) text: String,
    pub(crate) list: Vec<Problem>,
}

/// One thing that is wrong, and where; spans are in bytes.
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

    /// A name that is not among those allowed.
    pub(crate) fn unknown(span: Range<usize>, title: impl Into<String>, found: &str, allowed: &[&str]) -> Self {
        Self {
            help: nearest(found, allowed).map(|name| format!("did you mean {name:?}?")),
            note: Some(format!("allowed: {}", quoted(allowed))),
            ..Self::new(span, title, "not known here")
        }
    }

    /// What TOML itself refuses.
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
        write!(f, "{}: {}", self.file_name, counted(self.list.len() as u64, "problem"))
    }
}

impl std::error::Error for Problems {}

/// So many of what a noun names, for people: `1 fix`, `2 fixes`.
pub fn counted(count: u64, noun: &str) -> String {
    let ending = match count {
        1 => "",
        _ if noun.ends_with(['x', 's']) => "es",
        _ => "s",
    };
    format!("{count} {noun}{ending}")
}

/// The names as a list in quotes.
pub(crate) fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ")
}

/// The name meant, if one is within a third of its letters or begins so: a unit is easily left off.
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

/// The span cut to the text, at whole characters.
fn within(span: &Range<usize>, text: &str) -> Range<usize> {
    let whole = |index: &usize| text.is_char_boundary(*index);
    let start = (0..=span.start.min(text.len())).rev().find(whole).unwrap_or(0);
    start..(span.end.max(start)..text.len()).find(whole).unwrap_or(text.len())
}
