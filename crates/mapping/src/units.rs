//! Units of the measured quantities, and the targets that the units apply to.

use attitude::GRAVITY_M_S2;

/// Targets of the body rate.
pub const RATE: [&str; 3] = ["gx", "gy", "gz"];
/// Targets of the specific force.
pub const FORCE: [&str; 3] = ["ax", "ay", "az"];
/// Targets of the magnetic field.
pub const FIELD: [&str; 3] = ["mx", "my", "mz"];

/// Quantity that a unit measures, with the factor that converts to the internal unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Unit {
    Rate(f64),
    Force(f64),
    Field(f64),
    /// Number of decimal places needed to write a time in this unit with nanosecond resolution.
    Time(usize),
}

/// Units by name.
pub(crate) const UNITS: [(&str, Unit); 17] = [
    ("rad/s", Unit::Rate(1.0)),
    ("mrad/s", Unit::Rate(1e-3)),
    ("deg/s", Unit::Rate(std::f64::consts::PI / 180.0)),
    ("mdeg/s", Unit::Rate(std::f64::consts::PI / 180.0 * 1e-3)),
    ("m/s2", Unit::Force(1.0)),
    ("g", Unit::Force(GRAVITY_M_S2)),
    ("mg", Unit::Force(GRAVITY_M_S2 / 1000.0)),
    ("uT", Unit::Field(1.0)),
    ("nT", Unit::Field(1e-3)),
    ("gauss", Unit::Field(100.0)),
    ("mgauss", Unit::Field(0.1)),
    ("mT", Unit::Field(1e3)),
    ("T", Unit::Field(1e6)),
    ("s", Unit::Time(9)),
    ("ms", Unit::Time(6)),
    ("us", Unit::Time(3)),
    ("ns", Unit::Time(0)),
];

/// Other spellings of units.
pub(crate) const UNIT_ALIASES: [(&str, &str); 17] = [
    ("°/s", "deg/s"),
    ("dps", "deg/s"),
    ("mdps", "mdeg/s"),
    ("deg/sec", "deg/s"),
    ("rad/sec", "rad/s"),
    ("m/s^2", "m/s2"),
    ("m/s²", "m/s2"),
    ("Gauss", "gauss"),
    ("Ga", "gauss"),
    ("mGauss", "mgauss"),
    ("tesla", "T"),
    ("µT", "uT"),
    ("μT", "uT"),
    ("µs", "us"),
    ("μs", "us"),
    ("milli-g", "mg"),
    ("sec", "s"),
];

impl Unit {
    /// Returns `true` if columns that hold `target` can have this unit.
    pub(crate) fn measures(self, target: &str) -> bool {
        match self {
            Self::Rate(_) => RATE.contains(&target),
            Self::Force(_) => FORCE.contains(&target),
            Self::Field(_) => FIELD.contains(&target),
            Self::Time(_) => target == "t",
        }
    }
}

/// Returns the unit in which the Earth's magnetic field has about the value `magnitude`, if there
/// is such a unit.
pub fn unit_of_earth_field(magnitude: f64) -> Option<&'static str> {
    /// Range of the Earth's magnetic field, 22 to 67 µT, with an allowance for iron. It spans less
    /// than a factor of ten, which distinguishes units that differ by this factor.
    const EARTH_FIELD_UT: std::ops::Range<f64> = 12.0..110.0;
    let is_field = |unit: Unit| matches!(unit, Unit::Field(factor) if EARTH_FIELD_UT.contains(&(magnitude * factor)));
    UNITS.into_iter().find(|(_, unit)| is_field(*unit)).map(|(name, _)| name)
}

/// Returns the unit of this name.
pub(crate) fn unit_named(name: &str) -> Option<Unit> {
    UNITS.iter().find(|(other, _)| *other == name).map(|(_, unit)| *unit)
}
