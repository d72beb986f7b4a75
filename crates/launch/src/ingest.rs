//! Source of the samples, and their limits: `[ingest]`.

use attitude::{conditioner::Limits, gyro::RateKind, parameters::Parameters as _};
use scenario::{Motion, PARAMETERS, Parameter, Scenario, ScenarioError};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};

use crate::{
    description::Key,
    fault::{self, Fault},
    keys::{Kind, choices, keys},
    kind::{By, File, FileOr, Flag, Inline, NATURAL, Optional, Table, choice, one_of, read_parameters},
    live_sources::{DEFAULT_RATE_HZ, LiveSources, Port, RATE_RANGE_HZ, Stream},
    problem::Problem,
    sensors::{self, Calibrations, GyroSamples, IDENTITY},
    toml_reader::Section,
};

keys! {
    /// Source of the samples, and the limits, calibration, mounting and faults that are applied to
    /// them.
    pub struct Ingest {
        /// Selected source, see docs/how-to/sensors.md. `plumb up --source
        /// 'serial:/dev/ttyUSB0?format=witmotion'` overrides it.
        source: Source = Source::Sim, choice();
        /// Simulated sensors on a moving body. The errors of the scenario, such as
        /// `gyro_bias_deg_s`, can also be set, see docs/reference/launch-file.md.
        sim: Sim = Sim::default(), Table(Sim::read);
        /// Replay of a recorded flight.
        replay: Replay = Replay::default(), Table(Replay::read_keys);
        /// Samples published on the bus by another process, on the topic `sensor`. The publisher
        /// opens the topic with a buffer of buffer_s · rate_hz readings, at least 256.
        bus: BusSource = BusSource::default(), Table(BusSource::read_keys);
        /// Settings of sources that send in real time.
        live: LiveSources = LiveSources::default(), Inline(LiveSources::read_keys);
        /// Limits beyond which samples are flagged.
        limits: Limits = Limits::default(), Table(limits);
        /// Calibration of each sensor, in sensor axes.
        calibration: Calibrations = Calibrations::default(), Table(Calibrations::read_keys);
        /// Rotation from sensor axes to body axes, by `axes`, angles, a quaternion or a matrix.
        /// Without any of them, sensor axes are body axes.
        mounting: [[f64; 3]; 3] = IDENTITY, Table(sensors::mounting);
        /// Injected fault. At most 64 are applied, in this order. Affected ticks have the flag
        /// fault-injected. Requires `faults = true` at the top of the file.
        faults as "fault": Vec<Fault> = Vec::new(), fault::FAULTS;
    }
}

impl Ingest {
    /// Reads `[ingest]` and checks that the selected source is configured.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>) {
        let before = section.problem_count();
        self.read_keys(section);
        require_port(section, self);
        if self.source == Source::Replay && self.replay.file.as_os_str().is_empty() && section.problem_count() == before
        {
            let file = section.table_span("replay", "file");
            let span = file.or_else(|| section.span("source")).unwrap_or_default();
            section.report(Problem {
                help: Some(r#"set a recording: file = "flight.csv.gz" in [ingest.replay]"#.into()),
                ..Problem::new(span, "ingest.replay.file: a replay needs a file, but none is set", "no file to replay")
            });
        }
    }
}

keys! {
    /// Settings of simulated sensors on a moving body.
    pub struct Sim {
        /// Motion. "s1" is the reference scenario of Matveev 2025.
        scenario: String = "s1".into(), one_of(Motion::NAMES.map(|name| (name, name.to_owned())));
        /// Sample rate.
        rate_hz: f64 = 1000.0, RATE_RANGE_HZ, unit "Hz";
        /// Seed of the noise. The same seed gives the same samples.
        seed: u64 = 1, NATURAL;
        /// Parameters that override those of the scenario, keyed by the names in
        /// `scenario::PARAMETERS`.
        #[serde(default)]
        set: BTreeMap<String, f64> = BTreeMap::new(), By(scenario_parameters);
    }
}

/// Reads every parameter of a scenario as a separate key.
fn scenario_parameters(section: &mut Section<'_, '_>, _: Key, out: &mut BTreeMap<String, f64>) {
    for Parameter { name, min, max, description, .. } in &PARAMETERS {
        let mut value = f64::NAN;
        let key = Key { name, doc: description, unit: "", example: "" };
        (*min..=*max).read(section, key, &mut value);
        section.describe_as_not_set(key);
        if section.is_set(name) {
            out.insert((*name).into(), value);
        }
    }
}

impl Sim {
    fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        if let Err(error @ ScenarioError::NotApplicable { key, .. }) = self.scenario() {
            let span = section.span(key).unwrap_or_default();
            section.report(Problem::new(span, error.to_string(), "not in this scenario"));
        }
    }

    /// Returns the scenario with all parameters applied.
    ///
    /// # Errors
    ///
    /// Returns an error if the scenario or a parameter is unknown or not allowed.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        let mut scenario = Scenario::parse(&self.scenario)?.with_seed(self.seed).with_rate_hz(self.rate_hz);
        self.set.iter().try_for_each(|(name, value)| scenario.set(name, *value))?;
        Ok(scenario)
    }

    /// Returns the kind of rate sample that the scenario produces.
    pub fn gyro_samples(&self) -> GyroSamples {
        match Scenario::parse(&self.scenario).map(|scenario| scenario.rate_kind) {
            Ok(RateKind::Mean) => GyroSamples::Means,
            Ok(RateKind::Instant) | Err(_) => GyroSamples::Instants,
        }
    }
}

keys! {
    /// Settings for replaying a recorded flight.
    pub struct Replay {
        /// Recording. `plumb up --replay` overrides it.
        file: PathBuf = PathBuf::new(), File, example r#""flight.csv.gz""#;
        /// Kind of rate sample.
        gyro_samples: GyroSamples = GyroSamples::Means, choice();
        /// `true` to use the magnetometer columns mx, my and mz, if present.
        mag: bool = true, Flag;
        /// Fixes of the satellite receiver. "auto" is NAME_gnss.csv in the folder of NAME_imu.csv
        /// or NAME_imu.csv.gz, if it exists.
        gnss: Gnss = Gnss::Auto, FileOr { auto: Gnss::Auto, off: Gnss::Off, file: Gnss::File };
    }
}

/// Location of the fixes of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gnss {
    /// `NAME_gnss.csv` in the folder of `NAME_imu.csv` or `NAME_imu.csv.gz`, if it exists.
    Auto,
    /// No fixes.
    Off,
    /// Fixes in this file.
    File(PathBuf),
}

keys! {
    /// Settings for samples that another process publishes on the bus.
    pub struct BusSource {
        /// Sample rate. If it is not set, buffers are made for 1000 Hz.
        rate_hz: Option<f64> = None, Optional(RATE_RANGE_HZ), unit "Hz", example "200";
        /// Kind of rate sample.
        gyro_samples: GyroSamples = GyroSamples::Means, choice();
    }
}

/// Reads the limits, which `attitude` declares with the checks.
fn limits(out: &mut Limits, section: &mut Section<'_, '_>) {
    read_parameters(section, Limits::TABLE, |name, value| {
        // The value is within the range of the parameter, so it is accepted.
        let _ = out.set(name, value);
    });
}

choices! {
    /// Source of samples.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum Source {
        /// Simulated sensors.
        Sim = "sim",
        /// A recorded flight.
        Replay = "replay",
        /// Another process, over the bus.
        Bus = "bus",
        /// Standard input of the supervisor.
        Stdin = "stdin",
        /// UDP datagrams.
        Udp = "udp",
        /// TCP connection.
        Tcp = "tcp",
        /// Serial line.
        Serial = "serial",
        /// Autopilot over MAVLink.
        Mavlink = "mavlink",
        /// Device of Linux industrial I/O.
        Iio = "iio",
    }
}

impl Source {
    /// Returns `true` if the service `drivers` reads this source.
    pub const fn needs_drivers(self) -> bool {
        matches!(self, Self::Stdin | Self::Udp | Self::Tcp | Self::Serial | Self::Mavlink | Self::Iio)
    }

    /// Returns `true` if the source is finite and another process can read it again from the start.
    pub const fn is_repeatable(self) -> bool {
        matches!(self, Self::Sim | Self::Replay)
    }

    /// Returns `true` if the source waits for its slowest subscriber, so that no reading is lost at
    /// any speed.
    pub const fn is_blocking(self) -> bool {
        matches!(self, Self::Replay | Self::Stdin)
    }
}

impl Ingest {
    /// Returns the stream settings of the source, or `None` if the source has no stream.
    pub fn stream(&self) -> Option<&Stream> {
        match self.source {
            Source::Stdin => Some(&self.live.stdin.stream),
            Source::Udp => Some(&self.live.udp.stream),
            Source::Tcp => Some(&self.live.tcp.stream),
            Source::Serial => Some(&self.live.serial.stream),
            Source::Mavlink => Some(&self.live.mavlink.stream),
            Source::Iio => Some(&self.live.iio.stream),
            Source::Sim | Source::Replay | Source::Bus => None,
        }
    }

    /// Returns the port of the source, or `None` if the source has no port or the port is not set.
    pub fn port(&self) -> Option<Port> {
        match self.source {
            Source::Stdin => Some(Port::Stdin),
            Source::Udp => Some(Port::Udp(self.live.udp.listen.clone())),
            Source::Tcp => self.live.tcp.port(),
            Source::Serial => self.live.serial.port(),
            Source::Mavlink => self.live.mavlink.endpoint.clone(),
            Source::Sim | Source::Replay | Source::Bus | Source::Iio => None,
        }
    }

    /// Returns the sample rate in Hz that is declared for the source, or `None` if none is
    /// declared. A recording contains its own rate.
    pub fn declared_rate_hz(&self) -> Option<f64> {
        match self.source {
            Source::Sim => Some(self.sim.rate_hz),
            Source::Replay => None,
            Source::Bus => self.bus.rate_hz,
            _ => self.stream().and_then(|stream| stream.rate_hz),
        }
    }

    /// Returns the sample rate in Hz for which buffers are made. It is the declared rate, or else
    /// [`DEFAULT_RATE_HZ`].
    pub fn nominal_rate_hz(&self) -> f64 {
        self.declared_rate_hz().unwrap_or(DEFAULT_RATE_HZ)
    }
}

/// Reports a problem if the port or device of the source is missing.
fn require_port(section: &mut Section<'_, '_>, ingest: &Ingest) {
    let remedy = match ingest.source {
        Source::Serial => r#"port = "/dev/ttyUSB0" in [ingest.serial]"#,
        Source::Tcp => r#"connect = "192.168.1.7:5555" in [ingest.tcp]"#,
        Source::Iio => r#"device = "bmi160" in [ingest.iio]; `cat /sys/bus/iio/devices/*/name` lists the devices"#,
        _ => "",
    };
    let is_missing = match ingest.source {
        Source::Serial | Source::Tcp => ingest.port().is_none(),
        Source::Iio => ingest.live.iio.device.is_empty(),
        _ => false,
    };
    if is_missing && section.problem_count() == 0 {
        let span = section.span("source").unwrap_or_default();
        section.report(Problem {
            help: Some(format!("set {remedy}")),
            ..Problem::new(span, "ingest.source: the port or device of the source is not set", "nothing to read")
        });
    }
}
