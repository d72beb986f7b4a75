//! Sources that send in real time: their ports, formats and clocks.

use std::{fmt, ops::RangeInclusive, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    GyroSamples, Ingest, Launch, Service, Source,
    format::{Format, ReceiverFormat, stream_format},
    model::BusSource,
    problem::Problem,
    toml_reader::Section,
};

/// Allowed sample rates of any source, Hz.
pub(crate) const RATE_RANGE_HZ: RangeInclusive<f64> = 1.0..=10_000.0;
/// Allowed baud rates of a serial line, bit/s.
const BAUD_RANGE: RangeInclusive<u64> = 50..=20_000_000;
const DEFAULT_BAUD: u64 = 115_200;

/// Settings of a stream of readings, independent of its port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stream {
    /// Format of the bytes.
    pub format: Format,
    /// Treatment of the device's timestamps.
    pub clock: Clock,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Kind of rate sample: the mean over its interval, or the value at the end.
    pub gyro_samples: GyroSamples,
}

/// Treatment of a device's timestamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// Timestamps are used unchanged.
    Device,
    /// Timestamps are converted to this machine's CLOCK_MONOTONIC by a linear fit to the arrival
    /// times.
    Host,
}

/// Port from which bytes are received.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Port {
    /// Standard input of the supervisor.
    Stdin,
    /// UDP datagrams to this local address and port.
    Udp(String),
    /// TCP connection to this host and port, opened by the driver.
    Tcp(String),
    /// A serial line.
    Serial {
        /// Path of the device file.
        path: PathBuf,
        /// Baud rate, bit/s.
        baud: u64,
    },
}

/// Source that is read from a port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PortSource {
    /// Port, or `None` if not set.
    pub port: Option<Port>,
    /// Settings of the stream.
    pub stream: Stream,
}

/// Device of Linux industrial I/O.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IioDevice {
    /// Folder of the devices in sysfs.
    pub root: PathBuf,
    /// Folder of the character devices.
    pub dev: PathBuf,
    /// Name of the device or of its folder. Empty if not set.
    pub device: String,
    /// Name of the accelerometer's device, if gyro and accelerometer are separate devices. Empty
    /// otherwise.
    pub accel_device: String,
    /// Settings of the stream. The device determines the format.
    pub stream: Stream,
}

/// Satellite receiver used in addition to the source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReceiverSource {
    /// Port, or `None` if there is no receiver.
    pub port: Option<Port>,
    /// Format of the bytes.
    pub format: ReceiverFormat,
}

impl Stream {
    /// Creates the settings for CSV lines at 1 kHz with the given clock.
    fn with_clock(clock: Clock) -> Self {
        Self { format: Format::default(), clock, rate_hz: 1000.0, gyro_samples: GyroSamples::Means }
    }
}

/// Settings of all live sources.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveSources {
    /// Source on standard input.
    pub stdin: PortSource,
    /// Source sending UDP datagrams.
    pub udp: PortSource,
    /// Source on a TCP connection.
    pub tcp: PortSource,
    /// Source on a serial line.
    pub serial: PortSource,
    /// Autopilot that speaks MAVLink.
    pub mavlink: PortSource,
    /// Device of Linux industrial I/O.
    pub iio: IioDevice,
    /// Receiver used with any of these sources or the bus. Simulations and recordings ignore it.
    pub receiver: ReceiverSource,
}

impl Default for LiveSources {
    fn default() -> Self {
        let stream = || Stream::with_clock(Clock::Host);
        let loopback = |port: u16| Some(Port::Udp(format!("127.0.0.1:{port}")));
        Self {
            stdin: PortSource { port: Some(Port::Stdin), stream: Stream::with_clock(Clock::Device) },
            udp: PortSource { port: loopback(14_560), stream: stream() },
            tcp: PortSource { port: None, stream: stream() },
            serial: PortSource {
                port: Some(Port::Serial { path: PathBuf::new(), baud: DEFAULT_BAUD }),
                stream: stream(),
            },
            mavlink: PortSource {
                port: loopback(14_540),
                stream: Stream { format: Format::mavlink(), rate_hz: 50.0, ..stream() },
            },
            iio: IioDevice {
                root: "/sys/bus/iio/devices".into(),
                dev: "/dev".into(),
                device: String::new(),
                accel_device: String::new(),
                stream: Stream { rate_hz: 100.0, ..Stream::with_clock(Clock::Device) },
            },
            receiver: ReceiverSource { port: None, format: ReceiverFormat::Ubx },
        }
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdin => f.write_str("standard input"),
            Self::Udp(address) => write!(f, "datagrams to {address}"),
            Self::Tcp(address) => write!(f, "the connection to {address}"),
            Self::Serial { path, .. } => path.display().fmt(f),
        }
    }
}

impl Port {
    /// Parses `udpin:ADDRESS:PORT`, `tcp:HOST:PORT` or `serial:FILE`.
    fn parse(text: &str) -> Option<Self> {
        let (kind, address) = text.split_once(':')?;
        match kind {
            "udpin" => parse_listen_address(address).map(Self::Udp),
            "tcp" => parse_remote_address(address).map(Self::Tcp),
            "serial" if !address.is_empty() => Some(Self::Serial { path: address.into(), baud: DEFAULT_BAUD }),
            _ => None,
        }
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
            Source::Iio => Some(&self.live.iio.stream),
            _ => self.port_source().map(|ported| &ported.stream),
        }
    }

    /// Returns the port of the source, or `None` if the source has no port or the port is not set.
    pub fn port(&self) -> Option<&Port> {
        self.port_source()?
            .port
            .as_ref()
            .filter(|port| !matches!(port, Port::Serial { path, .. } if path.as_os_str().is_empty()))
    }

    /// Returns the sample rate declared for the source, Hz, or `None` for a recording, which
    /// contains its own rate.
    pub fn declared_rate_hz(&self) -> Option<f64> {
        match self.source {
            Source::Sim => Some(self.sim.rate_hz),
            Source::Replay => None,
            Source::Bus => Some(self.bus.rate_hz),
            _ => self.stream().map(|stream| stream.rate_hz),
        }
    }

    fn port_source(&self) -> Option<&PortSource> {
        match self.source {
            Source::Stdin => Some(&self.live.stdin),
            Source::Udp => Some(&self.live.udp),
            Source::Tcp => Some(&self.live.tcp),
            Source::Serial => Some(&self.live.serial),
            Source::Mavlink => Some(&self.live.mavlink),
            Source::Sim | Source::Replay | Source::Bus | Source::Iio => None,
        }
    }
}

impl Launch {
    /// Adds or removes the service `drivers`, depending on whether the source or a receiver needs
    /// it.
    pub(crate) fn add_drivers(&mut self) {
        self.services.retain(|service| *service != Service::Drivers);
        let Ingest { source, live, .. } = &self.ingest;
        // Simulations and recordings have their own time and their own fixes.
        let has_receiver = live.receiver.port.is_some() && !source.is_repeatable();
        if (source.needs_drivers() || has_receiver) && self.services.contains(&Service::Ingest) {
            self.services.push(Service::Drivers);
        }
    }
}

/// Reads the sections of the bus, the live sources and the receiver.
pub(crate) fn live_sources(section: &mut Section<'_, '_>, out: &mut Ingest) {
    section.section("bus", |section| {
        let BusSource { rate_hz, gyro_samples } = &mut out.bus;
        section.number("rate_hz", RATE_RANGE_HZ, rate_hz);
        section.choice("gyro_samples", GyroSamples::ALL, gyro_samples);
    });
    let LiveSources { stdin, udp, tcp, serial, mavlink, iio, receiver } = &mut out.live;
    section.section("stdin", |section| stream(section, &mut stdin.stream));
    section.section("udp", |section| {
        let port = |text: &str| parse_listen_address(text).map(Port::Udp).map(Some);
        section.parsed("listen", r#"an address and a port, such as "0.0.0.0:14560""#, port, &mut udp.port);
        stream(section, &mut udp.stream);
    });
    section.section("tcp", |section| {
        let port = |text: &str| parse_remote_address(text).map(Port::Tcp).map(Some);
        section.parsed("connect", r#"a host and a port, such as "192.168.1.7:5555""#, port, &mut tcp.port);
        stream(section, &mut tcp.stream);
    });
    section.section("serial", |section| {
        if let Some(Port::Serial { path, baud }) = &mut serial.port {
            let file = |text: &str| (!text.is_empty()).then(|| text.into());
            section.parsed("port", r#"a device file, such as "/dev/ttyUSB0""#, file, path);
            section.integer("baud", BAUD_RANGE, baud);
        }
        stream(section, &mut serial.stream);
    });
    section.section("mavlink", |section| {
        endpoint(section, &mut mavlink.port);
        stream_keys(section, &mut mavlink.stream);
        mavlink.stream.format.mavlink_keys(section);
    });
    section.section("iio", |section| {
        let path = |text: &str| (!text.is_empty()).then(|| text.into());
        section.parsed("root", "a folder", path, &mut iio.root);
        section.parsed("dev", "a folder", path, &mut iio.dev);
        let name = |text: &str| (!text.is_empty() && !text.contains('/')).then(|| text.to_owned());
        section.parsed("device", r#"the name of a device, such as "bmi160""#, name, &mut iio.device);
        section.parsed("accel_device", r#"the name of a device, such as "lsm6dsm_accel""#, name, &mut iio.accel_device);
        stream_keys(section, &mut iio.stream);
    });
    section.section("receiver", |section| {
        endpoint(section, &mut receiver.port);
        section.choice("format", ReceiverFormat::NAMES, &mut receiver.format);
    });
    require_port(section, out);
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
    if is_missing && !section.has_problems() {
        let span = section.span("source").unwrap_or_default();
        section.report(Problem {
            help: Some(format!("set {remedy}")),
            ..Problem::new(span, "ingest.source: the port or device of the source is not set", "nothing to read")
        });
    }
}

fn stream(section: &mut Section<'_, '_>, out: &mut Stream) {
    stream_format(section, &mut out.format);
    stream_keys(section, out);
}

fn stream_keys(section: &mut Section<'_, '_>, out: &mut Stream) {
    section.choice("clock", [("device", Clock::Device), ("host", Clock::Host)], &mut out.clock);
    section.number("rate_hz", RATE_RANGE_HZ, &mut out.rate_hz);
    section.choice("gyro_samples", GyroSamples::ALL, &mut out.gyro_samples);
}

fn endpoint(section: &mut Section<'_, '_>, out: &mut Option<Port>) {
    let expected = r#""udpin:127.0.0.1:14540", "tcp:HOST:PORT" or "serial:/dev/ttyACM0""#;
    section.parsed("endpoint", expected, |text| Port::parse(text).map(Some), out);
    if let Some(Port::Serial { baud, .. }) = out {
        section.integer("baud", BAUD_RANGE, baud);
    }
}

/// Accepts a local address with port.
fn parse_listen_address(text: &str) -> Option<String> {
    text.parse::<std::net::SocketAddr>().ok().map(|_| text.to_owned())
}

/// Accepts a host name or address with port.
fn parse_remote_address(text: &str) -> Option<String> {
    let (host, port) = text.rsplit_once(':')?;
    (!host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)).then(|| text.to_owned())
}
