//! Parses and applies a column mapping with its units and frame.

use attitude::frames::{self, Body, Earth};

use crate::{
    header::{self, HeaderError},
    names::nearest,
    rotation::is_rotation,
    text::without_unit,
    units::{FIELD, FORCE, RATE, UNIT_ALIASES, UNITS, Unit, unit_named},
};

/// Targets of columns: time, rate, force, field, reference, velocity, position, and whether the row
/// is scored.
const TARGETS: [&str; 22] = [
    "t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "qw", "qx", "qy", "qz", "ve", "vn", "vu", "vd", "lat",
    "lon", "alt", "mov",
];
/// Targets that are mapped to columns of the same name by default.
const DEFAULT_COLUMNS: [&str; 21] = [
    "t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "qw", "qx", "qy", "qz", "ve", "vn", "vu", "lat", "lon",
    "alt", "mov",
];
/// Name of the time column in a recording.
const RECORDING_TIME_COLUMN: &str = "t_s";
/// Targets that a file requires.
const REQUIRED: [&str; 7] = ["t", "gx", "gy", "gz", "ax", "ay", "az"];
/// Targets that a live stream requires. Time is not required, because samples may be stamped on
/// arrival.
const REQUIRED_LIVE: [&str; 6] = ["gx", "gy", "gz", "ax", "ay", "az"];
/// Targets of the reference attitude.
pub const REFERENCE: [&str; 4] = ["qw", "qx", "qy", "qz"];
/// Target of the column that marks scored rows with 1.
pub const SCORED: &str = "mov";
const VELOCITY_UP: [&str; 3] = ["ve", "vn", "vu"];
const VELOCITY_DOWN: [&str; 3] = ["ve", "vn", "vd"];
/// Targets of the position. Each is optional.
pub const POSITION: [&str; 3] = ["lat", "lon", "alt"];

/// Rank of column names that match only as aliases, such as `gyro_x` for `gx`.
const ALIAS_RANK: u8 = 2;
/// Number of decimal places needed to write a time in seconds with nanosecond resolution.
const SECOND_DIGITS: usize = 9;

fn default_columns() -> Vec<(&'static str, String)> {
    DEFAULT_COLUMNS.map(|target| (target, target.to_owned())).into()
}

/// Mapping of columns to quantities, with their units and axes.
///
/// By default, each column is mapped to the target of the same name. The default units are s,
/// rad/s, m/s² and µT, and the default axes are `rfu`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// Pairs of target and column.
    columns: Vec<(&'static str, String)>,
    /// `true` if the columns were named by the user.
    is_explicit: bool,
    units: Units,
    /// Decimal places needed for nanosecond resolution in the unit of time; `None` if the user
    /// specified no unit.
    time_digits: Option<usize>,
    body: Option<Body>,
    earth: Option<Earth>,
}

/// Factors that convert to rad/s, m/s² and µT. `None` if the user specified no unit.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Units {
    /// Factor by which the body rate is multiplied.
    pub rate: Option<f64>,
    /// Factor by which the specific force is multiplied.
    pub force: Option<f64>,
    /// Factor by which the magnetic field is multiplied.
    pub field: Option<f64>,
}

impl Default for Mapping {
    fn default() -> Self {
        let columns = default_columns();
        Self { columns, is_explicit: false, units: Units::default(), time_digits: None, body: None, earth: None }
    }
}

/// Error in a mapping.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum MappingError {
    /// The text is not a pair of target and column.
    #[error("found {found:?}, expected TARGET=COLUMN with TARGET one of {}", TARGETS.join(", "))]
    InvalidPair {
        /// Text found.
        found: String,
    },
    /// The target does not exist.
    #[error("found {found:?}{}, expected one of {}", did_you_mean(*suggestion), TARGETS.join(", "))]
    UnknownTarget {
        /// Text found.
        found: String,
        /// Target with the most similar name; `None` if all differ too much.
        suggestion: Option<&'static str>,
    },
    /// The target is mapped twice.
    #[error("found {target} twice, expected one column for it")]
    DuplicateTarget {
        /// Name of the target.
        target: &'static str,
    },
    /// Required targets are missing.
    #[error("found no {}, expected all of {}", missing.join(", "), expected.join(", "))]
    MissingTargets {
        /// Missing targets.
        missing: Vec<&'static str>,
        /// Targets that are required together.
        expected: &'static [&'static str],
    },
    /// The unit does not exist.
    #[error("found {found:?}{}, expected one of {}", did_you_mean(*suggestion), UNITS.map(|(name, _)| name).join(", "))]
    UnknownUnit {
        /// Text found.
        found: String,
        /// Unit with the most similar name; `None` if all differ too much.
        suggestion: Option<&'static str>,
    },
    /// Two units of the same quantity are given.
    #[error("found {first:?} and {second:?}, expected one unit of the {quantity}")]
    DuplicateUnit {
        /// Quantity that both units measure.
        quantity: &'static str,
        /// First unit found.
        first: &'static str,
        /// Second unit found.
        second: &'static str,
    },
    /// The text names no known axes.
    #[error(
        "found {found:?}, expected body axes, one of {}; with a reference preceded by earth axes, one of {}, as in ned-frd",
        Body::NAMES.map(|(name, _)| name).join(", "),
        Earth::NAMES.map(|(name, _)| name).join(", ")
    )]
    UnknownFrame {
        /// Text found.
        found: String,
    },
    /// A reference is mapped, but the frame does not name the earth axes.
    #[error("found no earth axes for qw, qx, qy, qz, expected a frame such as enu-flu or ned-frd")]
    MissingEarthFrame,
}

impl MappingError {
    /// Returns the name of the setting that is invalid: `map`, `units` or `frame`.
    pub fn setting(&self) -> &'static str {
        match self {
            Self::InvalidPair { .. }
            | Self::UnknownTarget { .. }
            | Self::DuplicateTarget { .. }
            | Self::MissingTargets { .. } => "map",
            Self::UnknownUnit { .. } | Self::DuplicateUnit { .. } => "units",
            Self::UnknownFrame { .. } | Self::MissingEarthFrame => "frame",
        }
    }
}

fn did_you_mean(suggestion: Option<&str>) -> String {
    suggestion.map_or_else(String::new, |suggestion| format!(" (did you mean {suggestion:?}?)"))
}

impl Mapping {
    /// Parses the mapping of a file.
    ///
    /// Each element of `maps` is one pair, such as `gx=gyro_x`, or several separated by commas.
    /// With several files the column is given as `FILE:COLUMN`. `units` is a list in any order,
    /// such as `deg/s,g,gauss,ms`; the defaults are rad/s, m/s2, uT and s. `frame` names the body
    /// axes of the file, by default `rfu`. If a reference is mapped, `frame` must also name the
    /// earth axes, as in `ned-frd`. If `maps` is empty, each target is mapped to the column with
    /// the same name.
    ///
    /// # Errors
    ///
    /// Returns the first error found in `maps`, then `units` and `frame`.
    pub fn parse<S: AsRef<str>>(maps: &[S], units: Option<&str>, frame: Option<&str>) -> Result<Self, MappingError> {
        Self::new(maps, &REQUIRED, units, frame)
    }

    /// Parses the mapping of a live text stream, which need not contain a time.
    ///
    /// If `maps` is empty, each target is mapped to the column with the same name.
    ///
    /// # Errors
    ///
    /// Returns the first error found, as [`Mapping::parse`] does.
    pub fn parse_live<S: AsRef<str>>(
        maps: &[S],
        units: Option<&str>,
        frame: Option<&str>,
    ) -> Result<Self, MappingError> {
        Self::new(maps, &REQUIRED_LIVE, units, frame)
    }

    fn new<S: AsRef<str>>(
        maps: &[S],
        required: &'static [&'static str],
        units: Option<&str>,
        frame: Option<&str>,
    ) -> Result<Self, MappingError> {
        let is_explicit = !maps.is_empty();
        let columns = if is_explicit { parse_columns(maps, required)? } else { default_columns() };
        let unknown = |found: &str| MappingError::UnknownFrame { found: found.into() };
        let axes = frame.map(|found| frames::parse(found).ok_or_else(|| unknown(found)));
        let (earth, body) = axes.transpose()?.map_or((None, None), |(earth, body)| (earth, Some(body)));
        let mut mapping = Self { columns, is_explicit, body, earth, ..Self::default() };
        mapping.set_units(units.unwrap_or_default())?;
        if is_explicit && mapping.has_reference() && earth.is_none() {
            return Err(MappingError::MissingEarthFrame);
        }
        Ok(mapping)
    }

    fn set_units(&mut self, units: &str) -> Result<(), MappingError> {
        let mut chosen: [Option<&'static str>; 4] = [None; 4];
        for found in units.split(',').map(str::trim).filter(|found| !found.is_empty()) {
            let plain = UNIT_ALIASES.iter().find(|(alias, _)| *alias == found).map_or(found, |(_, name)| name);
            let Some((name, unit)) = UNITS.into_iter().find(|(name, _)| *name == plain) else {
                let names = UNITS.map(|(name, _)| name);
                let same_letters = names.into_iter().find(|name| name.eq_ignore_ascii_case(found));
                let suggestion = same_letters.or_else(|| nearest(found, names));
                return Err(MappingError::UnknownUnit { found: found.into(), suggestion });
            };
            let (index, quantity) = match unit {
                Unit::Rate(_) => (0, "rate"),
                Unit::Force(_) => (1, "force"),
                Unit::Field(_) => (2, "field"),
                Unit::Time(_) => (3, "time"),
            };
            if let Some(first) = chosen[index].replace(name) {
                return Err(MappingError::DuplicateUnit { quantity, first, second: name });
            }
            self.set_unit(unit);
        }
        Ok(())
    }

    fn set_unit(&mut self, unit: Unit) {
        match unit {
            Unit::Rate(factor) => self.units.rate = Some(factor),
            Unit::Force(factor) => self.units.force = Some(factor),
            Unit::Field(factor) => self.units.field = Some(factor),
            Unit::Time(digits) => self.time_digits = Some(digits),
        }
    }

    /// Returns the names of the units that are set.
    fn unit_names(&self) -> Vec<&'static str> {
        let Units { rate, force, field } = self.units;
        let is_set = |unit: Unit| match unit {
            Unit::Rate(factor) => rate == Some(factor),
            Unit::Force(factor) => force == Some(factor),
            Unit::Field(factor) => field == Some(factor),
            Unit::Time(digits) => self.time_digits == Some(digits),
        };
        UNITS.into_iter().filter(|(_, unit)| is_set(*unit)).map(|(name, _)| name).collect()
    }

    /// For each quantity without a unit in the mapping, adopts the unit given by its column names.
    /// Returns the new mapping, and the names of the adopted units that differ from the default
    /// ones.
    ///
    /// `names_of` returns the names of the columns that hold a target. `needs_time_unit` is `false`
    /// if the times are dates or times of day, which have no unit.
    ///
    /// # Errors
    ///
    /// Returns an error if the column names of a quantity give different units, or if they give no
    /// unit and one of them matches only as an alias.
    pub fn with_header_units<'a>(
        &self,
        names_of: impl Fn(&'static str) -> Vec<&'a str>,
        needs_time_unit: bool,
    ) -> Result<(Self, Vec<&'static str>), HeaderError> {
        let Units { rate, force, field } = self.units;
        let (mut mapping, mut changed) = (self.clone(), Vec::new());
        let (mut unitless, mut defaults) = (Vec::new(), Vec::new());
        let quantities: [(&str, &[&'static str], &str, bool); 4] = [
            ("rate", &RATE, "rad/s", rate.is_some()),
            ("force", &FORCE, "m/s2", force.is_some()),
            ("field", &FIELD, "uT", field.is_some()),
            ("time", &["t"], "s", self.time_digits.is_some()),
        ];
        for (quantity, targets, default, _) in quantities.into_iter().filter(|(.., is_named)| !is_named) {
            let mut found: Option<(&str, &'static str)> = None;
            let mut alias = None;
            for target in targets {
                for name in names_of(target) {
                    let is_default =
                        self.is_explicit || self.match_rank(target, name).is_some_and(|rank| rank < ALIAS_RANK);
                    alias = alias.or((!is_default).then_some(name));
                    for unit in header::units(target, name) {
                        let (first, known) = *found.get_or_insert((name, unit));
                        if known != unit {
                            let remedy = [self.unit_names(), vec![known]].concat().join(",");
                            let (first, second, units) = (first.to_owned(), name.to_owned(), [known, unit]);
                            return Err(HeaderError::DifferentUnits { quantity, first, second, units, remedy });
                        }
                    }
                }
            }
            match (found, alias) {
                (Some((_, name)), _) => {
                    unit_named(name).into_iter().for_each(|unit| mapping.set_unit(unit));
                    changed.extend((name != default).then_some(name));
                }
                (None, Some(name)) if quantity != "time" || needs_time_unit => {
                    unitless.push(name.to_owned());
                    defaults.push(default);
                }
                _ => {}
            }
        }
        if unitless.is_empty() {
            return Ok((mapping, changed));
        }
        let remedy = [self.unit_names(), defaults].concat().join(",");
        Err(HeaderError::MissingUnits { names: unitless, remedy })
    }

    /// Returns `true` if columns were mapped explicitly, in which case all of them are required.
    pub fn is_explicit(&self) -> bool {
        self.is_explicit
    }

    /// Returns the column mapped to `target`.
    pub fn column(&self, target: &str) -> Option<&str> {
        self.columns.iter().find(|(other, _)| *other == target).map(|(_, column)| column.as_str())
    }

    /// Returns the pairs of target and column.
    pub fn columns(&self) -> impl Iterator<Item = (&'static str, &str)> {
        self.columns.iter().map(|(target, column)| (*target, column.as_str()))
    }

    /// Returns the period in ns after which a time counter with `bits` bits wraps. The counter has
    /// the unit of the mapped time.
    ///
    /// Returns `None` if `bits` is not within 1 to 63 or the period exceeds an `i64`.
    pub fn wrap_period_ns(&self, bits: u64) -> Option<u64> {
        let count_ns = u32::try_from(self.time_digits()).ok().and_then(|digits| 10u64.checked_pow(digits))?;
        let counts = (1..64).contains(&bits).then(|| 1u64 << bits)?;
        counts.checked_mul(count_ns).filter(|period_ns| i64::try_from(*period_ns).is_ok())
    }

    /// Returns `true` if the magnetic field is mapped.
    pub fn has_field(&self) -> bool {
        self.column(FIELD[0]).is_some()
    }

    /// Returns `true` if the reference attitude is mapped.
    pub fn has_reference(&self) -> bool {
        self.column(REFERENCE[0]).is_some()
    }

    /// Returns the targets of the east, north and vertical velocities, or `None` if they are not
    /// mapped.
    pub fn velocity(&self) -> Option<[&'static str; 3]> {
        [VELOCITY_UP, VELOCITY_DOWN].into_iter().find(|[_, _, vertical]| self.column(vertical).is_some())
    }

    /// Returns the velocity in m/s (east, north, up) from the columns of [`Mapping::velocity`].
    pub fn velocity_m_s(&self, [east, north, vertical]: [f64; 3]) -> [f64; 3] {
        [east, north, if self.column(VELOCITY_DOWN[2]).is_some() { -vertical } else { vertical }]
    }

    /// Converts a quaternion w, x, y, z to native axes. Returns `None` unless it has unit length.
    pub fn reference(&self, quaternion: [f64; 4]) -> Option<[f64; 4]> {
        is_rotation(quaternion)
            .then(|| frames::quaternion_to_native(self.earth.unwrap_or_default(), self.body(), quaternion))
    }

    /// Returns the units that the user specified.
    pub fn units(&self) -> Units {
        self.units
    }

    /// Returns the body axes and the earth axes that the user specified.
    pub fn frame(&self) -> (Option<Body>, Option<Earth>) {
        (self.body, self.earth)
    }

    fn body(&self) -> Body {
        self.body.unwrap_or_default()
    }

    /// Returns the rank of a column name as a match for `target`, 0 for the best match; `None` if
    /// it does not match. If several columns match, those with the lowest rank are selected.
    ///
    /// A unit in brackets at the end of the name is ignored. The time of a recording is called
    /// `t_s`. If the user has not mapped the columns, names such as `gyro_x` or `GyroX_dps` also
    /// match.
    pub fn match_rank(&self, target: &str, name: &str) -> Option<u8> {
        let column = self.column(target).unwrap_or(target);
        let plain = without_unit(name);
        // The column `t_s` matches if the unit of time is the second. If the user has not mapped
        // the columns, `t_s` matches with any unit of time, which then applies to this column.
        let is_seconds = !self.is_explicit || self.time_digits() == SECOND_DIGITS;
        let is_recording_time = column == "t" && plain == RECORDING_TIME_COLUMN && is_seconds;
        if name == column {
            Some(0)
        } else if plain == column || is_recording_time {
            Some(1)
        } else {
            let is_alias = !self.is_explicit && header::parse(name).is_some_and(|found| found.target == target);
            is_alias.then_some(ALIAS_RANK)
        }
    }

    /// Returns the body rate in rad/s (right, forward, up) from the columns of [`RATE`].
    pub fn rate_rad_s(&self, values: [f64; 3]) -> [f64; 3] {
        self.body().to_native(values.map(|part| part * self.units.rate.unwrap_or(1.0)))
    }

    /// Returns the specific force in m/s² (right, forward, up) from the columns of [`FORCE`].
    pub fn force_m_s2(&self, values: [f64; 3]) -> [f64; 3] {
        self.body().to_native(values.map(|part| part * self.units.force.unwrap_or(1.0)))
    }

    /// Returns the magnetic field in µT (right, forward, up) from the columns of [`FIELD`].
    pub fn field_ut(&self, values: [f64; 3]) -> [f64; 3] {
        self.body().to_native(values.map(|part| part * self.units.field.unwrap_or(1.0)))
    }

    /// Returns the number of decimal places needed to write a time with nanosecond resolution.
    pub fn time_digits(&self) -> usize {
        self.time_digits.unwrap_or(SECOND_DIGITS)
    }
}

fn parse_columns<S: AsRef<str>>(
    maps: &[S],
    required: &'static [&'static str],
) -> Result<Vec<(&'static str, String)>, MappingError> {
    let mut columns: Vec<(&'static str, String)> = Vec::new();
    for map in maps {
        let mut continued = false;
        for part in map.as_ref().split(',') {
            let Some((found, column)) = part.split_once('=') else {
                // A part that is not a pair continues the previous column name, which contains a
                // comma.
                let Some((_, column)) = columns.last_mut().filter(|_| continued) else {
                    return Err(MappingError::InvalidPair { found: part.into() });
                };
                column.push(',');
                column.push_str(part);
                continue;
            };
            let found = found.trim();
            let Some(&target) = TARGETS.iter().find(|target| **target == found) else {
                let suggestion = nearest(found, TARGETS);
                return Err(MappingError::UnknownTarget { found: found.into(), suggestion });
            };
            if columns.iter().any(|(other, _)| *other == target) {
                return Err(MappingError::DuplicateTarget { target });
            }
            columns.push((target, column.trim().to_owned()));
            continued = true;
        }
    }
    let has = |target: &&str| columns.iter().any(|(other, _)| other == target);
    let missing = |expected: &'static [&'static str]| -> Vec<_> {
        expected.iter().copied().filter(|target| !has(target)).collect()
    };
    let any = |group: &[&str]| group.iter().any(has);
    let velocity: &'static [&'static str] = if has(&VELOCITY_DOWN[2]) { &VELOCITY_DOWN } else { &VELOCITY_UP };
    let has_velocity = any(&VELOCITY_UP) || any(&VELOCITY_DOWN) || any(&POSITION);
    let groups: [(&'static [&'static str], bool); 4] =
        [(required, true), (&FIELD, any(&FIELD)), (&REFERENCE, any(&REFERENCE)), (velocity, has_velocity)];
    for (expected, wanted) in groups {
        let missing = missing(expected);
        if wanted && !missing.is_empty() {
            return Err(MappingError::MissingTargets { missing, expected });
        }
    }
    Ok(columns)
}
