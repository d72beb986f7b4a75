//! Which column is what, and its unit and frame, as people say it.

use attitude::frames::{self, Body, Earth};

use crate::{names::nearest, rotation::is_rotation};

/// What a column can be mapped to: time, rate, force, field, reference, velocity, position.
const TARGETS: [&str; 21] = [
    "t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "qw", "qx", "qy", "qz", "ve", "vn", "vu", "vd", "lat",
    "lon", "alt",
];
/// What a column is taken for by its name alone.
const OWN_NAMES: [&str; 16] =
    ["t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "ve", "vn", "vu", "lat", "lon", "alt"];
/// Those that must be there in files.
const NEEDED: [&str; 7] = ["t", "gx", "gy", "gz", "ax", "ay", "az"];
/// Those that must be there in what arrives at its own time.
const NEEDED_LIVE: [&str; 6] = ["gx", "gy", "gz", "ax", "ay", "az"];
/// Targets of the body rate.
pub const RATE: [&str; 3] = ["gx", "gy", "gz"];
/// Targets of the specific force.
pub const FORCE: [&str; 3] = ["ax", "ay", "az"];
/// Targets of the magnetic field.
pub const FIELD: [&str; 3] = ["mx", "my", "mz"];
/// Targets of the reference attitude.
pub const REFERENCE: [&str; 4] = ["qw", "qx", "qy", "qz"];
const UPWARD: [&str; 3] = ["ve", "vn", "vu"];
const DOWNWARD: [&str; 3] = ["ve", "vn", "vd"];
/// Targets of the position, each by itself, where it is known.
pub const POSITION: [&str; 3] = ["lat", "lon", "alt"];

const STANDARD_GRAVITY_M_S2: f64 = 9.80665;

/// What a unit measures, and how many of ours it is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Unit {
    Rate(f64),
    Force(f64),
    Field(f64),
    /// Digits after the point that a number of whole nanoseconds has.
    Time(usize),
}

const UNITS: [(&str, Unit); 12] = [
    ("rad/s", Unit::Rate(1.0)),
    ("deg/s", Unit::Rate(std::f64::consts::PI / 180.0)),
    ("m/s2", Unit::Force(1.0)),
    ("g", Unit::Force(STANDARD_GRAVITY_M_S2)),
    ("uT", Unit::Field(1.0)),
    ("nT", Unit::Field(1e-3)),
    ("gauss", Unit::Field(100.0)),
    ("mT", Unit::Field(1e3)),
    ("s", Unit::Time(9)),
    ("ms", Unit::Time(6)),
    ("us", Unit::Time(3)),
    ("ns", Unit::Time(0)),
];

fn own_names() -> Vec<(&'static str, String)> {
    OWN_NAMES.map(|target| (target, target.to_owned())).into()
}

/// Which column is what, in which unit and which axes; by itself, columns called as what they are, in s, rad/s, m/s², µT and `rfu`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// Targets and the columns mapped to them.
    columns: Vec<(&'static str, String)>,
    rate: f64,
    force: f64,
    field: f64,
    time_digits: usize,
    body: Body,
    earth: Option<Earth>,
}

impl Default for Mapping {
    fn default() -> Self {
        let (rate, force, field) = (1.0, 1.0, 1.0);
        Self { columns: own_names(), rate, force, field, time_digits: 9, body: Body::Rfu, earth: None }
    }
}

/// What is wrong with a mapping.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum MappingError {
    /// No pair.
    #[error("found {found:?}, expected WHAT=COLUMN, WHAT one of {}", TARGETS.join(", "))]
    NoPair {
        /// What is there.
        found: String,
    },
    /// A target that nobody reads.
    #[error("found {found:?}{}, expected one of {}", guess(*near), TARGETS.join(", "))]
    UnknownTarget {
        /// What is there.
        found: String,
        /// The target of nearly that name.
        near: Option<&'static str>,
    },
    /// A target twice.
    #[error("found {target} twice, expected one column for it")]
    TargetTwice {
        /// The target.
        target: &'static str,
    },
    /// Targets that must be there.
    #[error("found no {}, expected all of {}", missing.join(", "), expected.join(", "))]
    MissingTargets {
        /// Those not there.
        missing: Vec<&'static str>,
        /// Those that belong together.
        expected: &'static [&'static str],
    },
    /// A unit that is none.
    #[error("found {found:?}{}, expected one of {}", guess(*near), UNITS.map(|(name, _)| name).join(", "))]
    UnknownUnit {
        /// What is there.
        found: String,
        /// The unit of nearly that name.
        near: Option<&'static str>,
    },
    /// Two units of one quantity.
    #[error("found {first:?} and {second:?}, expected one unit of the {quantity}")]
    UnitTwice {
        /// What both measure.
        quantity: &'static str,
        /// The first.
        first: &'static str,
        /// The second.
        second: &'static str,
    },
    /// Axes that are none.
    #[error(
        "found {found:?}, expected one of {}, with a reference after one of {}, as ned-frd",
        Body::NAMES.map(|(name, _)| name).join(", "),
        Earth::NAMES.map(|(name, _)| name).join(", ")
    )]
    UnknownFrame {
        /// What is there.
        found: String,
    },
    /// A reference, and nothing that says from where it is counted.
    #[error("found no axes of the earth for qw, qx, qy, qz, expected such as enu-flu or ned-frd")]
    NoEarth,
}

impl MappingError {
    /// Which of the three that say a mapping is wrong: `map`, `units` or `frame`.
    pub fn about(&self) -> &'static str {
        match self {
            Self::NoPair { .. }
            | Self::UnknownTarget { .. }
            | Self::TargetTwice { .. }
            | Self::MissingTargets { .. } => "map",
            Self::UnknownUnit { .. } | Self::UnitTwice { .. } => "units",
            Self::UnknownFrame { .. } | Self::NoEarth => "frame",
        }
    }
}

fn guess(near: Option<&str>) -> String {
    near.map_or_else(String::new, |near| format!(", did you mean {near:?}?"))
}

impl Mapping {
    /// Of `maps`, each one pair or several with commas between them, as `gx=gyro_x`; a column of one of several files is
    /// `FILE:COLUMN`. Of `units`, as `deg/s,g,gauss,ms`, in any order; rad/s, m/s2, uT, s where none is named. Of `frame`, the body
    /// axes of the file; `rfu` where none is named; with a reference those of the earth before them, as `ned-frd`.
    pub fn parse<S: AsRef<str>>(maps: &[S], units: Option<&str>, frame: Option<&str>) -> Result<Self, MappingError> {
        Self::of(columns(maps, &NEEDED)?, units, frame)
    }

    /// The same of text that arrives line by line, whose lines need not tell a time. Without a pair, the columns are called as what
    /// they are mapped to.
    pub fn parse_live<S: AsRef<str>>(
        maps: &[S],
        units: Option<&str>,
        frame: Option<&str>,
    ) -> Result<Self, MappingError> {
        if maps.is_empty() {
            return Self::of(own_names(), units, frame);
        }
        Self::of(columns(maps, &NEEDED_LIVE)?, units, frame)
    }

    fn of(
        columns: Vec<(&'static str, String)>,
        units: Option<&str>,
        frame: Option<&str>,
    ) -> Result<Self, MappingError> {
        let unknown = |found: &str| MappingError::UnknownFrame { found: found.into() };
        let axes = frame.map(|found| frames::named(found).ok_or_else(|| unknown(found)));
        let (earth, body) = axes.transpose()?.unwrap_or_default();
        let mut mapping = Self { columns, body, earth, ..Self::default() };
        mapping.set_units(units.unwrap_or_default())?;
        if mapping.has_reference() && earth.is_none() {
            return Err(MappingError::NoEarth);
        }
        Ok(mapping)
    }

    fn set_units(&mut self, units: &str) -> Result<(), MappingError> {
        let mut named: [Option<&'static str>; 4] = [None; 4];
        for found in units.split(',').map(str::trim).filter(|found| !found.is_empty()) {
            let Some(&(name, unit)) = UNITS.iter().find(|(name, _)| *name == found) else {
                let near = UNITS.iter().map(|(name, _)| *name).find(|name| name.eq_ignore_ascii_case(found));
                let near = near.or_else(|| nearest(found, UNITS.map(|(name, _)| name)));
                return Err(MappingError::UnknownUnit { found: found.into(), near });
            };
            let (index, quantity) = match unit {
                Unit::Rate(_) => (0, "rate"),
                Unit::Force(_) => (1, "force"),
                Unit::Field(_) => (2, "field"),
                Unit::Time(_) => (3, "time"),
            };
            if let Some(first) = named[index].replace(name) {
                return Err(MappingError::UnitTwice { quantity, first, second: name });
            }
            match unit {
                Unit::Rate(factor) => self.rate = factor,
                Unit::Force(factor) => self.force = factor,
                Unit::Field(factor) => self.field = factor,
                Unit::Time(digits) => self.time_digits = digits,
            }
        }
        Ok(())
    }

    /// Whether somebody said which column is what: then all of them are meant to be there.
    pub fn is_said(&self) -> bool {
        self.columns.iter().any(|(target, column)| target != column) || self.columns.len() < OWN_NAMES.len()
    }

    /// The column mapped to a target.
    pub fn column(&self, target: &str) -> Option<&str> {
        self.columns.iter().find(|(other, _)| *other == target).map(|(_, column)| column.as_str())
    }

    /// What is mapped, and to which column.
    pub fn columns(&self) -> impl Iterator<Item = (&'static str, &str)> {
        self.columns.iter().map(|(target, column)| (*target, column.as_str()))
    }

    /// After which a counter of so many bits, in the unit of the time, begins again, ns; none of a counter that lasts longer than a
    /// time in nanoseconds can.
    pub fn period_ns(&self, bits: u64) -> Option<u64> {
        let count_ns = u32::try_from(self.time_digits).ok().and_then(|digits| 10u64.checked_pow(digits))?;
        let counts = (1..64).contains(&bits).then(|| 1u64 << bits)?;
        counts.checked_mul(count_ns).filter(|period_ns| i64::try_from(*period_ns).is_ok())
    }

    /// Whether the magnetic field is mapped.
    pub fn has_field(&self) -> bool {
        self.column(FIELD[0]).is_some()
    }

    /// Whether the reference attitude is mapped.
    pub fn has_reference(&self) -> bool {
        self.column(REFERENCE[0]).is_some()
    }

    /// The targets of the velocity, where it is mapped.
    pub fn velocity(&self) -> Option<[&'static str; 3]> {
        [UPWARD, DOWNWARD].into_iter().find(|[_, _, vertical]| self.column(vertical).is_some())
    }

    /// Velocity east, north, up, m/s, of the columns of [`Mapping::velocity`].
    pub fn velocity_m_s(&self, [east, north, vertical]: [f64; 3]) -> [f64; 3] {
        [east, north, if self.column(DOWNWARD[2]).is_some() { -vertical } else { vertical }]
    }

    /// w, x, y, z of unit length in our axes; `None` of what is no rotation.
    pub fn reference(&self, found: [f64; 4]) -> Option<[f64; 4]> {
        is_rotation(found).then(|| frames::ours(self.earth.unwrap_or_default(), self.body, found))
    }

    /// Body rate, rad/s, of the columns of [`RATE`].
    pub fn rate_rad_s(&self, found: [f64; 3]) -> [f64; 3] {
        self.body.ours(found.map(|part| part * self.rate))
    }

    /// Specific force, m/s², of the columns of [`FORCE`].
    pub fn force_m_s2(&self, found: [f64; 3]) -> [f64; 3] {
        self.body.ours(found.map(|part| part * self.force))
    }

    /// Magnetic field, µT, of the columns of [`FIELD`].
    pub fn field_ut(&self, found: [f64; 3]) -> [f64; 3] {
        self.body.ours(found.map(|part| part * self.field))
    }

    /// Digits after the point that a time of whole nanoseconds has.
    pub fn time_digits(&self) -> usize {
        self.time_digits
    }
}

fn columns<S: AsRef<str>>(
    maps: &[S],
    needed: &'static [&'static str],
) -> Result<Vec<(&'static str, String)>, MappingError> {
    let mut columns: Vec<(&'static str, String)> = Vec::new();
    for map in maps {
        let mut continued = false;
        for part in map.as_ref().split(',') {
            let Some((found, column)) = part.split_once('=') else {
                // A comma in the name of a column.
                let Some((_, column)) = columns.last_mut().filter(|_| continued) else {
                    return Err(MappingError::NoPair { found: part.into() });
                };
                column.push(',');
                column.push_str(part);
                continue;
            };
            let found = found.trim();
            let Some(&target) = TARGETS.iter().find(|target| **target == found) else {
                let near = nearest(found, TARGETS);
                return Err(MappingError::UnknownTarget { found: found.into(), near });
            };
            if columns.iter().any(|(other, _)| *other == target) {
                return Err(MappingError::TargetTwice { target });
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
    let velocity: &'static [&'static str] = if has(&DOWNWARD[2]) { &DOWNWARD } else { &UPWARD };
    let has_velocity = any(&UPWARD) || any(&DOWNWARD) || any(&POSITION);
    let groups: [(&'static [&'static str], bool); 4] =
        [(needed, true), (&FIELD, any(&FIELD)), (&REFERENCE, any(&REFERENCE)), (velocity, has_velocity)];
    for (expected, wanted) in groups {
        let missing = missing(expected);
        if wanted && !missing.is_empty() {
            return Err(MappingError::MissingTargets { missing, expected });
        }
    }
    Ok(columns)
}
