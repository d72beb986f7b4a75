//! Sources that send in real time: their ports, formats and clocks.

use std::{fmt, ops::RangeInclusive, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    description::Key,
    format::{Autopilot, Format, ReceiverFormat, stream_format},
    keys::{Kind, choices, keys, read},
    kind::{By, Inline, Optional, Table, Text, choice, text},
    sensors::GyroSamples,
    toml_reader::Section,
};

/// Allowed sample rates of any source, Hz.
pub(crate) const RATE_RANGE_HZ: RangeInclusive<f64> = 1.0..=10_000.0;
/// Sample rate for which buffers are made if none is set, Hz.
pub const DEFAULT_RATE_HZ: f64 = 1000.0;
/// Allowed baud rates of a serial line, bit/s.
const BAUD_RANGE: RangeInclusive<u64> = 50..=20_000_000;
/// Baud rate of a serial line if none is set, bit/s.
pub const DEFAULT_BAUD: u64 = 115_200;

keys! {
    /// Settings of a stream of readings, independent of its port.
    pub struct Stream {
        /// Format of the bytes.
        format: Format = Format::default(), By(stream_format);
        /// Treatment of the device's timestamps.
        clock: Clock = Clock::Host, choice();
        /// Sample rate. If it is not set, it is measured, and buffers are made for 1000 Hz.
        rate_hz: Option<f64> = None, Optional(RATE_RANGE_HZ), unit "Hz", example "200";
        /// Kind of rate sample.
        gyro_samples: GyroSamples = GyroSamples::Means, choice();
    }
}

choices! {
    /// Treatment of a device's timestamps.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum Clock {
        /// Timestamps are used unchanged.
        Device = "device",
        /// Timestamps are converted to this machine's CLOCK_MONOTONIC by a linear fit to the
        /// arrival times.
        Host = "host",
    }
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

keys! {
    /// Device of Linux industrial I/O.
    pub struct IioDevice {
        /// Folder of the devices in sysfs.
        root: PathBuf = "/sys/bus/iio/devices".into(), FOLDER;
        /// Folder of the character devices.
        dev: PathBuf = "/dev".into(), FOLDER;
        /// Name of the device, from the file `name` in its folder, or name of its folder.
        device: String = String::new(), text(r#"the name of a device, such as "bmi160""#, device_name),
            example r#""bmi160""#;
        /// Name of the accelerometer's device, if gyro and accelerometer are separate devices.
        accel_device: String = String::new(),
            text(r#"the name of a device, such as "lsm6dsm_accel""#, device_name), example r#""lsm6dsm_accel""#;
        /// Settings of the stream. The device determines the format.
        stream: Stream = Stream { clock: Clock::Device, ..Stream::default() },
            Inline(Stream::read_keys);
    }
}

const FOLDER: Text<PathBuf> = Text {
    expected: "a folder",
    parse: |text| (!text.is_empty()).then(|| text.into()),
    show: |folder| Some(folder.to_string_lossy().into_owned()),
};

fn device_name(text: &str) -> Option<String> {
    (!text.is_empty() && !text.contains('/')).then(|| text.to_owned())
}

keys! {
    /// Satellite receiver used in addition to the source.
    #[derive(Eq)]
    pub struct ReceiverSource {
        /// Port. If not set, there is no receiver.
        port as "endpoint": Option<Port> = None, By(endpoint), example r#""serial:/dev/ttyACM0""#;
        /// Format of the bytes.
        format: ReceiverFormat = ReceiverFormat::Ubx, choice();
    }
}

keys! {
    /// Settings of all live sources.
    pub struct LiveSources {
        /// Source on standard input, as in `PROGRAM | plumb up --source stdin`. No reading is lost
        /// at any speed, and the run ends with the input.
        stdin: PortSource = PortSource {
            port: Some(Port::Stdin),
            stream: Stream { clock: Clock::Device, ..Stream::default() },
        }, Table(|source: &mut PortSource, section| source.stream.read_keys(section));
        /// Source sending UDP datagrams. Each datagram contains whole lines or messages.
        udp: PortSource = PortSource::new(loopback(14_560)), Table(udp);
        /// Source on a TCP connection, which is opened again after a loss.
        tcp: PortSource = PortSource::new(None), Table(tcp);
        /// Source on a serial line, which is opened again after a disconnection.
        serial: PortSource = PortSource::new(Some(Port::Serial { path: PathBuf::new(), baud: DEFAULT_BAUD })),
            Table(serial);
        /// IMU and receiver of an autopilot that speaks MAVLink. The autopilot is only read.
        mavlink: PortSource = PortSource {
            port: loopback(14_540),
            stream: Stream { format: Format::Mavlink(Autopilot::default()), ..Stream::default() },
        }, Table(mavlink);
        /// Device of Linux industrial I/O. The device's sample rate is set to the one nearest to
        /// rate_hz, or to 100 Hz.
        iio: IioDevice = IioDevice::default(), Table(IioDevice::read_keys);
        /// Satellite receiver used with any of these sources or the bus. Simulations and recordings
        /// ignore it.
        receiver: ReceiverSource = ReceiverSource::default(), Table(ReceiverSource::read_keys);
    }
}

impl PortSource {
    /// Creates a source of CSV lines.
    fn new(port: Option<Port>) -> Self {
        Self { port, stream: Stream::default() }
    }
}

fn loopback(port: u16) -> Option<Port> {
    Some(Port::Udp(format!("127.0.0.1:{port}")))
}

fn udp(out: &mut PortSource, section: &mut Section<'_, '_>) {
    read!(section, {
        /// Local address. 0.0.0.0 accepts datagrams from any host.
        listen: Text {
            expected: r#"an address and a port, such as "0.0.0.0:14560""#,
            parse: |text| parse_listen_address(text).map(Port::Udp).map(Some),
            show: address,
        } => &mut out.port;
    });
    out.stream.read_keys(section);
}

fn tcp(out: &mut PortSource, section: &mut Section<'_, '_>) {
    read!(section, {
        /// Host to connect to.
        connect: Text {
            expected: r#"a host and a port, such as "192.168.1.7:5555""#,
            parse: |text| parse_remote_address(text).map(Port::Tcp).map(Some),
            show: address,
        } => &mut out.port, example r#""192.168.1.7:5555""#;
    });
    out.stream.read_keys(section);
}

fn serial(out: &mut PortSource, section: &mut Section<'_, '_>) {
    if let Some(Port::Serial { path, baud }) = &mut out.port {
        read!(section, {
            /// Device file.
            port: Text {
                expected: r#"a device file, such as "/dev/ttyUSB0""#,
                parse: |text| (!text.is_empty()).then(|| text.into()),
                show: |_| None,
            } => path, example r#""/dev/ttyUSB0""#;
        });
        read_baud(section, baud);
    }
    out.stream.read_keys(section);
}

fn mavlink(out: &mut PortSource, section: &mut Section<'_, '_>) {
    read!(section, {
        /// Port of the autopilot.
        endpoint: By(endpoint) => &mut out.port;
    });
    out.stream.read_keys(section);
}

fn read_baud(section: &mut Section<'_, '_>, baud: &mut u64) {
    read!(section, {
        /// Baud rate, with 8 data bits, no parity, 1 stop bit and no flow control.
        baud: BAUD_RANGE => baud, unit "bit/s";
    });
}

/// Reads an endpoint, and the baud rate of a serial line.
fn endpoint(section: &mut Section<'_, '_>, key: Key, out: &mut Option<Port>) {
    let kind = Text {
        expected: r#""udpin:127.0.0.1:14540", "tcp:HOST:PORT" or "serial:/dev/ttyACM0""#,
        parse: |text| Port::parse(text).map(Some),
        show: |port| Some(format!("udpin:{}", address(port)?)),
    };
    kind.read(section, key, out);
    let serial = Port::Serial { path: PathBuf::new(), baud: DEFAULT_BAUD };
    let all = [("serial:/dev/ttyACM0", Some(serial))];
    section.variants(key.name, out, all, |section, port| {
        if let Some(Port::Serial { baud, .. }) = port {
            read_baud(section, baud);
        }
    });
}

/// Returns the address of a network port.
fn address(port: &Option<Port>) -> Option<String> {
    match port {
        Some(Port::Udp(address) | Port::Tcp(address)) => Some(address.clone()),
        Some(Port::Stdin | Port::Serial { .. }) | None => None,
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdin => f.write_str("standard input"),
            Self::Udp(address) => write!(f, "datagrams to {address}"),
            Self::Tcp(address) => write!(f, "the connection to {address}"),
            Self::Serial { path, .. } => foreign::path(path).fmt(f),
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

/// Accepts a local address with port.
fn parse_listen_address(text: &str) -> Option<String> {
    text.parse::<std::net::SocketAddr>().ok().map(|_| text.to_owned())
}

/// Accepts a host name or address with port.
fn parse_remote_address(text: &str) -> Option<String> {
    let (host, port) = text.rsplit_once(':')?;
    (!host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)).then(|| text.to_owned())
}
