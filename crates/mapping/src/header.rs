//! Quantities and units given in column names, such as `gyro_x (deg/s)` or `acc_x_mg`.

use crate::{
    text::without_unit,
    units::{FIELD, FORCE, RATE, unit_named},
};

/// Names that precede or follow the axis in a column name, by target. They are in lower case and
/// without separators.
const STEMS: [([&str; 3], &[&str]); 3] = [
    (
        RATE,
        &[
            "g",
            "w",
            "gyr",
            "gyro",
            "gyros",
            "gyroscope",
            "omega",
            "angularvelocity",
            "angularrate",
            "angvel",
            "rotationrate",
            "wrss",
        ],
    ),
    (FORCE, &["a", "f", "acc", "accel", "accelerometer", "acceleration", "specificforce", "arss"]),
    (FIELD, &["m", "b", "mag", "magn", "magnetometer", "magneticfield", "magfield"]),
];
/// Names of a time column, without separators and in lower case.
const TIME_STEMS: [&str; 5] = ["t", "time", "timestamp", "elapsed", "elapsedtime"];
/// Minimum length of a name that follows its axis, as in `x_gyro`.
const MIN_STEM_AFTER_AXIS: usize = 3;
/// Maximum length in bytes of a name that is parsed. It limits the time spent on arbitrary text.
const MAX_NAME_BYTES: usize = 64;
const AXES: [char; 3] = ['x', 'y', 'z'];
/// Characters between the words of a name.
const SEPARATORS: [char; 7] = ['_', '-', '.', ' ', ',', ':', '/'];

/// Spellings of units in column names, without the characters that [`plain_unit`] drops.
const UNIT_SPELLINGS: [(&str, &[&str]); 17] = [
    ("rad/s", &["rads", "radps", "radsec", "radpersec", "rads1", "radianss", "radianspersecond"]),
    ("mrad/s", &["mrads", "mradps"]),
    ("deg/s", &["degs", "dps", "degps", "degsec", "degpersec", "degs1", "degreess", "degreespersecond"]),
    ("mdeg/s", &["mdegs", "mdps", "mdegps"]),
    ("m/s2", &["ms2", "mps2", "mpss", "mss", "msec2", "mpersec2"]),
    ("g", &["g", "gs", "gn"]),
    ("mg", &["mg", "mgs", "millig"]),
    ("uT", &["ut", "microtesla"]),
    ("nT", &["nt", "nanotesla"]),
    ("mT", &["mt", "millitesla"]),
    ("T", &["t", "tesla"]),
    ("gauss", &["gauss", "g", "gs", "ga"]),
    ("mgauss", &["mgauss", "mg", "mga", "milligauss"]),
    ("s", &["s", "sec", "secs", "second", "seconds"]),
    ("ms", &["ms", "msec", "msecs", "millis", "millisecond", "milliseconds"]),
    ("us", &["us", "usec", "usecs", "micros", "microsecond", "microseconds"]),
    ("ns", &["ns", "nsec", "nsecs", "nanos", "nanosecond", "nanoseconds"]),
];

/// Units of quantities that are not read, without the characters that [`plain_unit`] drops.
const OTHER_UNITS: [&str; 14] =
    ["deg", "rad", "degc", "c", "k", "pa", "hpa", "kpa", "mbar", "v", "mv", "m", "hz", "nounits"];

/// Column name that names a quantity.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HeaderName {
    /// Target of the column.
    pub(crate) target: &'static str,
    /// Units found in the name, after the last separator and in brackets.
    pub(crate) units: Vec<&'static str>,
}

/// Parses a name such as `gyro_x (deg/s)`, `GyroX[rad/s]`, `acc_x_mg` or `timestamp_us`.
///
/// Letter case and separators between the words are ignored. The unit is in brackets or the last
/// word. It must be one of the quantity's units. Returns `None` for any other name.
pub(crate) fn parse(name: &str) -> Option<HeaderName> {
    if name.len() > MAX_NAME_BYTES {
        return None;
    }
    let plain = without_unit(name);
    let (target, last_word) = target_of(plain).map(|target| (target, None)).or_else(|| {
        word_starts(plain).find_map(|at| {
            let (left, right) = plain.split_at_checked(at)?;
            let target = target_of(left)?;
            Some((target, Some(unit_of_target(target, right)?)))
        })
    })?;
    let in_brackets = bracketed(name).and_then(|text| unit_of_target(target, text));
    Some(HeaderName { target, units: last_word.into_iter().chain(in_brackets).collect() })
}

/// Returns the units in the name of a column that holds `target`.
pub(crate) fn units(target: &str, name: &str) -> Vec<&'static str> {
    match parse(name) {
        Some(parsed) if parsed.target == target => parsed.units,
        _ => bracketed(name).and_then(|text| unit_of_target(target, text)).into_iter().collect(),
    }
}

/// Returns the column names with the units of the following line, such as `wx [rad/s]`. Returns
/// `None` unless each field of that line is a unit, or blank.
pub fn names_with_units(names: &[&str], units: &[&str]) -> Option<Vec<String>> {
    let is_unit = |text: &str| {
        let text = plain_unit(text);
        let is_known = UNIT_SPELLINGS.iter().any(|(_, spellings)| spellings.contains(&text.as_str()));
        is_known || OTHER_UNITS.contains(&text.as_str())
    };
    let is_blank = |text: &str| plain_unit(text).is_empty();
    let is_units = units.iter().all(|text| is_blank(text) || is_unit(text)) && units.iter().any(|text| is_unit(text));
    let with_unit = |(name, unit): (&&str, &&str)| {
        let unit = unit.trim_matches(['[', ']', '(', ')']);
        if is_blank(unit) { (*name).to_owned() } else { format!("{name} [{unit}]") }
    };
    (is_units && names.len() == units.len()).then(|| names.iter().zip(units).map(with_unit).collect())
}

/// Returns the text in brackets at the end of a column name: `rad/s` for `wx [rad/s]`.
fn bracketed(name: &str) -> Option<&str> {
    name.trim_ascii_end().strip_prefix(without_unit(name)).filter(|rest| !rest.is_empty())
}

/// Returns the positions at which the last words of a name start: after each separator, and at each
/// capital letter that follows a lower-case letter.
fn word_starts(name: &str) -> impl Iterator<Item = usize> + '_ {
    let pairs = name.char_indices().zip(name.chars().skip(1));
    pairs.filter_map(|((at, first), second)| {
        let is_start = SEPARATORS.contains(&first) || first.is_lowercase() && second.is_uppercase();
        is_start.then_some(at + first.len_utf8())
    })
}

fn target_of(name: &str) -> Option<&'static str> {
    let name = name.to_lowercase().replace(SEPARATORS, "");
    let name = name.strip_prefix('#').unwrap_or(&name);
    if TIME_STEMS.contains(&name) {
        return Some("t");
    }
    let name = name.strip_prefix("imu").unwrap_or(name);
    let stem = |axis: char| {
        let after = name.strip_prefix(axis).filter(|stem| stem.len() >= MIN_STEM_AFTER_AXIS);
        [name.strip_suffix(axis), after]
    };
    AXES.into_iter().enumerate().find_map(|(index, axis)| {
        let stems = stem(axis);
        let (targets, _) = STEMS.iter().find(|(_, known)| stems.iter().flatten().any(|stem| known.contains(stem)))?;
        targets.get(index).copied()
    })
}

fn unit_of_target(target: &str, text: &str) -> Option<&'static str> {
    let text = plain_unit(text);
    let spelled = UNIT_SPELLINGS.iter().filter(|(_, spellings)| spellings.contains(&text.as_str()));
    spelled.map(|(name, _)| *name).find(|name| unit_named(name).is_some_and(|unit| unit.measures(target)))
}

/// Returns a unit in lower case, keeping only its letters and digits. `µ`, `°` and `²` are spelt in
/// ASCII.
fn plain_unit(text: &str) -> String {
    let text = text.to_lowercase().replace(['µ', 'μ'], "u").replace('²', "2").replace('°', "deg");
    text.replace(|found: char| !found.is_ascii_alphanumeric(), "")
}

/// Error in the units given by column names.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HeaderError {
    /// Column names give different units for the same quantity.
    #[error("the column names {first:?} and {second:?} state the units {} of the {quantity}", units.join(" and "))]
    DifferentUnits {
        /// Quantity of the columns.
        quantity: &'static str,
        /// First column.
        first: String,
        /// Second column.
        second: String,
        /// Units of the two columns.
        units: [&'static str; 2],
        /// Unit list that resolves the error if the user sets it as `units`.
        remedy: String,
    },
    /// The column names give no unit for a quantity, and the names do not imply a usual unit.
    #[error("the column names {} state no unit", names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", "))]
    MissingUnits {
        /// One column name for each quantity without a unit.
        names: Vec<String>,
        /// Unit list that resolves the error if the user sets it as `units`.
        remedy: String,
    },
}

impl HeaderError {
    /// Returns the unit list that resolves the error if the user sets it as `units`.
    pub fn remedy(&self) -> &str {
        match self {
            Self::DifferentUnits { remedy, .. } | Self::MissingUnits { remedy, .. } => remedy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_and_units_are_found_in_column_names() {
        for (name, target, units) in [
            ("gyro_x (deg/s)", "gx", &["deg/s"][..]),
            ("gyro_x_dps", "gx", &["deg/s"]),
            ("GyroX[rad/s]", "gx", &["rad/s"]),
            ("Gyroscope Y (°/s)", "gy", &["deg/s"]),
            ("acc_x (g)", "ax", &["g"]),
            ("AccZ_mg", "az", &["mg"]),
            ("accel_x_mps2", "ax", &["m/s2"]),
            ("a_RS_S_x [m s^-2]", "ax", &["m/s2"]),
            ("w_RS_S_z [rad s^-1]", "gz", &["rad/s"]),
            ("wx(rad/s)", "gx", &["rad/s"]),
            ("gx_rad_s", "gx", &["rad/s"]),
            ("imu_gyro_x_mdps", "gx", &["mdeg/s"]),
            ("mag_x_uT", "mx", &["uT"]),
            ("MagX (mGauss)", "mx", &["mgauss"]),
            ("mag_y (µT)", "my", &["uT"]),
            ("mag.z [G]", "mz", &["gauss"]),
            ("x_gyro_dps", "gx", &["deg/s"]),
            ("time (s)", "t", &["s"]),
            ("timestamp_us", "t", &["us"]),
            ("timestamp [ns]", "t", &["ns"]),
            ("t[ms]", "t", &["ms"]),
            ("t_s", "t", &["s"]),
            ("timeMs", "t", &["ms"]),
            ("gyro_x_dps (rad/s)", "gx", &["deg/s", "rad/s"]),
            ("gyro_x", "gx", &[]),
            ("gyro_x (raw)", "gx", &[]),
            ("Time", "t", &[]),
        ] {
            let found = parse(name);
            assert_eq!(found, Some(HeaderName { target, units: units.to_vec() }), "{name}");
        }
        for name in
            ["gyro_x_raw", "gyro_x_g", "gyro_temperature", "linear_acceleration_x (g)", "x", "x (g)", "ts", "", "µ"]
        {
            assert_eq!(parse(name), None, "{name}");
        }
        assert_eq!(units("gx", "p [deg/s]"), ["deg/s"]);
        let names = ["id", "wx", "fx"];
        let joined = names_with_units(&names, &["", "[rad/s]", "m/s²"]);
        assert_eq!(joined, Some(vec!["id".into(), "wx [rad/s]".into(), "fx [m/s²]".into()]));
        for line in [["", "", ""], ["1", "rad/s", "g"], ["a", "b", "c"]] {
            assert_eq!(names_with_units(&names, &line), None, "{line:?}");
        }
        assert_eq!(names_with_units(&names, &["rad/s", "g"]), None);
        assert_eq!(units("gx", "p [m/s2]"), [""; 0]);
    }
}
