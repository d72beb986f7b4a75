//! A recording, row by row.

use std::path::Path;

use crate::{
    columns::Columns,
    error::{Fault, Position, RecordingError},
    table::{Fields, Table},
    time,
};

/// What rounding alone makes of the length of a unit quaternion.
const LENGTH_ERROR: f64 = 4.0 * f64::EPSILON;

/// One sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time on the recording's clock, ns.
    pub t_ns: i64,
    /// Body rate, rad/s, sensor axes; as recorded, so it may be nan or infinite.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s², sensor axes; as recorded, so it may be nan or infinite.
    pub force_m_s2: [f64; 3],
    /// Magnetic field, µT, sensor axes; `None` where the recording has none or any component is nan: no sample at this row.
    pub field_ut: Option<[f64; 3]>,
    /// The true attitude, where the recording has one.
    pub reference: Option<Reference>,
}

/// The attitude a sample is judged by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Unit quaternion w, x, y, z, sensor axes to ENU, dimensionless.
    pub quaternion: [f64; 4],
    /// Whether errors count here: `mov` is 1, or the recording has no such column.
    pub scored: bool,
}

/// The rows of a recording, in its order; ends after the first error.
pub struct Reader(Table<Columns>);

impl Reader {
    /// Opens a recording and reads its header.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Table::open(path, &Columns::KNOWN, Columns::of).map(Self)
    }
}

impl Iterator for Reader {
    type Item = Result<Row, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.0.next(row)
    }
}

fn row(fields: &Fields<'_>, columns: &Columns) -> Result<Row, (Position, Fault)> {
    Ok(Row {
        t_ns: fields.parsed(columns.time, time::EXPECTED, time::parse_ns)?,
        rate_rad_s: fields.numbers(columns.rate)?,
        force_m_s2: fields.numbers(columns.force)?,
        field_ut: field(fields, columns)?,
        reference: reference(fields, columns)?,
    })
}

fn field(fields: &Fields<'_>, columns: &Columns) -> Result<Option<[f64; 3]>, (Position, Fault)> {
    let Some(indices) = columns.field else { return Ok(None) };
    let field = fields.numbers(indices)?;
    Ok((!field.iter().any(|part| part.is_nan())).then_some(field))
}

fn reference(fields: &Fields<'_>, columns: &Columns) -> Result<Option<Reference>, (Position, Fault)> {
    let scored = match columns.scored {
        Some(index) => fields.parsed(index, "0 or 1", flag)?,
        None => true,
    };
    let Some(indices) = columns.quaternion else { return Ok(None) };
    let quaternion = unit(fields.numbers(indices)?);
    Ok(quaternion.map(|quaternion| Reference { quaternion, scored }))
}

/// The quaternion at unit length; none of one that is no rotation.
pub(crate) fn unit(quaternion: [f64; 4]) -> Option<[f64; 4]> {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    let turns = length > 0.0 && length.is_finite();
    // To divide one of unit length by its rounded length would change its last digits at every reading.
    let is_unit = (length - 1.0).abs() <= LENGTH_ERROR;
    turns.then(|| if is_unit { quaternion } else { quaternion.map(|part| part / length) })
}

pub(crate) fn flag(text: &str) -> Option<bool> {
    match text.parse::<f64>() {
        Ok(0.0) => Some(false),
        Ok(1.0) => Some(true),
        _ => None,
    }
}
