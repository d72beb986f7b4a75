//! Reads a recording row by row.

use std::path::Path;

use crate::{
    columns::Columns,
    error::{ParseError, Position, RecordingError},
    table::{Fields, Table},
};

/// Largest deviation of a quaternion's length from 1 that is attributed to rounding.
const LENGTH_ROUNDING: f64 = 4.0 * f64::EPSILON;

/// One sample of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time on the recording's clock, ns.
    pub t_ns: i64,
    /// Body rate, rad/s, sensor axes. Recorded NaN and infinite values are kept.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s², sensor axes. Recorded NaN and infinite values are kept.
    pub force_m_s2: [f64; 3],
    /// Magnetic field, µT, sensor axes. `None` if the columns are missing or any component is NaN.
    pub field_ut: Option<[f64; 3]>,
    /// Reference attitude. `None` if the columns are missing or the quaternion is not a rotation.
    pub reference: Option<Reference>,
}

/// Reference attitude of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Unit quaternion w, x, y, z, sensor axes to ENU, dimensionless.
    pub quaternion: [f64; 4],
    /// `true` if errors are scored at this sample, because `mov` is 1 or the column is missing.
    pub scored: bool,
}

/// Iterator over the rows of a recording, in file order. Ends after the first error.
pub struct Reader(Table<Columns>);

impl Reader {
    /// Opens a recording and parses its header.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened or its header is malformed.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Table::open(path, &Columns::KNOWN, Columns::from_names).map(Self)
    }

    /// Returns the number of the last line if it has been read and has no line end. The file may
    /// then have been cut within its last number.
    pub fn unended_line(&self) -> Option<u64> {
        self.0.unended_line()
    }
}

impl Iterator for Reader {
    type Item = Result<Row, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.0.next(parse_row)
    }
}

fn parse_row(fields: &mut Fields<'_>, columns: &Columns) -> Result<Row, (Position, ParseError)> {
    Ok(Row {
        t_ns: fields.time_ns(columns.time)?,
        rate_rad_s: fields.numbers(columns.rate)?,
        force_m_s2: fields.numbers(columns.force)?,
        field_ut: parse_field(fields, columns)?,
        reference: parse_reference(fields, columns)?,
    })
}

fn parse_field(fields: &mut Fields<'_>, columns: &Columns) -> Result<Option<[f64; 3]>, (Position, ParseError)> {
    let Some(indices) = columns.field else { return Ok(None) };
    let field = fields.numbers(indices)?;
    Ok((!field.iter().any(|part| part.is_nan())).then_some(field))
}

fn parse_reference(fields: &mut Fields<'_>, columns: &Columns) -> Result<Option<Reference>, (Position, ParseError)> {
    let scored = match columns.scored {
        Some(index) => fields.flag(index)?,
        None => true,
    };
    let Some(indices) = columns.quaternion else { return Ok(None) };
    let quaternion = normalized(fields.numbers(indices)?);
    Ok(quaternion.map(|quaternion| Reference { quaternion, scored }))
}

/// Returns the quaternion scaled to unit length, or `None` if its length is zero, infinite or NaN.
pub(crate) fn normalized(quaternion: [f64; 4]) -> Option<[f64; 4]> {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    let is_rotation = length > 0.0 && length.is_finite();
    // If the length differs from 1 only by rounding, dividing by it would change the last digits
    // every time the recording is written and read.
    let is_unit = (length - 1.0).abs() <= LENGTH_ROUNDING;
    is_rotation.then(|| if is_unit { quaternion } else { quaternion.map(|part| part / length) })
}
