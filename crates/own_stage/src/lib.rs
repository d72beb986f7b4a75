//! Stages of the user's own: what a program in another language needs, and a stage to begin with.
//!
//! Input: the layouts of the messages, a name. Output: a C header, a Python module, the files of a stage. Time: none. Failure: a
//! folder that is not empty is left as it is.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`c`] | the messages as a C header |
//! | [`python`] | the messages as `ctypes`, and the package that runs a stage |
//! | [`template`] | a working stage with a test, to be changed |
//! | [`trial`] | what a program does as a stage of a running system: the checks |
#![forbid(unsafe_code)]

pub mod c;
pub mod python;
pub mod template;
pub mod trial;

use messages::{Field, Header, Layout};

/// The words that stand for numbers in messages, by what they are about: charts, course references, states, services.
fn constants() -> Vec<(&'static str, Vec<(String, u64)>)> {
    use messages::{Chart, CourseReference, State};
    let of = |names: &[(&str, u64)]| names.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let services = launch::Service::ALL.iter().map(|service| (service.name().to_uppercase(), *service as u64));
    vec![
        ("CHART", of(&[("UPRIGHT", Chart::UPRIGHT.0), ("INVERTED", Chart::INVERTED.0)])),
        (
            "COURSE",
            of(&[
                ("ARBITRARY", CourseReference::ARBITRARY.0),
                ("MAGNETIC", CourseReference::MAGNETIC.0),
                ("TRUE", CourseReference::TRUE.0),
            ]),
        ),
        (
            "STATE",
            of(&[
                ("READY", State::READY.0.into()),
                ("RUNNING", State::RUNNING.0.into()),
                ("FINISHED", State::FINISHED.0.into()),
            ]),
        ),
        ("SERVICE", services.collect()),
    ]
}

/// Every flag: its name as a constant, and its bit.
fn flags() -> impl Iterator<Item = (String, u32)> {
    let constant = |name: &str| name.to_uppercase().replace('-', "_");
    messages::Flags::NAMES.iter().map(move |(flag, name)| (constant(name), flag.0.trailing_zeros()))
}

/// The header, then every topic's payload.
fn structs() -> Vec<Layout> {
    [vec![Header::layout()], messages::layouts()].concat()
}

/// `ImuSample` of `plumbline.ImuSample.1`.
fn class_name(layout: &Layout) -> &'static str {
    layout.name.split('.').nth(1).unwrap_or(layout.name)
}

/// What a field holds: a number, or so many.
struct Kind {
    scalar: &'static str,
    count: Option<usize>,
}

fn kind(field: &Field) -> Kind {
    let (scalar, count) = match field.kind.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')?.split_once("; ")) {
        Some((scalar, "CHECKPOINT_WORDS")) => (scalar, Some(messages::CHECKPOINT_WORDS)),
        Some((scalar, count)) => (scalar, count.parse().ok()),
        None => (field.kind, None),
    };
    let scalar = match scalar {
        "Flags" | "Chart" | "CourseReference" => "u64",
        "State" => "u32",
        scalar => scalar,
    };
    Kind { scalar, count }
}

/// A comment without the brackets of a link.
fn plain(about: &str) -> String {
    about.replace(['[', ']', '`'], "")
}
