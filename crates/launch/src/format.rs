//! Byte formats of ports, and the keys of each format.

use mapping::{FORCE, Mapping, MappingError, RATE};
use serde::{Deserialize, Serialize};

use crate::{
    problem::{Problem, nearest},
    toml_reader::Section,
};

/// Allowed widths of a time counter, bits.
const TIME_BITS: std::ops::RangeInclusive<u64> = 1..=63;

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
    Xsens {
        /// Scale of the magnetometer, µT per unit.
        field_unit_ut: f64,
    },
    /// BNO08x in UART-RVC mode.
    Rvc,
    /// IMU and receiver of an autopilot.
    Mavlink(Autopilot),
}

/// Meaning of the columns, as for `plumb import`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Columns {
    /// Comma-separated pairs `QUANTITY=COLUMN`. Empty if columns are named by their quantity.
    pub map: String,
    /// Comma-separated units. Empty for SI units.
    pub units: String,
    /// Axes. Empty for `rfu`.
    pub frame: String,
    /// Comma-separated column names in order. Empty if a header line names them.
    pub columns: String,
    /// Width of the time counter, bits. 0 if the time does not wrap.
    pub time_bits: u64,
}

/// Scales of a WitMotion sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WitMotion {
    /// Measuring range of the accelerometer, g.
    pub range_g: f64,
    /// Measuring range of the gyro, °/s.
    pub range_deg_s: f64,
    /// Scale of the magnetometer, µT per unit. 0 to ignore the magnetometer.
    pub field_unit_ut: f64,
}

/// Selection of the autopilot messages to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Autopilot {
    /// MAVLink system ID. 0 selects the first system received.
    pub system: u64,
    /// Message to take rate and force from. `None` takes whichever arrives first.
    pub imu: Option<ImuMessage>,
    /// Message to take the velocity from. `None` to ignore fixes.
    pub fix: Option<FixMessage>,
}

/// MAVLink message with rate and force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuMessage {
    /// HIGHRES_IMU.
    HighresImu,
    /// SCALED_IMU.
    ScaledImu,
    /// SCALED_IMU2.
    ScaledImu2,
    /// SCALED_IMU3.
    ScaledImu3,
    /// RAW_IMU, with the units of ArduPilot: mrad/s, mg and mgauss.
    RawImu,
}

/// MAVLink message with a velocity over ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FixMessage {
    /// GPS_RAW_INT.
    GpsRawInt,
    /// GLOBAL_POSITION_INT.
    GlobalPositionInt,
}

/// Format of the bytes from a satellite receiver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReceiverFormat {
    /// UBX-NAV-PVT of a u-blox receiver.
    Ubx,
    /// RMC and VTG of NMEA 0183.
    Nmea,
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
            Self::Xsens { .. } => "xsens",
            Self::Rvc => "rvc",
            Self::Mavlink(_) => "mavlink",
        }
    }

    /// Returns `true` for a text format. A line of text ends at a newline, or at the end of the
    /// datagram or the input.
    pub const fn is_text(&self) -> bool {
        matches!(self, Self::Csv(_))
    }

    /// Returns the default MAVLink format: the first system received, with GPS fixes.
    pub(crate) const fn mavlink() -> Self {
        Self::Mavlink(Autopilot { system: 0, imu: None, fix: Some(FixMessage::GpsRawInt) })
    }

    /// Returns every format with the factory settings of the devices.
    fn all() -> [Self; 6] {
        let wit_motion = WitMotion { range_g: 16.0, range_deg_s: 2000.0, field_unit_ut: 0.1 };
        [
            Self::default(),
            Self::Protobuf,
            Self::WitMotion(wit_motion),
            Self::Xsens { field_unit_ut: 49.0 },
            Self::Rvc,
            Self::mavlink(),
        ]
    }

    /// Reads the keys of the MAVLink format. Does nothing for other formats.
    pub(crate) fn mavlink_keys(&mut self, section: &mut Section<'_, '_>) {
        let Self::Mavlink(Autopilot { system, imu, fix }) = self else { return };
        section.integer("system", 0..=255, system);
        let messages = [
            ("first", None),
            ("highres_imu", Some(ImuMessage::HighresImu)),
            ("scaled_imu", Some(ImuMessage::ScaledImu)),
            ("scaled_imu2", Some(ImuMessage::ScaledImu2)),
            ("scaled_imu3", Some(ImuMessage::ScaledImu3)),
            ("raw_imu", Some(ImuMessage::RawImu)),
        ];
        section.choice("imu", messages, imu);
        let messages = [
            ("gps_raw_int", Some(FixMessage::GpsRawInt)),
            ("global_position_int", Some(FixMessage::GlobalPositionInt)),
            ("off", None),
        ];
        section.choice("fix", messages, fix);
    }
}

impl ReceiverFormat {
    /// Returns the name of the format in a launch file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ubx => "ubx",
            Self::Nmea => "nmea",
        }
    }

    pub(crate) const NAMES: [(&str, Self); 2] = [("ubx", Self::Ubx), ("nmea", Self::Nmea)];
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

/// Reads `format` and the keys of that format.
pub(crate) fn stream_format(section: &mut Section<'_, '_>, out: &mut Format) {
    let all = Format::all().map(|format| (format.name(), format));
    let mut chosen = out.clone();
    section.choice("format", all, &mut chosen);
    if chosen.name() != out.name() {
        *out = chosen;
    }
    match out {
        Format::Csv(columns) => csv(section, columns),
        Format::WitMotion(WitMotion { range_g, range_deg_s, field_unit_ut }) => {
            section.number("range_g", 1.0..=1000.0, range_g);
            section.number("range_deg_s", 1.0..=100_000.0, range_deg_s);
            section.number("field_unit_ut", 0.0..=1000.0, field_unit_ut);
        }
        Format::Xsens { field_unit_ut } => drop(section.number("field_unit_ut", 0.0..=1000.0, field_unit_ut)),
        Format::Mavlink(_) => out.mavlink_keys(section),
        Format::Protobuf | Format::Rvc => {}
    }
}

fn csv(section: &mut Section<'_, '_>, out: &mut Columns) {
    let text = |text: &str| Some(text.to_owned());
    section.parsed("map", r#"pairs as "gx=gyro_x,ax=acc_x""#, text, &mut out.map);
    section.parsed("units", r#"units as "deg/s,g""#, text, &mut out.units);
    section.parsed("frame", r#"axes as "frd""#, text, &mut out.frame);
    section.parsed("columns", r#"names as "t,gx,gy,gz,ax,ay,az""#, text, &mut out.columns);
    section.integer("time_bits", TIME_BITS, &mut out.time_bits);
    let mut report = |key: &'static str, found: String, help: Option<String>| {
        let span = section.span(key).or_else(|| section.span("format")).unwrap_or_default();
        section.report(Problem { help, ..Problem::new(span, format!("{key}: {found}"), "invalid") });
    };
    let mapping = match out.mapping() {
        Ok(mapping) => mapping,
        Err(error) => return report(error.setting(), error.to_string(), None),
    };
    if let Some(names) = out.names() {
        let names: Vec<_> = names.iter().map(String::as_str).collect();
        if let Some(missing) = missing(&mapping, &names) {
            let help = nearest(missing, &names).map(|near| format!("did you mean {near:?}?"));
            report("columns", format!("the column {missing:?} is missing"), help);
        }
    }
    if out.time_bits > 0 && mapping.wrap_period_ns(out.time_bits).is_none() {
        report("time_bits", "expected a counter that wraps within 292 years".into(), None);
    }
}

/// Returns a required column that is not among `names`, if any.
fn missing<'m>(mapping: &'m Mapping, names: &[&str]) -> Option<&'m str> {
    let needed = RATE.into_iter().chain(FORCE).filter_map(|target| mapping.column(target));
    let mapped = mapping.columns().filter(|_| mapping.is_explicit()).map(|(_, column)| column);
    needed.chain(mapped).find(|column| !names.contains(column))
}
