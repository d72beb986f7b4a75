//! Simulated device in this process. It lies level, rotates at 10 °/s and timestamps its readings.

use std::{
    fs::{self, File, OpenOptions},
    io::Write as _,
    net::{TcpListener, TcpStream, UdpSocket},
    os::unix::fs::OpenOptionsExt as _,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use mavlink::{
    MAVLinkV2MessageRaw, MavHeader,
    dialects::common::{HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage},
};
use prost::Message as _;
use rustix::{
    fs::{CWD, Mode, OFlags, fcntl_setfl, mkfifoat},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    time::{ClockId, clock_gettime},
};
use wire::v1;

use crate::Failure;

const RATE_RAD_S: f64 = 0.174_532_925;
const FORCE_M_S2: f64 = 9.81;

/// Kind of source that feeds a system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SourceKind {
    Sim,
    Bus,
    Stdin,
    Protobuf,
    Udp,
    Tcp,
    Serial,
    Mavlink,
    Iio,
}

/// Device that has not been started yet.
pub(crate) struct Device {
    /// Value for the option `--source` of `plumb up`.
    pub(crate) source: String,
    /// Additional sections of the launch file.
    pub(crate) launch_sections: String,
    /// FIFO to be used as the standard input of `plumb up`.
    pub(crate) stdin: Option<PathBuf>,
    factory: SenderFactory,
    interval: Duration,
}

/// Device that sends readings until it is dropped.
pub(crate) struct RunningDevice {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Factory for a function that sends readings. The sending thread calls the factory once.
///
/// The returned function sends one reading with the given timestamp (ns). A reading is lost if
/// there is no receiver.
type SenderFactory = Box<dyn FnOnce() -> Box<dyn FnMut(i64)> + Send>;

impl SourceKind {
    pub(crate) const ALL: [Self; 9] = [
        Self::Sim,
        Self::Bus,
        Self::Stdin,
        Self::Protobuf,
        Self::Udp,
        Self::Tcp,
        Self::Serial,
        Self::Mavlink,
        Self::Iio,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Sim => "sim",
            Self::Bus => "bus",
            Self::Stdin => "stdin",
            Self::Protobuf => "protobuf",
            Self::Udp => "udp",
            Self::Tcp => "tcp",
            Self::Serial => "serial",
            Self::Mavlink => "mavlink",
            Self::Iio => "iio",
        }
    }
}

impl Device {
    /// Creates a device for the system `name` and puts its files into `folder`.
    pub(crate) fn new(kind: SourceKind, name: &str, folder: &Path, rate_hz: u32) -> Result<Self, Failure> {
        let keys = format!("rate_hz={rate_hz}&clock=device");
        let fifo = folder.join("fifo");
        let (mut launch_sections, mut stdin) = (String::new(), None);
        let (source, factory): (String, SenderFactory) = match kind {
            SourceKind::Sim => (format!("sim:s1?rate_hz={rate_hz}"), Box::new(|| Box::new(|_| ()))),
            SourceKind::Bus => {
                let name = name.to_owned();
                let factory = move || -> Box<dyn FnMut(i64)> {
                    let mut sensor = None;
                    Box::new(move |t_ns| {
                        if sensor.is_none() {
                            sensor = driver::Sensor::open(&name).ok();
                        }
                        let Some(sensor) = &mut sensor else { return };
                        // Sending fails before the system has started and after it has ended.
                        let _ = sensor.send(t_ns, [0.0, 0.0, RATE_RAD_S], [0.0, 0.0, FORCE_M_S2], None);
                    })
                };
                (format!("bus?rate_hz={rate_hz}"), Box::new(factory))
            }
            SourceKind::Stdin | SourceKind::Protobuf => {
                let pipe = pipe(&fifo)?;
                stdin = Some(fifo);
                let format = if kind == SourceKind::Stdin { "csv" } else { "protobuf" };
                let message = if kind == SourceKind::Stdin { csv_line } else { protobuf };
                (format!("stdin?{keys}&format={format}"), to_file(pipe, message))
            }
            SourceKind::Udp | SourceKind::Mavlink => {
                let socket = UdpSocket::bind("127.0.0.1:0")?;
                let address = UdpSocket::bind("127.0.0.1:0")?.local_addr()?;
                let (scheme, message): (_, Encoder) =
                    if kind == SourceKind::Udp { ("udp:", csv_line) } else { ("mavlink:udpin:", highres_imu) };
                let send = move |t_ns| drop(socket.send_to(&message(t_ns), address));
                (format!("{scheme}{address}?{keys}"), Box::new(|| Box::new(send)))
            }
            SourceKind::Tcp => {
                let listener = TcpListener::bind("127.0.0.1:0")?;
                listener.set_nonblocking(true)?;
                let address = listener.local_addr()?;
                let mut stream: Option<TcpStream> = None;
                let send = move |t_ns| {
                    if stream.is_none() {
                        stream = listener.accept().ok().map(|(stream, _)| stream);
                        stream.iter().for_each(|stream| drop(stream.set_nodelay(true)));
                    }
                    stream.iter_mut().for_each(|stream| drop(stream.write_all(&csv_line(t_ns))));
                };
                (format!("tcp:{address}?{keys}"), Box::new(|| Box::new(send)))
            }
            SourceKind::Serial => {
                let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
                grantpt(&device)?;
                unlockpt(&device)?;
                fcntl_setfl(&device, OFlags::NONBLOCK)?;
                let path = ptsname(&device, Vec::new())?.into_string()?;
                (format!("serial:{path}?{keys}"), to_file(device.into(), csv_line))
            }
            SourceKind::Iio => {
                let device = create_iio_device(folder)?;
                launch_sections = format!("[ingest.iio]\nroot = \"{0}\"\ndev = \"{0}/dev\"\n", folder.display());
                (format!("iio:bench?{keys}"), to_file(device, iio_record))
            }
        };
        Ok(Self { source, launch_sections, stdin, factory, interval: Duration::from_secs(1) / rate_hz })
    }

    /// Starts sending readings at the device's interval.
    pub(crate) fn start(self) -> RunningDevice {
        let Self { factory, interval, .. } = self;
        let stop = Arc::new(AtomicBool::new(false));
        let stop_requested = stop.clone();
        let thread = thread::spawn(move || {
            let mut send = factory();
            let mut next = Instant::now();
            while !stop_requested.load(Ordering::Relaxed) {
                let now = clock_gettime(ClockId::Monotonic);
                send(now.tv_sec * 1_000_000_000 + now.tv_nsec);
                // Missed readings are skipped.
                next = (next + interval).max(Instant::now());
                thread::sleep(next - Instant::now());
            }
        });
        RunningDevice { stop, thread: Some(thread) }
    }
}

impl Drop for RunningDevice {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().into_iter().for_each(|thread| drop(thread.join()));
    }
}

/// Function that encodes a reading with the given timestamp (ns).
type Encoder = fn(i64) -> Vec<u8>;

fn to_file(mut file: File, encode: Encoder) -> SenderFactory {
    Box::new(move || Box::new(move |t_ns| drop(file.write_all(&encode(t_ns)))))
}

fn csv_line(t_ns: i64) -> Vec<u8> {
    let (s, ns) = (t_ns / 1_000_000_000, t_ns % 1_000_000_000);
    format!("{s}.{ns:09},0,0,{RATE_RAD_S},0,0,{FORCE_M_S2}\n").into_bytes()
}

fn protobuf(t_ns: i64) -> Vec<u8> {
    let along_up = |z| Some(v1::Vector3 { x: 0.0, y: 0.0, z });
    let (rate_rad_s, force_m_s2) = (along_up(RATE_RAD_S), along_up(FORCE_M_S2));
    v1::Measurement { t_ns: Some(t_ns), rate_rad_s, force_m_s2, ..v1::Measurement::default() }
        .encode_length_delimited_to_vec()
}

/// Encodes a reading with a time resolution of 1 µs and the axes forward, right, down.
fn highres_imu(t_ns: i64) -> Vec<u8> {
    let message = MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
        time_usec: t_ns as u64 / 1000,
        zgyro: -RATE_RAD_S as f32,
        zacc: -FORCE_M_S2 as f32,
        fields_updated: HighresImuUpdatedFlags::from_bits_retain(0x3f),
        ..HIGHRES_IMU_DATA::default()
    });
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader::default(), &message);
    raw.raw_bytes().to_vec()
}

fn iio_record(t_ns: i64) -> Vec<u8> {
    let numbers = [0, 0, (RATE_RAD_S * 1000.0) as i16, 0, 0, (FORCE_M_S2 * 100.0) as i16, 0, 0];
    [numbers.map(i16::to_le_bytes).concat(), t_ns.to_le_bytes().into()].concat()
}

fn pipe(path: &Path) -> Result<File, Failure> {
    mkfifoat(CWD, path, Mode::RUSR | Mode::WUSR)?;
    // Both ends of the FIFO are opened, because opening only one would block.
    let mut options = OpenOptions::new();
    Ok(options.read(true).write(true).custom_flags(OFlags::NONBLOCK.bits() as i32).open(path)?)
}

/// Creates the sysfs tree of an IIO device and returns the file for its records.
fn create_iio_device(root: &Path) -> Result<File, Failure> {
    let device = root.join("iio:device0");
    let write = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n"));
    for folder in ["scan_elements", "buffer", "../dev"] {
        fs::create_dir_all(device.join(folder))?;
    }
    for (name, text) in [
        ("name", "bench"),
        ("buffer/enable", "0"),
        ("buffer/length", "2"),
        ("current_timestamp_clock", "monotonic"),
        ("sampling_frequency", "25"),
        ("in_anglvel_scale", "0.001"),
        ("in_accel_scale", "0.01"),
    ] {
        write(name, text)?;
    }
    let vectors =
        ["in_anglvel", "in_accel"].into_iter().flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")));
    for (index, name) in vectors.chain(["in_timestamp".into()]).enumerate() {
        write(&format!("scan_elements/{name}_en"), "0")?;
        write(&format!("scan_elements/{name}_type"), if index < 6 { "le:s16/16>>0" } else { "le:s64/64>>0" })?;
        write(&format!("scan_elements/{name}_index"), &index.to_string())?;
    }
    pipe(&root.join("dev/iio:device0"))
}
