//! Lines of numbers such as `t,gx,gy,gz,ax,ay,az`, printed by a microcontroller or taken from a
//! recording.
//!
//! A [`Mapping`] assigns columns, units and axes, with the same syntax as `plumb import`. Column
//! names come from the settings or from a line of the stream that contains all mapped names. Such a
//! header may appear at the start or later, also as a comment. The `t_s` column of a recording is a
//! time in s. Units may be part of the names, as in `gyro_x (deg/s)`, or be in the line after the
//! names. They apply unless the settings name others. A line with contradictory or missing units is
//! ignored.
//!
//! A line ends with a newline, a carriage return or both. The rules for comments, separators,
//! numbers and times are those of files ([`mapping::text`]). Blank lines and comments are counted
//! and otherwise ignored.
//!
//! | column | meaning |
//! | --- | --- |
//! | `gx`, `gy`, `gz`; `ax`, `ay`, `az` | rate and force, mandatory. Blank and `nan` become NaN; a line in which all six are NaN yields no IMU measurement |
//! | `mx`, `my`, `mz` | magnetic field, in lines in which all three are finite |
//! | `ve`, `vn`, `vu` or `vd`, `lat`, `lon`, `alt` | fix, in lines in which the velocity is finite and the fix differs from the previous one |
//! | `t` | time: UNIX time if later than 2001-09-09 or a date, else time since the device's start (two's complement if negative); a wrapping counter if `time_bits` is set or it is a time of day |
//! | others | ignored |
//!
//! If no names are given, lines of 7 numbers are read as `t,gx,gy,gz,ax,ay,az`, and lines of 10
//! numbers have `mx,my,mz` in addition.
//!
//! The first line of a stream may be incomplete. It is used only if it is a header or if
//! [`LineSettings::starts_at_line_start`] is set, otherwise it is skipped.
//!
//! Limits: there is no checksum. A line with a non-text byte, an invalid number or the wrong number
//! of fields is rejected as a whole, but a corrupted digit remains undetected.

use mapping::{
    FIELD, FORCE, HeaderError, Mapping, POSITION, RATE,
    names::nearest,
    names_with_units,
    text::{self, DAY_NS, Dialect, Expected, Line, Separator, Time},
};

use crate::{
    DeviceTime, Measurement, Position, Value,
    framed::{Format, ParseOutcome},
};

/// Maximum length of a line, including its newline.
const MAX_LINE_BYTES: usize = 4096;
/// Smallest time that counts as UNIX time, ns: 2001-09-09.
const MIN_UNIX_TIME_NS: i64 = 1_000_000_000_000_000_000;
/// Format of lines of numbers, with the columns of the stream.
#[derive(Debug, Clone)]
pub struct Lines {
    /// Mapping from the settings.
    configured: Mapping,
    /// Mapping with the units from the header.
    mapping: Mapping,
    time_bits: Option<u8>,
    /// Wrap period of the time, if the time is a wrapping counter.
    period_ns: Option<u64>,
    indices: Option<ColumnIndices>,
    /// Separator and decimal mark of the rows; `None` until the first row.
    dialect: Option<Dialect>,
    /// `true` if a line names the columns but not their units. Rows are then not read by position.
    lacks_units: bool,
    /// Last line that is not a row, kept because the next line may contain the units of its
    /// columns.
    last_names: Option<String>,
    /// `true` if the next byte starts a line.
    is_synchronised: bool,
    last_fix: Option<[u64; 6]>,
    /// `true` if the current line has a date of which the first number may be the month or the day.
    has_ambiguous_date: bool,
}

/// Settings of [`Lines`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LineSettings {
    /// Assignment of columns, units and axes.
    pub mapping: Mapping,
    /// Column names in order, or `None` if a line of the stream names them.
    pub columns: Option<Vec<String>>,
    /// Width of the time in bits, 1 to 63, if the time is a wrapping counter: 32 for `micros()` on
    /// an Arduino. `None` if the time does not wrap.
    pub time_bits: Option<u8>,
    /// `true` if the stream begins at the start of a line, as a datagram or a program's output
    /// does. A serial port, in contrast, may be opened in the middle of a line.
    pub starts_at_line_start: bool,
}

/// Error in [`LineSettings`].
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum LinesError {
    /// A mapped column is not among the column names.
    #[error("column {column:?} for {target} is not in the list of columns; {}", near.as_ref().map_or_else(|| "correct `map` or `columns`".into(), |near| format!("did you mean {near:?}?")))]
    MissingColumn {
        /// Quantity that the column is mapped to.
        target: &'static str,
        /// Name of the column in the mapping.
        column: String,
        /// Column with a similar name.
        near: Option<String>,
    },
    /// The names of the columns state contradictory units, or lack a unit.
    #[error("{0}; set `units` to {remedy}", remedy = .0.remedy())]
    Units(HeaderError),
    /// `time_bits` is out of range.
    #[error("time_bits is {bits}; allowed are 1 to 63, with a counter that wraps within 292 years")]
    InvalidTimeBits {
        /// Configured number of bits.
        bits: u8,
    },
}

impl Lines {
    /// Creates a format with these settings.
    ///
    /// # Errors
    ///
    /// Returns an error if a mapped column is not among the column names or `time_bits` is out of
    /// range.
    pub fn new(settings: &LineSettings) -> Result<Self, LinesError> {
        let configured = settings.mapping.clone();
        let mut lines = Self {
            mapping: configured.clone(),
            configured,
            time_bits: settings.time_bits,
            period_ns: None,
            indices: None,
            dialect: None,
            lacks_units: false,
            last_names: None,
            is_synchronised: settings.starts_at_line_start,
            last_fix: None,
            has_ambiguous_date: false,
        };
        lines.period_ns = lines.wrap_period_ns(&lines.configured)?;
        if let Some(columns) = &settings.columns {
            let columns: Vec<_> = columns.iter().map(|column| column.trim()).collect();
            lines.set_columns(&columns).map_err(|error| match error {
                LinesError::MissingColumn { target, column, .. } => {
                    let near = nearest(&column, columns.iter().copied()).map(str::to_owned);
                    LinesError::MissingColumn { target, column, near }
                }
                error => error,
            })?;
        }
        Ok(lines)
    }

    fn wrap_period_ns(&self, mapping: &Mapping) -> Result<Option<u64>, LinesError> {
        let period_ns = |bits: u8| mapping.wrap_period_ns(bits.into()).ok_or(LinesError::InvalidTimeBits { bits });
        self.time_bits.map(period_ns).transpose()
    }

    /// Determines the columns and their units from the names of all columns.
    fn set_columns(&mut self, names: &[&str]) -> Result<(), LinesError> {
        let (indices, mapping) = ColumnIndices::find(&self.configured, names)?;
        self.period_ns = self.wrap_period_ns(&mapping)?;
        (self.indices, self.mapping) = (Some(indices), mapping);
        Ok(())
    }

    fn parse_line(&mut self, line: &[u8], measurements: &mut Vec<Measurement>) -> Option<()> {
        let line = match Line::parse(line)? {
            Line::Blank => return Some(()),
            Line::Comment(comment) => {
                self.find_columns(comment);
                return Some(());
            }
            Line::Content(line) => line,
        };
        if self.is_synchronised && self.parse_row(line, measurements).is_some() {
            return Some(());
        }
        if self.find_columns(line) {
            return Some(());
        }
        if !self.is_synchronised || self.indices.is_some() || self.mapping.is_explicit() || self.lacks_units {
            return None;
        }
        let mut names = Separator::ALL.iter().filter_map(|separator| {
            let names = text::unnamed_columns(separator.fields(line).len())?;
            Some((names, *separator))
        });
        let (names, separator) = names.next()?;
        self.set_columns(names).ok()?;
        self.dialect = Some(Dialect::new(separator));
        let row = self.parse_row(line, measurements);
        if row.is_none() {
            (self.indices, self.dialect) = (None, None);
        }
        row
    }

    /// Determines the columns from a line that contains all mapped names. Returns `false` if the
    /// line does not contain them.
    fn find_columns(&mut self, line: &str) -> bool {
        if text::is_row(line) {
            return false;
        }
        for separator in Separator::ALL {
            match self.set_columns(&separator.fields(line)) {
                Ok(()) => {
                    self.dialect = Some(Dialect::new(separator));
                    self.last_names = Some(line.to_owned());
                    return true;
                }
                Err(error) => self.lacks_units |= matches!(error, LinesError::Units(_)),
            }
        }
        let Some(names) = self.last_names.replace(line.to_owned()) else { return false };
        Separator::ALL.into_iter().any(|separator| {
            let joined = names_with_units(&separator.fields(&names), &separator.fields(line));
            let names: Vec<_> = joined.iter().flatten().map(String::as_str).collect();
            let is_found = !names.is_empty() && self.set_columns(&names).is_ok();
            if is_found {
                self.dialect = Some(Dialect::new(separator));
            }
            is_found
        })
    }

    /// Returns the dialect of a row with `count` fields. The separator is that of the column names,
    /// or another one that yields `count` fields.
    fn dialect_of(&self, line: &str, count: usize) -> Option<Dialect> {
        let fits = |separator: Separator| separator.row_fields(line, count).len() == count;
        self.dialect
            .filter(|dialect| fits(dialect.separator))
            .or_else(|| Separator::ALL.into_iter().find(|separator| fits(*separator)).map(Dialect::new))
    }

    fn parse_row(&mut self, line: &str, measurements: &mut Vec<Measurement>) -> Option<()> {
        let indices = self.indices.as_ref()?;
        let dialect = self.dialect_of(line, indices.count)?;
        let fields = dialect.separator.row_fields(line, indices.count);
        let mut row = Row { fields: &fields, dialect };
        let time = match indices.time {
            Some(index) => match row.time(index, &self.mapping) {
                Ok(time) => self.device_time(time)?,
                Err(expected) => {
                    self.has_ambiguous_date = expected == Expected::DateOrder;
                    return None;
                }
            },
            None => None,
        };
        let (rate, force) = (row.vector(indices.rate)?, row.vector(indices.force)?);
        let (field, velocity) = (row.finite_vector(indices.field)?, row.finite_vector(indices.velocity)?);
        let mut position = [f64::NAN; 3];
        for (part, index) in position.iter_mut().zip(indices.position) {
            *part = index.map_or(Some(f64::NAN), |index| row.number(index))?;
        }
        self.dialect = Some(row.dialect);
        if let Some(velocity) = velocity {
            let ([east, north, up], [latitude_deg, longitude_deg, altitude_m]) = (velocity, position);
            let fix_bits = [east, north, up, latitude_deg, longitude_deg, altitude_m].map(f64::to_bits);
            if self.last_fix.replace(fix_bits) != Some(fix_bits) {
                let position = Position::from_degrees(latitude_deg, longitude_deg, altitude_m);
                let velocity_m_s = self.mapping.velocity_m_s(velocity);
                measurements.push(Measurement { time, value: Value::Fix { velocity_m_s, sd_m_s: None, position } });
            }
        }
        if !rate.iter().chain(&force).all(|number| number.is_nan()) {
            let value = Value::Imu {
                rate_rad_s: self.mapping.rate_rad_s(rate),
                force_m_s2: self.mapping.force_m_s2(force),
                field_ut: field.map(|field| self.mapping.field_ut(field)),
            };
            measurements.push(Measurement { time, value });
        } else if let Some(field) = field {
            measurements.push(Measurement { time, value: Value::Field(self.mapping.field_ut(field)) });
        }
        Some(())
    }

    /// Converts a parsed time to a device time. Returns `None` if a counter is negative.
    fn device_time(&self, time: Option<Time>) -> Option<Option<DeviceTime>> {
        let Some(time) = time else { return Some(None) };
        // Times in a recording may be negative. They are stored as two's complement.
        let now_ns = time.ns().cast_unsigned();
        Some(Some(match (time, self.period_ns) {
            (Time::OfDay(_), _) => DeviceTime::Counter { now_ns, period_ns: DAY_NS.unsigned_abs() },
            (Time::Calendar(_), _) => DeviceTime::Unix { now_ns },
            (Time::Count(..0), Some(_)) => return None,
            (Time::Count(_), Some(period_ns)) => DeviceTime::Counter { now_ns: now_ns % period_ns, period_ns },
            (Time::Count(MIN_UNIX_TIME_NS..), None) => DeviceTime::Unix { now_ns },
            (Time::Count(_), None) => DeviceTime::SinceBoot { now_ns },
        }))
    }
}

impl Format for Lines {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        let window = &bytes[..bytes.len().min(MAX_LINE_BYTES)];
        let is_end = |(index, byte): (usize, &u8)| match byte {
            b'\n' => true,
            // A newline after a carriage return belongs to the same line end.
            b'\r' => window.get(index + 1).is_some_and(|next| *next != b'\n'),
            _ => false,
        };
        let Some(end) = window.iter().enumerate().position(is_end) else {
            if bytes.len() < MAX_LINE_BYTES {
                return ParseOutcome::Incomplete;
            }
            // The rest of the overlong line must not be read as a separate line.
            self.is_synchronised = false;
            return ParseOutcome::Skip(MAX_LINE_BYTES);
        };
        let is_line = self.parse_line(&bytes[..end], measurements).is_some();
        let has_ambiguous_date = std::mem::take(&mut self.has_ambiguous_date);
        match (is_line, std::mem::replace(&mut self.is_synchronised, true)) {
            (true, _) => ParseOutcome::Frame(end + 1),
            (false, true) if has_ambiguous_date => ParseOutcome::AmbiguousDate(end + 1),
            (false, true) => ParseOutcome::RejectedUnit(end + 1),
            (false, false) => ParseOutcome::Skip(end + 1),
        }
    }
}

/// Line split into fields.
struct Row<'a> {
    fields: &'a [&'a str],
    dialect: Dialect,
}

impl Row<'_> {
    /// Parses three fields. Blank ones are NaN.
    fn vector(&mut self, indices: [usize; 3]) -> Option<[f64; 3]> {
        let [x, y, z] = indices.map(|index| self.number(index));
        Some([x?, y?, z?])
    }

    fn number(&mut self, index: usize) -> Option<f64> {
        self.dialect.number(self.fields.get(index)?).ok()
    }

    /// Parses a time. A blank field yields `None`.
    fn time(&mut self, index: usize, mapping: &Mapping) -> Result<Option<Time>, Expected> {
        let field = self.fields.get(index).ok_or(Expected::TimeText)?;
        self.dialect.time(field, mapping.time_digits())
    }

    /// Parses three optional fields. Returns `Some(None)` if there are no such columns or a number
    /// is not finite.
    fn finite_vector(&mut self, indices: Option<[usize; 3]>) -> Option<Option<[f64; 3]>> {
        let Some(indices) = indices else { return Some(None) };
        let numbers = self.vector(indices)?;
        Some(numbers.iter().all(|number| number.is_finite()).then_some(numbers))
    }
}

/// Indices of the columns in a line.
#[derive(Debug, Clone)]
struct ColumnIndices {
    count: usize,
    time: Option<usize>,
    rate: [usize; 3],
    force: [usize; 3],
    field: Option<[usize; 3]>,
    velocity: Option<[usize; 3]>,
    position: [Option<usize>; 3],
}

impl ColumnIndices {
    /// Finds the mapped columns among `names`. Also returns the mapping with the units of these
    /// names.
    fn find(mapping: &Mapping, names: &[&str]) -> Result<(Self, Mapping), LinesError> {
        let index_of = |target: &'static str| -> Result<usize, LinesError> {
            let ranked =
                names.iter().enumerate().filter_map(|(index, name)| Some((mapping.match_rank(target, name)?, index)));
            ranked.min().map(|(_, index)| index).ok_or_else(|| {
                let column = mapping.column(target).unwrap_or(target).to_owned();
                LinesError::MissingColumn { target, column, near: None }
            })
        };
        let three_indices = |[x, y, z]: [&'static str; 3]| Ok([index_of(x)?, index_of(y)?, index_of(z)?]);
        let [latitude, longitude, altitude] = POSITION;
        let optional_index =
            |target| if mapping.column(target).is_some() { optional(mapping, index_of(target)) } else { Ok(None) };
        let optional_group = |targets| optional(mapping, three_indices(targets));
        let mut indices = Self {
            count: names.len(),
            time: optional_index("t")?,
            rate: three_indices(RATE)?,
            force: three_indices(FORCE)?,
            field: if mapping.has_field() { optional_group(FIELD)? } else { None },
            velocity: mapping.velocity().map_or(Ok(None), optional_group)?,
            position: [optional_index(latitude)?, optional_index(longitude)?, optional_index(altitude)?],
        };
        let with_units = |indices: &Self| {
            let targets = [(RATE, Some(indices.rate)), (FORCE, Some(indices.force)), (FIELD, indices.field)];
            let of_vectors =
                targets.into_iter().flat_map(|(targets, found)| targets.into_iter().zip(found.into_iter().flatten()));
            let columns: Vec<_> = of_vectors.chain(indices.time.map(|index| ("t", index))).collect();
            let names_of = |target: &'static str| {
                let of_target = columns.iter().filter(|(other, _)| *other == target);
                of_target.filter_map(|(_, index)| names.get(*index).copied()).collect()
            };
            mapping.with_header_units(names_of, true).map(|(mapping, _)| mapping).map_err(LinesError::Units)
        };
        let with_units = with_units(&indices).or_else(|_| {
            // If the unit of the time is unknown, the time is ignored, and samples are stamped on
            // arrival.
            indices.time = None;
            with_units(&indices)
        })?;
        Ok((indices, with_units))
    }
}

/// Turns a missing column into `None` unless the user mapped it explicitly.
fn optional<T>(mapping: &Mapping, result: Result<T, LinesError>) -> Result<Option<T>, LinesError> {
    match result {
        Err(error) if mapping.is_explicit() => Err(error),
        result => Ok(result.ok()),
    }
}
