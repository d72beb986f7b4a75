//! Maps the column names of a header to field indices.

use crate::error::{ParseError, Position, excerpt};
use mapping::names::nearest;

const REQUIRED: [&str; 7] = ["t_s", "gx", "gy", "gz", "ax", "ay", "az"];
const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const FIELD: [&str; 3] = ["mx", "my", "mz"];
const SCORED: &str = "mov";

/// Columns of a recording, as field indices from 0.
pub(crate) struct Columns {
    pub(crate) time: usize,
    pub(crate) rate: [usize; 3],
    pub(crate) force: [usize; 3],
    pub(crate) field: Option<[usize; 3]>,
    pub(crate) quaternion: Option<[usize; 4]>,
    pub(crate) scored: Option<usize>,
}

impl Columns {
    pub(crate) const KNOWN: [&str; 15] =
        ["t_s", "gx", "gy", "gz", "ax", "ay", "az", "qw", "qx", "qy", "qz", SCORED, "mx", "my", "mz"];

    pub(crate) fn from_names(names: &[&'static str]) -> Result<Self, ParseError> {
        let [time, gx, gy, gz, ax, ay, az] = group_indices(names, &REQUIRED)?;
        Ok(Self {
            time,
            rate: [gx, gy, gz],
            force: [ax, ay, az],
            field: optional_group(names, &FIELD)?,
            quaternion: optional_group(names, &QUATERNION)?,
            scored: names.iter().position(|&name| name == SCORED),
        })
    }
}

/// Parses a header into column names. Each name must be in `known` and occur only once.
pub(crate) fn parse_header(
    header: &[&str],
    line: u64,
    known: &'static [&'static str],
) -> Result<Vec<&'static str>, (Position, ParseError)> {
    let mut names = Vec::with_capacity(header.len());
    for (index, field) in header.iter().enumerate() {
        let name = known_name(field, known).map_err(|fault| (Position::field(line, index, None), fault))?;
        if let Some(first) = names.iter().position(|&earlier| earlier == name) {
            return Err((Position::field(line, index, Some(name)), ParseError::DuplicateColumn { first: first + 1 }));
        }
        names.push(name);
    }
    Ok(names)
}

fn known_name(name: &str, known: &'static [&'static str]) -> Result<&'static str, ParseError> {
    if let Some(known) = known.iter().copied().find(|&known| known == name) {
        return Ok(known);
    }
    let near = nearest(name, known.iter().copied());
    Err(ParseError::UnknownColumn { found: excerpt(name.as_bytes()), suggestion: near, known })
}

fn optional_group<const N: usize>(
    names: &[&'static str],
    group: &'static [&'static str; N],
) -> Result<Option<[usize; N]>, ParseError> {
    let any = names.iter().any(|name| group.contains(name));
    any.then(|| group_indices(names, group)).transpose()
}

/// Returns the field indices of a group of columns. Every column of the group is required.
pub(crate) fn group_indices<const N: usize>(
    names: &[&'static str],
    group: &'static [&'static str; N],
) -> Result<[usize; N], ParseError> {
    let missing: Vec<_> = group.iter().copied().filter(|name| !names.contains(name)).collect();
    if !missing.is_empty() {
        return Err(ParseError::MissingColumns { missing, expected: group });
    }
    Ok(group.map(|name| names.iter().take_while(|&&other| other != name).count()))
}
