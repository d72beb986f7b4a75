//! Sources that are read while they send: over which port their bytes come, and what is known of them.

use std::{fmt, ops::RangeInclusive, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    GyroSamples, Ingest, Launch, Service, Source,
    format::{Format, ReceiverFormat, stream_format},
    model::BusSource,
    problem::Problem,
    walk::Section,
};

/// Readings a second that any source may have.
pub(crate) const RATES_HZ: RangeInclusive<f64> = 1.0..=10_000.0;
/// Bits a second of a serial line.
const BAUDS: RangeInclusive<u64> = 50..=20_000_000;
const BAUD: u64 = 115_200;

/// What comes over a port, whichever it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stream {
    /// How the bytes are to be read.
    pub format: Format,
    /// What becomes of the times that the device gives.
    pub clock: Clock,
    /// Nominal readings per second, Hz.
    pub rate_hz: f64,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
}

/// What becomes of the times that a device gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// They are taken as they are.
    Device,
    /// A line fitted to the times of arrival makes times of this machine's CLOCK_MONOTONIC of them.
    Host,
}

/// Where bytes come in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Port {
    /// Standard input of the supervisor.
    Stdin,
    /// Datagrams to this address and port of this machine.
    Udp(String),
    /// A connection to this address and port, opened by us.
    Tcp(String),
    /// A serial line.
    Serial {
        /// The device file.
        path: PathBuf,
        /// Bits a second.
        baud: u64,
    },
}

/// A device over a port, in a section of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ported {
    /// The port; none if none is named.
    pub port: Option<Port>,
    /// What it brings.
    pub stream: Stream,
}

/// A device of Linux industrial I/O.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IioDevice {
    /// The folder of devices in sysfs.
    pub root: PathBuf,
    /// The folder of character devices.
    pub dev: PathBuf,
    /// The device's name, or that of its folder; empty if none is named.
    pub device: String,
    /// Of a chip that is two devices, the name of its accelerometer; else empty.
    pub accel_device: String,
    /// What it brings; its format is that of the device.
    pub stream: Stream,
}

/// A satellite receiver beside the source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReceiverSource {
    /// The port; none where there is no receiver.
    pub port: Option<Port>,
    /// How its bytes are to be read.
    pub format: ReceiverFormat,
}

impl Stream {
    /// Our own lines at 1 kHz, with times that become `clock`'s.
    fn of(clock: Clock) -> Self {
        Self { format: Format::default(), clock, rate_hz: 1000.0, gyro_samples: GyroSamples::Means }
    }
}

/// The sections of the live sources.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Live {
    /// What comes on standard input.
    pub stdin: Ported,
    /// What comes in datagrams.
    pub udp: Ported,
    /// What comes over a connection.
    pub tcp: Ported,
    /// What comes over a serial line.
    pub serial: Ported,
    /// What an autopilot sends.
    pub mavlink: Ported,
    /// A device of Linux industrial I/O.
    pub iio: IioDevice,
    /// A receiver beside any of them, or beside the bus; it is not read beside a simulation or a recording.
    pub receiver: ReceiverSource,
}

impl Default for Live {
    fn default() -> Self {
        let stream = || Stream::of(Clock::Host);
        let loopback = |port: u16| Some(Port::Udp(format!("127.0.0.1:{port}")));
        Self {
            stdin: Ported { port: Some(Port::Stdin), stream: Stream::of(Clock::Device) },
            udp: Ported { port: loopback(14_560), stream: stream() },
            tcp: Ported { port: None, stream: stream() },
            serial: Ported { port: Some(Port::Serial { path: PathBuf::new(), baud: BAUD }), stream: stream() },
            mavlink: Ported {
                port: loopback(14_540),
                stream: Stream { format: Format::mavlink(), rate_hz: 50.0, ..stream() },
            },
            iio: IioDevice {
                root: "/sys/bus/iio/devices".into(),
                dev: "/dev".into(),
                device: String::new(),
                accel_device: String::new(),
                stream: Stream { rate_hz: 100.0, ..Stream::of(Clock::Device) },
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
    /// Of `udpin:ADDRESS:PORT`, `tcp:HOST:PORT` or `serial:FILE`.
    fn parse(text: &str) -> Option<Self> {
        let (kind, place) = text.split_once(':')?;
        match kind {
            "udpin" => listening(place).map(Self::Udp),
            "tcp" => reached(place).map(Self::Tcp),
            "serial" if !place.is_empty() => Some(Self::Serial { path: place.into(), baud: BAUD }),
            _ => None,
        }
    }
}

impl Source {
    /// The service `drivers` reads it.
    pub const fn is_driven(self) -> bool {
        matches!(self, Self::Stdin | Self::Udp | Self::Tcp | Self::Serial | Self::Mavlink | Self::Iio)
    }

    /// It is there before it is asked for: it knows its end, and another process can read it from its beginning.
    pub const fn can_be_read_again(self) -> bool {
        matches!(self, Self::Sim | Self::Replay)
    }

    /// It waits for whoever reads it: nothing of it is lost, at any speed.
    pub const fn waits(self) -> bool {
        matches!(self, Self::Replay | Self::Stdin)
    }
}

impl Ingest {
    /// What the source's port brings; none for a source that has no port.
    pub fn stream(&self) -> Option<&Stream> {
        match self.source {
            Source::Iio => Some(&self.live.iio.stream),
            _ => self.ported().map(|ported| &ported.stream),
        }
    }

    /// The port over which the source's bytes come; none for a source that has no port, and for one whose port is not named.
    pub fn port(&self) -> Option<&Port> {
        self.ported()?
            .port
            .as_ref()
            .filter(|port| !matches!(port, Port::Serial { path, .. } if path.as_os_str().is_empty()))
    }

    /// Readings per second that the launch file tells of the source; none of a recording, which tells itself.
    pub fn declared_rate_hz(&self) -> Option<f64> {
        match self.source {
            Source::Sim => Some(self.sim.rate_hz),
            Source::Replay => None,
            Source::Bus => Some(self.bus.rate_hz),
            _ => self.stream().map(|stream| stream.rate_hz),
        }
    }

    fn ported(&self) -> Option<&Ported> {
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
    /// The drivers run exactly where the source or a receiver is theirs.
    pub(crate) fn add_drivers(&mut self) {
        self.services.retain(|service| *service != Service::Drivers);
        let Ingest { source, live, .. } = &self.ingest;
        // A simulation and a recording have a time of their own, and their own fixes.
        let has_receiver = live.receiver.port.is_some() && !source.can_be_read_again();
        if (source.is_driven() || has_receiver) && self.services.contains(&Service::Ingest) {
            self.services.push(Service::Drivers);
        }
    }
}

/// Reads the sections of the live sources, and of the receiver.
pub(crate) fn live(section: &mut Section<'_, '_>, out: &mut Ingest) {
    section.section("bus", |section| {
        let BusSource { rate_hz, gyro_samples } = &mut out.bus;
        section.number("rate_hz", RATES_HZ, rate_hz);
        section.choice("gyro_samples", GyroSamples::ALL, gyro_samples);
    });
    let Live { stdin, udp, tcp, serial, mavlink, iio, receiver } = &mut out.live;
    section.section("stdin", |section| stream(section, &mut stdin.stream));
    section.section("udp", |section| {
        let port = |text: &str| listening(text).map(Port::Udp).map(Some);
        section.text("listen", r#"an address and a port, as "0.0.0.0:14560""#, port, &mut udp.port);
        stream(section, &mut udp.stream);
    });
    section.section("tcp", |section| {
        let port = |text: &str| reached(text).map(Port::Tcp).map(Some);
        section.text("connect", r#"a host and a port, as "192.168.1.7:5555""#, port, &mut tcp.port);
        stream(section, &mut tcp.stream);
    });
    section.section("serial", |section| {
        if let Some(Port::Serial { path, baud }) = &mut serial.port {
            let file = |text: &str| (!text.is_empty()).then(|| text.into());
            section.text("port", r#"a device file, as "/dev/ttyUSB0""#, file, path);
            section.count("baud", BAUDS, baud);
        }
        stream(section, &mut serial.stream);
    });
    section.section("mavlink", |section| {
        endpoint(section, &mut mavlink.port);
        common(section, &mut mavlink.stream);
        mavlink.stream.format.mavlink_keys(section);
    });
    section.section("iio", |section| {
        let path = |text: &str| (!text.is_empty()).then(|| text.into());
        section.text("root", "a folder", path, &mut iio.root);
        section.text("dev", "a folder", path, &mut iio.dev);
        let name = |text: &str| (!text.is_empty() && !text.contains('/')).then(|| text.to_owned());
        section.text("device", r#"the name of a device, as "bmi160""#, name, &mut iio.device);
        section.text("accel_device", r#"the name of a device, as "lsm6dsm_accel""#, name, &mut iio.accel_device);
        common(section, &mut iio.stream);
    });
    section.section("receiver", |section| {
        endpoint(section, &mut receiver.port);
        section.choice("format", ReceiverFormat::NAMES, &mut receiver.format);
    });
    is_named(section, out);
}

/// Whether the source says over which port it comes.
fn is_named(section: &mut Section<'_, '_>, ingest: &Ingest) {
    let remedy = match ingest.source {
        Source::Serial => r#"port = "/dev/ttyUSB0" in [ingest.serial]"#,
        Source::Tcp => r#"connect = "192.168.1.7:5555" in [ingest.tcp]"#,
        Source::Iio => r#"device = "bmi160" in [ingest.iio]; `cat /sys/bus/iio/devices/*/name` tells those there are"#,
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
            help: Some(format!("name it: {remedy}")),
            ..Problem::new(span, "ingest.source: it needs a port or a device, none is named", "nothing to read")
        });
    }
}

fn stream(section: &mut Section<'_, '_>, out: &mut Stream) {
    stream_format(section, &mut out.format);
    common(section, out);
}

fn common(section: &mut Section<'_, '_>, out: &mut Stream) {
    section.choice("clock", [("device", Clock::Device), ("host", Clock::Host)], &mut out.clock);
    section.number("rate_hz", RATES_HZ, &mut out.rate_hz);
    section.choice("gyro_samples", GyroSamples::ALL, &mut out.gyro_samples);
}

fn endpoint(section: &mut Section<'_, '_>, out: &mut Option<Port>) {
    let expected = r#""udpin:127.0.0.1:14540", "tcp:HOST:PORT" or "serial:/dev/ttyACM0""#;
    section.text("endpoint", expected, |text| Port::parse(text).map(Some), out);
    if let Some(Port::Serial { baud, .. }) = out {
        section.count("baud", BAUDS, baud);
    }
}

/// An address of this machine, and a port.
fn listening(text: &str) -> Option<String> {
    text.parse::<std::net::SocketAddr>().ok().map(|_| text.to_owned())
}

/// A host, by name or address, and a port.
fn reached(text: &str) -> Option<String> {
    let (host, port) = text.rsplit_once(':')?;
    (!host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)).then(|| text.to_owned())
}
