//! Sources that send in real time: their ports, formats and clocks.

use std::{fmt, ops::RangeInclusive, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    description::Key,
    format::{Autopilot, Format, ReceiverFormat, stream_format},
    keys::{Kind, choices, keys},
    kind::{By, Inline, Optional, Table, Text, choice, text},
    sensors::GyroSamples,
    serial_line::SerialLine,
    toml_reader::Section,
};

/// Allowed sample rates of any source, Hz.
pub(crate) const RATE_RANGE_HZ: RangeInclusive<f64> = 1.0..=10_000.0;
/// Sample rate for which buffers are made if none is set, Hz.
pub const DEFAULT_RATE_HZ: f64 = 1000.0;
/// Sample rate to which a device of Linux industrial I/O is set if none is set, Hz.
pub const DEFAULT_IIO_RATE_HZ: f64 = 100.0;

keys! {
    /// Settings of a stream of readings, independent of its port.
    pub struct Stream {
        /// Format of the bytes.
        format: Format = Format::default(), By(stream_format);
        /// Treatment of the device's timestamps.
        clock: Clock = Clock::Host, choice();
        /// Sample rate. If it is not set, it is measured, or 100 Hz with `iio`, and buffers are
        /// made for 1000 Hz.
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
        /// Settings of the line.
        #[serde(flatten)]
        line: SerialLine,
    },
}

keys! {
    /// Source on standard input.
    pub struct StdinSource {
        /// Settings of the stream.
        stream: Stream = Stream { clock: Clock::Device, ..Stream::default() }, Inline(Stream::read_keys);
    }
}

keys! {
    /// Source that sends UDP datagrams.
    pub struct UdpSource {
        /// Local address. 0.0.0.0 accepts datagrams from any host.
        listen: String = "127.0.0.1:14560".into(),
            text(r#"an address and a port, such as "0.0.0.0:14560""#, parse_listen_address);
        /// Settings of the stream.
        stream: Stream = Stream::default(), Inline(Stream::read_keys);
    }
}

keys! {
    /// Source on a TCP connection.
    pub struct TcpSource {
        /// Host to connect to.
        connect: String = String::new(),
            text(r#"a host and a port, such as "192.168.1.7:5555""#, parse_remote_address),
            example r#""192.168.1.7:5555""#;
        /// Settings of the stream.
        stream: Stream = Stream::default(), Inline(Stream::read_keys);
    }
}

keys! {
    /// Source on a serial line.
    pub struct SerialSource {
        /// Device file.
        port: PathBuf = PathBuf::new(), path(r#"a device file, such as "/dev/ttyUSB0""#),
            example r#""/dev/ttyUSB0""#;
        /// Settings of the line.
        line: SerialLine = SerialLine::default(), Inline(SerialLine::read_keys);
        /// Settings of the stream.
        stream: Stream = Stream::default(), Inline(Stream::read_keys);
    }
}

keys! {
    /// IMU and receiver of an autopilot.
    pub struct MavlinkSource {
        /// Port of the autopilot.
        endpoint: Option<Port> = Some(Port::Udp("127.0.0.1:14540".into())), By(endpoint);
        /// Settings of the stream.
        stream: Stream = Stream { format: Format::Mavlink(Autopilot::default()), ..Stream::default() },
            Inline(Stream::read_keys);
    }
}

keys! {
    /// Device of Linux industrial I/O.
    pub struct IioDevice {
        /// Folder of the devices in sysfs.
        root: PathBuf = "/sys/bus/iio/devices".into(), path("a folder");
        /// Folder of the character devices.
        dev: PathBuf = "/dev".into(), path("a folder");
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

/// Returns the kind of a key that takes a path, which is not resolved against the folder of the
/// launch file. An empty default stands for a key that is not set.
const fn path(expected: &'static str) -> Text<PathBuf> {
    Text {
        expected,
        parse: |text| (!text.is_empty()).then(|| text.into()),
        show: |path| Some(path.to_string_lossy().into_owned()).filter(|path| !path.is_empty()),
    }
}

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
        stdin: StdinSource = StdinSource::default(), Table(StdinSource::read_keys);
        /// Source sending UDP datagrams. Each datagram contains whole lines or messages.
        udp: UdpSource = UdpSource::default(), Table(UdpSource::read_keys);
        /// Source on a TCP connection, which is opened again after a loss.
        tcp: TcpSource = TcpSource::default(), Table(TcpSource::read_keys);
        /// Source on a serial line, which is opened again after a disconnection.
        serial: SerialSource = SerialSource::default(), Table(SerialSource::read_keys);
        /// IMU and receiver of an autopilot that speaks MAVLink. The autopilot is only read.
        mavlink: MavlinkSource = MavlinkSource::default(), Table(MavlinkSource::read_keys);
        /// Device of Linux industrial I/O. The device's sample rate is set to the one nearest to
        /// rate_hz.
        iio: IioDevice = IioDevice::default(), Table(IioDevice::read_keys);
        /// Satellite receiver used with any of these sources or the bus. Simulations and recordings
        /// ignore it.
        receiver: ReceiverSource = ReceiverSource::default(), Table(ReceiverSource::read_keys);
    }
}

impl TcpSource {
    /// Returns the port, or `None` if the host is not set.
    pub(crate) fn port(&self) -> Option<Port> {
        (!self.connect.is_empty()).then(|| Port::Tcp(self.connect.clone()))
    }
}

impl SerialSource {
    /// Returns the port, or `None` if the device file is not set.
    pub(crate) fn port(&self) -> Option<Port> {
        let (path, line) = (self.port.clone(), self.line);
        (!path.as_os_str().is_empty()).then_some(Port::Serial { path, line })
    }
}

/// Reads an endpoint, and the settings of a serial line.
fn endpoint(section: &mut Section<'_, '_>, key: Key, out: &mut Option<Port>) {
    let kind = Text {
        expected: r#""udpin:127.0.0.1:14540", "tcp:HOST:PORT" or "serial:/dev/ttyACM0""#,
        parse: |text| Port::parse(text).map(Some),
        show: |port| match port {
            Some(Port::Udp(address)) => Some(format!("udpin:{address}")),
            Some(Port::Stdin | Port::Tcp(_) | Port::Serial { .. }) | None => None,
        },
    };
    kind.read(section, key, out);
    let serial = Port::Serial { path: PathBuf::new(), line: SerialLine::default() };
    let all = [("serial:/dev/ttyACM0", Some(serial))];
    section.variants(key.name, out, all, |section, port| {
        if let Some(Port::Serial { line, .. }) = port {
            line.read_keys(section);
        }
    });
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
            "serial" if !address.is_empty() => {
                let (path, line) = (address.into(), SerialLine::default());
                Some(Self::Serial { path, line })
            }
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
