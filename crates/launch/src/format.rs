//! Byte formats of ports, and the keys of each format.

use mapping::{FORCE, Mapping, MappingError, RATE, names::nearest};
use serde::{Deserialize, Serialize};

use crate::{
    description::Key,
    keys::{Kind, Named, choices, keys},
    kind::{one_of, text},
    problem::Problem,
    toml_reader::Section,
};

/// Format of the bytes from a port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Lines of comma-separated numbers.
    Csv(Columns),
    /// Protobuf messages, each preceded by its length.
    Protobuf,
    /// Frames of a WitMotion sensor.
    WitMotion(WitMotion),
    /// MTData2 of an Xsens MTi.
    Xsens(Xsens),
    /// BNO08x in UART-RVC mode.
    Rvc,
    /// IMU and receiver of an autopilot.
    Mavlink(Autopilot),
}

keys! {
    /// Meaning of the columns, as for `plumb import`.
    #[derive(Eq)]
    pub struct Columns {
        /// Columns of quantities, as comma-separated pairs `QUANTITY=COLUMN`, such as
        /// "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz". If not set, columns are named by their
        /// quantity.
        map: String = String::new(), text(r#"pairs as "gx=gyro_x,ax=acc_x""#, owned);
        /// Comma-separated units, such as "deg/s,g,ms". If not set, SI units.
        units: String = String::new(), text(r#"units as "deg/s,g""#, owned);
        /// Axes: "rfu" (if not set), "flu" or "frd".
        frame: String = String::new(), text(r#"axes as "frd""#, owned);
        /// Comma-separated column names in order. If not set, a header line names them.
        columns: String = String::new(), text(r#"names as "t,gx,gy,gz,ax,ay,az""#, owned);
        /// Width of the time counter. If not set, the time does not wrap.
        time_bits: u64 = 0, 1..=63, unit "bits";
    }
}

fn owned(text: &str) -> Option<String> {
    Some(text.into())
}

/// Allowed scales of a magnetometer, µT per unit.
const FIELD_UNIT_UT: std::ops::RangeInclusive<f64> = 0.0..=1000.0;

keys! {
    /// Scales of a WitMotion sensor.
    #[derive(Copy)]
    pub struct WitMotion {
        /// Measuring range of the accelerometer.
        range_g: f64 = 16.0, 1.0..=1000.0, unit "g";
        /// Measuring range of the gyro.
        range_deg_s: f64 = 2000.0, 1.0..=100_000.0, unit "°/s";
        /// Scale of the magnetometer. 0 ignores the magnetometer.
        field_unit_ut: f64 = 0.1, FIELD_UNIT_UT, unit "µT per unit";
    }
}

keys! {
    /// Scales of an Xsens MTi.
    #[derive(Copy)]
    pub struct Xsens {
        /// Scale of the magnetometer.
        field_unit_ut: f64 = 49.0, FIELD_UNIT_UT, unit "µT per unit";
    }
}

keys! {
    /// Selection of the autopilot messages to use.
    #[derive(Copy, Eq)]
    pub struct Autopilot {
        /// MAVLink system ID. 0 selects the first system received.
        system: u64 = 0, 0..=255;
        /// Message to take rate and force from. "first" takes whichever arrives first.
        imu: Option<ImuMessage> = None, one_of(with_none("first"));
        /// Message to take the velocity from.
        fix: Option<FixMessage> = Some(FixMessage::GpsRawInt), one_of(with_none("off"));
    }
}

/// Returns the names of `T`, and a name for `None`.
fn with_none<T: Named + Copy>(none: &'static str) -> impl Iterator<Item = (&'static str, Option<T>)> {
    [(none, None)].into_iter().chain(T::NAMES.iter().map(|(name, value)| (*name, Some(*value))))
}

choices! {
    /// MAVLink message with rate and force.
    #[derive(Eq)]
    pub enum ImuMessage {
        /// HIGHRES_IMU.
        HighresImu = "highres_imu",
        /// SCALED_IMU.
        ScaledImu = "scaled_imu",
        /// SCALED_IMU2.
        ScaledImu2 = "scaled_imu2",
        /// SCALED_IMU3.
        ScaledImu3 = "scaled_imu3",
        /// RAW_IMU, with the units of ArduPilot: mrad/s, mg and mgauss.
        RawImu = "raw_imu",
    }
}

choices! {
    /// MAVLink message with a velocity over ground.
    #[derive(Eq)]
    pub enum FixMessage {
        /// GPS_RAW_INT.
        GpsRawInt = "gps_raw_int",
        /// GLOBAL_POSITION_INT.
        GlobalPositionInt = "global_position_int",
    }
}

choices! {
    /// Format of the bytes from a satellite receiver.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum ReceiverFormat {
        /// UBX-NAV-PVT of a u-blox receiver.
        Ubx = "ubx",
        /// RMC and VTG of NMEA 0183.
        Nmea = "nmea",
    }
}

impl Default for Format {
    fn default() -> Self {
        Self::Csv(Columns::default())
    }
}

impl Format {
    /// Returns the name of the format in a launch file.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Csv(_) => "csv",
            Self::Protobuf => "protobuf",
            Self::WitMotion(_) => "witmotion",
            Self::Xsens(_) => "xsens",
            Self::Rvc => "rvc",
            Self::Mavlink(_) => "mavlink",
        }
    }

    /// Returns `true` for a text format. A line of text ends at a newline, or at the end of the
    /// datagram or the input.
    pub const fn is_text(&self) -> bool {
        matches!(self, Self::Csv(_))
    }

    /// Returns every format with the factory settings of the devices.
    fn all() -> [(&'static str, Self); 6] {
        [
            Self::default(),
            Self::Protobuf,
            Self::WitMotion(WitMotion::default()),
            Self::Xsens(Xsens::default()),
            Self::Rvc,
            Self::Mavlink(Autopilot::default()),
        ]
        .map(|format| (format.name(), format))
    }

    /// Reads the keys that belong to the format.
    pub(crate) fn read_keys(&mut self, section: &mut Section<'_, '_>) {
        match self {
            Self::Csv(columns) => {
                columns.read_keys(section);
                check_columns(section, columns);
            }
            Self::WitMotion(scales) => scales.read_keys(section),
            Self::Xsens(scales) => scales.read_keys(section),
            Self::Mavlink(autopilot) => autopilot.read_keys(section),
            Self::Protobuf | Self::Rvc => {}
        }
    }
}

/// Reads `format` and the keys of that format. If the format does not change, its keys keep their
/// values.
pub(crate) fn stream_format(section: &mut Section<'_, '_>, key: Key, out: &mut Format) {
    match section.path() {
        // These sources have one format only.
        "ingest.mavlink" => return out.read_keys(section),
        "ingest.iio" => return,
        _ => {}
    }
    let mut chosen = out.clone();
    one_of(Format::all()).read(section, key, &mut chosen);
    if chosen.name() != out.name() {
        *out = chosen;
    }
    section.variants(key.name, out, Format::all(), |section, format| format.read_keys(section));
}

impl Columns {
    /// Returns the mapping from columns to quantities.
    ///
    /// # Errors
    ///
    /// Returns an error if `map`, `units` or `frame` is invalid.
    pub fn mapping(&self) -> Result<Mapping, MappingError> {
        let non_empty = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
        let maps: Vec<_> = non_empty(&self.map).into_iter().collect();
        Mapping::parse_live(&maps, non_empty(&self.units).as_deref(), non_empty(&self.frame).as_deref())
    }

    /// Returns the column names, or `None` if a header line names them.
    pub fn names(&self) -> Option<Vec<String>> {
        (!self.columns.is_empty()).then(|| self.columns.split(',').map(|name| name.trim().to_owned()).collect())
    }
}

/// Reports a mapping that is invalid or incomplete.
fn check_columns(section: &mut Section<'_, '_>, columns: &Columns) {
    let mut report = |key: &'static str, found: String, help: Option<String>| {
        let span = section.span(key).or_else(|| section.span("format")).unwrap_or_default();
        section.report(Problem { help, ..Problem::new(span, format!("{key}: {found}"), "invalid") });
    };
    let mapping = match columns.mapping() {
        Ok(mapping) => mapping,
        Err(error) => return report(error.setting(), error.to_string(), None),
    };
    if let Some(names) = columns.names() {
        let names: Vec<_> = names.iter().map(String::as_str).collect();
        if let Some(missing) = missing(&mapping, &names) {
            let help = nearest(missing, names.iter().copied()).map(|near| format!("did you mean {near:?}?"));
            report("columns", format!("the column {missing:?} is missing"), help);
        }
    }
    if columns.time_bits > 0 && mapping.wrap_period_ns(columns.time_bits).is_none() {
        report("time_bits", "expected a counter that wraps within 292 years".into(), None);
    }
}

/// Returns a required column that is not among `names`, if any.
fn missing<'m>(mapping: &'m Mapping, names: &[&str]) -> Option<&'m str> {
    let needed = RATE.into_iter().chain(FORCE).filter_map(|target| mapping.column(target));
    let mapped = mapping.columns().filter(|_| mapping.is_explicit()).map(|(_, column)| column);
    needed.chain(mapped).find(|column| !names.contains(column))
}
