//! How the bytes of a port are to be read, and the keys that each format has.

use mapping::{FORCE, Mapping, MappingError, RATE};
use serde::{Deserialize, Serialize};

use crate::{
    problem::{Problem, nearest},
    walk::Section,
};

/// Bits of a counter.
const TIME_BITS: std::ops::RangeInclusive<u64> = 1..=63;

/// How the bytes of a port are to be read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Lines of numbers.
    Csv(Columns),
    /// Messages of the schema, each with its length before it.
    Protobuf,
    /// Frames of a WitMotion sensor.
    WitMotion(WitMotion),
    /// MTData2 of an Xsens MTi.
    Xsens {
        /// What one unit of the magnetometer stands for, µT.
        field_unit_ut: f64,
    },
    /// A BNO08x in its mode UART-RVC.
    Rvc,
    /// The IMU and the receiver of an autopilot.
    Mavlink(Autopilot),
}

/// Which column is what, in the words of `plumb import`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Columns {
    /// `WHAT=COLUMN` with commas between them; empty where columns are called as what they are.
    pub map: String,
    /// Units with commas between them; empty for SI units.
    pub units: String,
    /// Axes; empty for `rfu`.
    pub frame: String,
    /// The names of the columns in their order, with commas between them; empty where a line names them.
    pub columns: String,
    /// The time is a counter of so many bits; 0 if it is none.
    pub time_bits: u64,
}

/// What the numbers of a WitMotion sensor stand for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WitMotion {
    /// Range of the accelerometer, g.
    pub range_g: f64,
    /// Range of the gyro, °/s.
    pub range_deg_s: f64,
    /// What one unit of the magnetometer stands for, µT; 0 where it is not to be used.
    pub field_unit_ut: f64,
}

/// What is read of an autopilot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Autopilot {
    /// The system to hear; 0 for the first that is heard.
    pub system: u64,
    /// The message with rate and force; none for the first that comes.
    pub imu: Option<ImuMessage>,
    /// The message with the velocity; none where it is not to be used.
    pub fix: Option<FixMessage>,
}

/// A message of MAVLink with rate and force.
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
    /// RAW_IMU, whose numbers are mrad/s, mg and mgauss, as ArduPilot sends them.
    RawImu,
}

/// A message of MAVLink with a velocity over ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FixMessage {
    /// GPS_RAW_INT.
    GpsRawInt,
    /// GLOBAL_POSITION_INT.
    GlobalPositionInt,
}

/// How the bytes of a receiver are to be read.
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
    /// Its name in a launch file.
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

    /// Its messages are lines, and end where a line, a datagram or the input ends.
    pub const fn is_text(&self) -> bool {
        matches!(self, Self::Csv(_))
    }

    /// What the first system that is heard sends.
    pub(crate) const fn mavlink() -> Self {
        Self::Mavlink(Autopilot { system: 0, imu: None, fix: Some(FixMessage::GpsRawInt) })
    }

    /// Every format with its settings as devices leave the factory.
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

    /// The keys of MAVLink, where it is that.
    pub(crate) fn mavlink_keys(&mut self, section: &mut Section<'_, '_>) {
        let Self::Mavlink(Autopilot { system, imu, fix }) = self else { return };
        section.count("system", 0..=255, system);
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
    /// Its name in a launch file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ubx => "ubx",
            Self::Nmea => "nmea",
        }
    }

    pub(crate) const NAMES: [(&str, Self); 2] = [("ubx", Self::Ubx), ("nmea", Self::Nmea)];
}

impl Columns {
    /// Which column is what.
    pub fn mapping(&self) -> Result<Mapping, MappingError> {
        let said = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
        let maps: Vec<_> = said(&self.map).into_iter().collect();
        Mapping::parse_live(&maps, said(&self.units).as_deref(), said(&self.frame).as_deref())
    }

    /// The names of the columns, where they are said.
    pub fn names(&self) -> Option<Vec<String>> {
        (!self.columns.is_empty()).then(|| self.columns.split(',').map(|name| name.trim().to_owned()).collect())
    }
}

/// The format and its keys.
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
    section.text("map", r#"pairs as "gx=gyro_x,ax=acc_x""#, text, &mut out.map);
    section.text("units", r#"units as "deg/s,g""#, text, &mut out.units);
    section.text("frame", r#"axes as "frd""#, text, &mut out.frame);
    section.text("columns", r#"names as "t,gx,gy,gz,ax,ay,az""#, text, &mut out.columns);
    section.count("time_bits", TIME_BITS, &mut out.time_bits);
    let mut report = |key: &'static str, found: String, help: Option<String>| {
        let span = section.span(key).or_else(|| section.span("format")).unwrap_or_default();
        section.report(Problem { help, ..Problem::new(span, format!("{key}: {found}"), "this cannot be read") });
    };
    let mapping = match out.mapping() {
        Ok(mapping) => mapping,
        Err(error) => return report(error.about(), error.to_string(), None),
    };
    if let Some(names) = out.names() {
        let names: Vec<_> = names.iter().map(String::as_str).collect();
        if let Some(missing) = missing(&mapping, &names) {
            let help = nearest(missing, &names).map(|near| format!("did you mean {near:?}?"));
            report("columns", format!("found no {missing:?} among them"), help);
        }
    }
    if out.time_bits > 0 && mapping.period_ns(out.time_bits).is_none() {
        report("time_bits", "a counter that begins again within 292 years was expected".into(), None);
    }
}

/// A column that must be there and is not.
fn missing<'m>(mapping: &'m Mapping, names: &[&str]) -> Option<&'m str> {
    let needed = RATE.into_iter().chain(FORCE).filter_map(|target| mapping.column(target));
    let said = mapping.columns().filter(|_| mapping.is_said()).map(|(_, column)| column);
    needed.chain(said).find(|column| !names.contains(column))
}
