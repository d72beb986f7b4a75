//! Conversion of a table of fixes or reference attitudes from any text dialect to plain CSV.
//!
//! Input: text with column names, by the rules of [`mapping::text`]. If the name of the time column
//! contains a unit, the times are in this unit.
//!
//! Output: CSV with the columns of the recording format.
//!
//! Failure: a missing column is an error, and so is a file without a valid row. Single malformed
//! rows are skipped and counted.

use std::{
    cell::Cell,
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
    rc::Rc,
};

use foreign::ForeignText;
use mapping::{Mapping, text::without_unit};

use crate::{
    ImportError, Note,
    csv_reader::{CsvReader, CsvRecord, RowCounts},
};

const NS_PER_S: u64 = 1_000_000_000;

/// Columns of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Table {
    /// Satellite fixes.
    Fixes,
    /// Reference attitudes.
    Reference,
}

impl Table {
    fn columns(self) -> (&'static [&'static str], &'static [&'static str]) {
        match self {
            Self::Fixes => (&["t_s", "ve", "vn", "vu"], &["lat_deg", "lon_deg", "alt_m"]),
            Self::Reference => (&["t_s", "qw", "qx", "qy", "qz"], &["mov"]),
        }
    }
}

/// Writes the table at `path` to `out` in the recording format.
///
/// # Errors
///
/// Returns an error if the file is not readable, lacks a column or contains no valid row, or if
/// `out` cannot be written.
pub fn convert_table(path: &Path, table: Table, out: &Path) -> Result<Vec<Note>, ImportError> {
    let mut reader = CsvReader::open(path, &Rc::new(Cell::new(0)))?;
    let (required, optional) = table.columns();
    let index_of = |column: &str| reader.names.iter().position(|name| matches(column, name.raw()));
    let missing: Vec<_> = required.iter().copied().filter(|column| index_of(column).is_none()).collect();
    if let Some(target) = missing.first() {
        let known = reader.names.clone();
        return Err(ImportError::UnknownColumn { target, found: (*target).into(), near: None, known });
    }
    let columns = required.iter().chain(optional).filter_map(|column| Some((*column, index_of(column)?)));
    let columns: Vec<(&str, usize)> = columns.collect();
    let time_name = columns.first().and_then(|(_, index)| reader.names.get(*index)).map(ForeignText::raw);
    let names_of = |target: &str| time_name.filter(|_| target == "t").into_iter().collect();
    let units = Mapping::default().with_header_units(names_of, false);
    let digits = units.map(|(mapping, _)| mapping).unwrap_or_default().time_digits();
    let failed = |cause: io::Error| ImportError::TemporaryFolder { cause };
    let mut output = BufWriter::new(File::create(out).map_err(failed)?);
    let header: Vec<&str> = columns.iter().map(|(column, _)| *column).collect();
    writeln!(output, "{}", header.join(",")).map_err(failed)?;
    let mut counts = RowCounts::default();
    loop {
        let row = match reader.next() {
            Ok(None) => break,
            Ok(Some(record)) => row(&record, &columns, digits),
            Err(error) => Err(error),
        };
        match row {
            Ok(row) => {
                counts.add_valid();
                writeln!(output, "{row}").map_err(failed)?;
            }
            Err(error @ ImportError::Malformed { .. }) => counts.add_malformed(error),
            Err(error) => return Err(error),
        }
    }
    output.flush().map_err(failed)?;
    reader.into_notes(counts)
}

/// Returns `true` if `name`, a column name in the file, denotes the recording column `column`.
/// Letter case, underscores and a unit in brackets are ignored.
fn matches(column: &str, name: &str) -> bool {
    let plain = |name: &str| without_unit(name).to_ascii_lowercase().replace('_', "");
    plain(name) == plain(column) || column == "t_s" && Mapping::default().match_rank("t", name).is_some()
}

/// Returns a row in the recording format.
fn row(record: &CsvRecord<'_>, columns: &[(&str, usize)], digits: usize) -> Result<String, ImportError> {
    let mut row = String::new();
    for (column, index) in columns {
        if *column == "t_s" {
            let t_ns = record.time(*index, digits)?.ns();
            let sign = if t_ns < 0 { "-" } else { "" };
            let t_ns = t_ns.unsigned_abs();
            row += &format!("{sign}{}.{:09}", t_ns / NS_PER_S, t_ns % NS_PER_S);
        } else {
            let [number] = record.numbers([*index])?.unwrap_or([f64::NAN]);
            row += &format!(",{number}");
        }
    }
    Ok(row)
}
