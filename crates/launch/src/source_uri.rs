//! Source or receiver in one line: `KIND:TARGET?key=value&key=value`, as for `plumb up --source`.
//! A line that starts with `/` is a serial port: `/dev/ttyUSB0` stands for `serial:/dev/ttyUSB0`.
//!
//! The line is converted to the section of its kind and checked like a launch file. For example,
//! `serial:/dev/ttyUSB0?baud=9600` becomes `source = "serial"` with `[ingest.serial] port =
//! "/dev/ttyUSB0"` and `baud = 9600`. Keys that are not in the line keep their values.

use toml::{Table, Value};

use crate::{Launch, problem::Problems};

/// Each kind of source, and the key that the target sets.
const MAIN_KEYS: [(&str, Option<&str>); 9] = [
    ("sim", Some("scenario")),
    ("replay", Some("file")),
    ("bus", None),
    ("stdin", None),
    ("udp", Some("listen")),
    ("tcp", Some("connect")),
    ("serial", Some("port")),
    ("mavlink", Some("endpoint")),
    ("iio", Some("device")),
];

impl Launch {
    /// Replaces the source with the one that `line` describes. A relative path is resolved against
    /// the working folder.
    ///
    /// # Errors
    ///
    /// Returns the problems of the line. `self` is then unchanged.
    pub fn set_source(&mut self, line: &str) -> Result<(), Problems> {
        self.apply_override(format!("--source {line}"), source_section(line))
    }

    /// Replaces the receiver with the one that `line` describes as `ENDPOINT?key=value`.
    ///
    /// # Errors
    ///
    /// Returns the problems of the line. `self` is then unchanged.
    pub fn set_receiver(&mut self, line: &str) -> Result<(), Problems> {
        self.apply_override(format!("--receiver {line}"), receiver_section(line))
    }

    fn apply_override(&mut self, file_name: String, text: String) -> Result<(), Problems> {
        let mut launch = self.clone();
        launch.merge(None, &file_name, &text)?;
        *self = launch;
        Ok(())
    }
}

/// Returns the recording that a source line replays, or `None` for other sources.
pub fn replay_path(line: &str) -> Option<&str> {
    let (target, _) = split_query(line.strip_prefix("replay:")?);
    Some(target)
}

/// Returns the text of a launch file with source and receiver lines applied, to be recorded with a
/// run.
///
/// Comments are lost. Returns `None` if the text or a line is not valid TOML.
pub fn with_overrides(text: &str, source: Option<&str>, receiver: Option<&str>) -> Option<String> {
    let mut launch: Table = text.parse().ok()?;
    for section in source.map(source_section).into_iter().chain(receiver.map(receiver_section)) {
        merge(&mut launch, section.parse().ok()?);
    }
    Some(launch.to_string())
}

fn merge(base: &mut Table, overrides: Table) {
    for (key, value) in overrides {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(base)), Value::Table(overrides)) => merge(base, overrides),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// Converts a source line to a section of a launch file.
fn source_section(line: &str) -> String {
    let (kind_and_target, keys) = split_query(line);
    let (kind, target) = match kind_and_target.starts_with('/') {
        true => ("serial", kind_and_target),
        false => kind_and_target.split_once(':').unwrap_or((kind_and_target, "")),
    };
    let mut section = format!("[ingest]\nsource = {}\n", quoted(kind));
    let Some((_, key)) = MAIN_KEYS.iter().find(|(name, _)| *name == kind) else { return section };
    section += &format!("[ingest.{kind}]\n");
    if !target.is_empty() {
        section += &format!("{} = {}\n", key.unwrap_or("target"), quoted(target));
    }
    section + &pairs(keys)
}

/// Converts a receiver line to a section of a launch file.
fn receiver_section(line: &str) -> String {
    let (endpoint, keys) = split_query(line);
    let prefix = if endpoint.starts_with('/') { "serial:" } else { "" };
    format!("[ingest.receiver]\nendpoint = {}\n{}", quoted(&format!("{prefix}{endpoint}")), pairs(keys))
}

fn pairs(keys: &str) -> String {
    let mut lines = String::new();
    for pair in keys.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
        let is_bare = value.parse::<f64>().is_ok_and(f64::is_finite) || matches!(value, "true" | "false");
        lines += &format!("{} = {}\n", quoted(key), if is_bare { value.into() } else { quoted(value) });
    }
    lines
}

fn quoted(value: &str) -> String {
    Value::from(value).to_string()
}

fn split_query(line: &str) -> (&str, &str) {
    line.split_once('?').unwrap_or((line, ""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Clock, GyroSamples, Port, Service};

    fn with(line: &str) -> Launch {
        let mut launch = Launch::default();
        launch.set_source(line).unwrap();
        launch
    }

    #[test]
    fn source_line_equals_its_section() {
        for (line, text) in [
            (
                "sim:s3?seed=2&rate_hz=200",
                "ingest = { source = \"sim\", sim = { scenario = \"s3\", seed = 2, rate_hz = 200 } }",
            ),
            (
                "replay:a b.csv?mag=false",
                "ingest = { source = \"replay\", replay = { file = \"a b.csv\", mag = false } }",
            ),
            ("bus?rate_hz=100", "ingest = { source = \"bus\", bus.rate_hz = 100 }"),
            ("stdin", "ingest.source = \"stdin\""),
            (
                "udp:[::1]:9?clock=device",
                "ingest = { source = \"udp\", udp = { listen = \"[::1]:9\", clock = \"device\" } }",
            ),
            (
                "serial:/dev/a?format=witmotion&range_g=8&baud=9600",
                "ingest = { source = \"serial\", serial = { port = \"/dev/a\", format = \"witmotion\", range_g = 8, baud = 9600 } }",
            ),
            ("/dev/imu?baud=9600", "ingest = { source = \"serial\", serial = { port = \"/dev/imu\", baud = 9600 } }"),
            (
                "tcp:imu.local:5555?map=gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz&units=deg/s,g&frame=frd",
                "ingest = { source = \"tcp\", tcp = { connect = \"imu.local:5555\", map = \"gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz\", units = \"deg/s,g\", frame = \"frd\" } }",
            ),
            (
                "mavlink:serial:/dev/ttyACM0?baud=57600&imu=raw_imu&fix=off&system=3",
                "ingest = { source = \"mavlink\", mavlink = { endpoint = \"serial:/dev/ttyACM0\", baud = 57600, imu = \"raw_imu\", fix = \"off\", system = 3 } }",
            ),
            (
                "iio:lsm6dsm_gyro?accel_device=lsm6dsm_accel&rate_hz=104",
                "ingest = { source = \"iio\", iio = { device = \"lsm6dsm_gyro\", accel_device = \"lsm6dsm_accel\", rate_hz = 104 } }",
            ),
            (
                "serial:/dev/ttyUSB0?format=csv&baud=115200&gyro_samples=instants",
                "ingest = { source = \"serial\", serial = { port = \"/dev/ttyUSB0\", gyro_samples = \"instants\" } }",
            ),
        ] {
            assert_eq!(with(line), Launch::parse("launch.toml", text).unwrap(), "{line}");
        }
        assert_eq!((replay_path("replay:a.csv?mag=false"), replay_path("stdin")), (Some("a.csv"), None));
    }

    #[test]
    fn overridden_text_parses_to_the_overridden_launch() {
        let text = "name = \"a\" # mine\n[ingest]\nsource = \"sim\"\nudp.rate_hz = 50\n[ingest.limits]\ngap_s = 0.5\n";
        for line in ["udp:[::1]:9?gyro_samples=instants", "sim:s3?seed=2", "stdin"] {
            let mut launch = Launch::parse("launch.toml", text).unwrap();
            launch.set_source(line).unwrap();
            assert_eq!(
                Launch::parse("launch.toml", &with_overrides(text, Some(line), None).unwrap()).unwrap(),
                launch,
                "{line}"
            );
            let receiver = "serial:/dev/ttyACM0?format=nmea&baud=9600";
            launch.set_receiver(receiver).unwrap();
            let both = with_overrides(text, Some(line), Some(receiver)).unwrap();
            assert_eq!(Launch::parse("launch.toml", &both).unwrap(), launch, "{line}");
        }
    }

    #[test]
    fn drivers_run_only_for_sources_that_need_them() {
        let mut launch = with("stdin");
        assert_eq!(launch.services.last(), Some(&Service::Drivers));
        launch.set_source("bus").unwrap();
        assert_eq!(launch.services, Service::LISTED);
        launch.set_receiver("tcp:gnss:1").unwrap();
        assert_eq!(launch.ingest.live.receiver.port, Some(Port::Tcp("gnss:1".into())));
        let mut bare = launch.clone();
        bare.set_receiver("/dev/gnss?format=nmea").unwrap();
        launch.set_receiver("serial:/dev/gnss?format=nmea").unwrap();
        assert_eq!(bare, launch);
        for (source, is_driven) in [("sim", false), ("replay:a.csv", false), ("bus", true), ("udp", true)] {
            launch.set_source(source).unwrap();
            assert_eq!(launch.services.contains(&Service::Drivers), is_driven, "{source}");
        }
        let shown = Launch::parse("launch.toml", "services = [\"drivers\"]").unwrap_err().to_string();
        assert!(shown.contains("unknown value \"drivers\""), "{shown}");
    }

    #[test]
    fn keys_not_in_the_line_keep_their_values() {
        let text = "ingest.udp = { listen = \"0.0.0.0:7\", clock = \"device\", gyro_samples = \"instants\" }";
        let mut launch = Launch::parse("launch.toml", text).unwrap();
        launch.set_source("udp?rate_hz=50").unwrap();
        let udp = &launch.ingest.live.udp;
        assert_eq!(udp.listen, "0.0.0.0:7");
        assert_eq!((udp.stream.clock, udp.stream.rate_hz), (Clock::Device, Some(50.0)));
        assert_eq!(udp.stream.gyro_samples, GyroSamples::Instants);
    }

    #[test]
    fn invalid_line_is_rejected_without_change() {
        for (line, expected) in [
            ("serail:/dev/a", "did you mean \"serial\"?"),
            ("serial:/dev/a?bauds=9600", "did you mean \"baud\"?"),
            ("serial:/dev/a?baud=fast", "expected an integer, found a string"),
            ("serial", "set port = \"/dev/ttyUSB0\" in [ingest.serial]"),
            ("tcp", "set connect"),
            ("iio", "set device"),
            ("tcp:host", "a host and a port"),
            ("mavlink:udpout:1.2.3.4:5", "\"udpin:127.0.0.1:14540\""),
            ("serial:/dev/a?format=witmotoin", "did you mean \"witmotion\"?"),
            ("serial:/dev/a?format=rvc&range_g=8", "unknown key \"range_g\""),
            ("serial:/dev/a?map=gx=wx", "found no gy, gz, ax, ay, az"),
            ("serial:/dev/a?units=dgr/s", "did you mean \"deg/s\"?"),
            ("serial:/dev/a?frame=xyz", "found \"xyz\""),
            ("serial:/dev/a?columns=t,gx,gy,gz,ax,ay", "the column \"az\" is missing"),
            ("serial:/dev/a?units=s&time_bits=60", "expected a counter that wraps within 292 years"),
            ("sim:s1?receiver=1", "unknown key \"receiver\""),
            ("udp:nowhere", "an address and a port"),
            ("stdin:/dev/a", "unknown key \"target\""),
            ("sim:s9", "unknown value \"s9\""),
            ("bus?rate_hz=0", "expected 1 to 10000"),
            ("stdin?rate_hz=1&rate_hz=2", "duplicate key"),
            ("replay", "a replay needs a file"),
        ] {
            let mut launch = Launch::default();
            let problems = launch.set_source(line).unwrap_err().to_string();
            assert!(problems.contains(expected) && problems.contains(line), "{expected}: {problems}");
            assert_eq!(launch, Launch::default());
        }
        for (line, expected) in [
            ("tpc:gnss:1", "\"tcp:HOST:PORT\""),
            ("tcp:gnss:1?format=nema", "did you mean \"nmea\"?"),
            ("tcp:gnss:1?baud=9600", "unknown key \"baud\""),
        ] {
            let problems = Launch::default().set_receiver(line).unwrap_err().to_string();
            assert!(problems.contains(expected) && problems.contains(line), "{expected}: {problems}");
        }
    }
}
