//! Which field of a row is what.

use crate::{
    error::{Fault, Position, excerpt},
    input::unquoted,
};
use csv::ByteRecord;
use mapping::names::nearest;

const REQUIRED: [&str; 7] = ["t_s", "gx", "gy", "gz", "ax", "ay", "az"];
const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const FIELD: [&str; 3] = ["mx", "my", "mz"];
const SCORED: &str = "mov";
/// What some spreadsheets put before the text, in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// The header of a recording: indices of fields, from 0.
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

    pub(crate) fn of(names: &[&'static str]) -> Result<Self, Fault> {
        let [time, gx, gy, gz, ax, ay, az] = indices(names, &REQUIRED)?;
        Ok(Self {
            time,
            rate: [gx, gy, gz],
            force: [ax, ay, az],
            field: all_or_none(names, &FIELD)?,
            quaternion: all_or_none(names, &QUATERNION)?,
            scored: names.iter().position(|&name| name == SCORED),
        })
    }
}

/// The names in a header, each of them `known` and there once.
pub(crate) fn names(
    header: &ByteRecord,
    line: u64,
    known: &'static [&'static str],
) -> Result<Vec<&'static str>, (Position, Fault)> {
    let mut names = Vec::with_capacity(header.len());
    for (index, field) in header.iter().enumerate() {
        let field = if index == 0 { field.strip_prefix(BYTE_ORDER_MARK).unwrap_or(field) } else { field };
        let name = name(unquoted(field), known).map_err(|fault| (Position::field(line, index, None), fault))?;
        if let Some(first) = names.iter().position(|&earlier| earlier == name) {
            return Err((Position::field(line, index, Some(name)), Fault::RepeatedColumn { first: first + 1 }));
        }
        names.push(name);
    }
    Ok(names)
}

fn name(field: &[u8], all: &'static [&'static str]) -> Result<&'static str, Fault> {
    let name = str::from_utf8(field).map_err(|_| Fault::value(field, "UTF-8 text"))?;
    if let Some(known) = all.iter().copied().find(|&known| known == name) {
        return Ok(known);
    }
    let near = nearest(name, all.iter().copied());
    Err(Fault::UnknownColumn { found: excerpt(field), near, known: all })
}

fn all_or_none<const N: usize>(
    names: &[&'static str],
    wanted: &'static [&'static str; N],
) -> Result<Option<[usize; N]>, Fault> {
    let any = names.iter().any(|name| wanted.contains(name));
    any.then(|| indices(names, wanted)).transpose()
}

/// Where the names of a group are, all of which must be there.
pub(crate) fn indices<const N: usize>(
    names: &[&'static str],
    wanted: &'static [&'static str; N],
) -> Result<[usize; N], Fault> {
    let missing: Vec<_> = wanted.iter().copied().filter(|name| !names.contains(name)).collect();
    if !missing.is_empty() {
        return Err(Fault::MissingColumns { missing, expected: wanted });
    }
    Ok(wanted.map(|name| names.iter().take_while(|&&other| other != name).count()))
}
