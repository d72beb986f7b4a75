//! A device in this process: it lies level, turns by 10 °/s, and says when.

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
    dialects::ardupilotmega::{HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage},
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

/// What a system is fed by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
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

/// A device that does not send yet.
pub(crate) struct Device {
    /// For `--source`.
    pub(crate) line: String,
    /// Sections of the launch file.
    pub(crate) settings: String,
    /// What standard input is to be.
    pub(crate) stdin: Option<PathBuf>,
    make: Make,
    interval: Duration,
}

/// A device that sends until it is dropped.
pub(crate) struct Sending {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Makes, in the thread that sends, what sends the reading of an instant; what nobody takes is lost.
type Make = Box<dyn FnOnce() -> Box<dyn FnMut(i64)> + Send>;

impl Kind {
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
    /// Of the system `name`; files go to the folder.
    pub(crate) fn new(kind: Kind, name: &str, folder: &Path, rate_hz: u32) -> Result<Self, Failure> {
        let keys = format!("rate_hz={rate_hz}&clock=device");
        let fifo = folder.join("fifo");
        let (mut settings, mut stdin) = (String::new(), None);
        let (line, make): (String, Make) = match kind {
            Kind::Sim => (format!("sim:s1?rate_hz={rate_hz}"), Box::new(|| Box::new(|_| ()))),
            Kind::Bus => {
                let name = name.to_owned();
                let make = move || -> Box<dyn FnMut(i64)> {
                    let mut sensor = None;
                    Box::new(move |t_ns| {
                        if sensor.is_none() {
                            sensor = driver::Sensor::open(&name).ok();
                        }
                        let Some(sensor) = &mut sensor else { return };
                        // Until the system is there, and once it has gone.
                        let _ = sensor.send(t_ns, [0.0, 0.0, RATE_RAD_S], [0.0, 0.0, FORCE_M_S2], None);
                    })
                };
                (format!("bus?rate_hz={rate_hz}"), Box::new(make))
            }
            Kind::Stdin | Kind::Protobuf => {
                let pipe = pipe(&fifo)?;
                stdin = Some(fifo);
                let format = if kind == Kind::Stdin { "csv" } else { "protobuf" };
                let message = if kind == Kind::Stdin { line } else { protobuf };
                (format!("stdin?{keys}&format={format}"), to_file(pipe, message))
            }
            Kind::Udp | Kind::Mavlink => {
                let socket = UdpSocket::bind("127.0.0.1:0")?;
                let address = UdpSocket::bind("127.0.0.1:0")?.local_addr()?;
                let (scheme, message): (_, Message) =
                    if kind == Kind::Udp { ("udp:", line) } else { ("mavlink:udpin:", highres_imu) };
                let send = move |t_ns| drop(socket.send_to(&message(t_ns), address));
                (format!("{scheme}{address}?{keys}"), Box::new(|| Box::new(send)))
            }
            Kind::Tcp => {
                let listener = TcpListener::bind("127.0.0.1:0")?;
                listener.set_nonblocking(true)?;
                let address = listener.local_addr()?;
                let mut stream: Option<TcpStream> = None;
                let send = move |t_ns| {
                    if stream.is_none() {
                        stream = listener.accept().ok().map(|(stream, _)| stream);
                        stream.iter().for_each(|stream| drop(stream.set_nodelay(true)));
                    }
                    stream.iter_mut().for_each(|stream| drop(stream.write_all(&line(t_ns))));
                };
                (format!("tcp:{address}?{keys}"), Box::new(|| Box::new(send)))
            }
            Kind::Serial => {
                let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
                grantpt(&device)?;
                unlockpt(&device)?;
                fcntl_setfl(&device, OFlags::NONBLOCK)?;
                let path = ptsname(&device, Vec::new())?.into_string()?;
                (format!("serial:{path}?{keys}"), to_file(device.into(), line))
            }
            Kind::Iio => {
                let device = industrial(folder)?;
                settings = format!("[ingest.iio]\nroot = \"{0}\"\ndev = \"{0}/dev\"\n", folder.display());
                (format!("iio:bench?{keys}"), to_file(device, record))
            }
        };
        Ok(Self { line, settings, stdin, make, interval: Duration::from_secs(1) / rate_hz })
    }

    /// Begins to send at its interval.
    pub(crate) fn send(self) -> Sending {
        let Self { make, interval, .. } = self;
        let ends = Arc::new(AtomicBool::new(false));
        let ended = ends.clone();
        let thread = thread::spawn(move || {
            let mut send = make();
            let mut next = Instant::now();
            while !ended.load(Ordering::Relaxed) {
                let now = clock_gettime(ClockId::Monotonic);
                send(now.tv_sec * 1_000_000_000 + now.tv_nsec);
                // One that could not send in time does not make up for it.
                next = (next + interval).max(Instant::now());
                thread::sleep(next - Instant::now());
            }
        });
        Sending { ends, thread: Some(thread) }
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take().into_iter().for_each(|thread| drop(thread.join()));
    }
}

/// The bytes of a reading at an instant.
type Message = fn(i64) -> Vec<u8>;

fn to_file(mut file: File, message: Message) -> Make {
    Box::new(move || Box::new(move |t_ns| drop(file.write_all(&message(t_ns)))))
}

fn line(t_ns: i64) -> Vec<u8> {
    let (s, ns) = (t_ns / 1_000_000_000, t_ns % 1_000_000_000);
    format!("{s}.{ns:09},0,0,{RATE_RAD_S},0,0,{FORCE_M_S2}\n").into_bytes()
}

fn protobuf(t_ns: i64) -> Vec<u8> {
    let up = |z| Some(v1::Vector3 { x: 0.0, y: 0.0, z });
    let (rate_rad_s, force_m_s2) = (up(RATE_RAD_S), up(FORCE_M_S2));
    v1::Measurement { t_ns: Some(t_ns), rate_rad_s, force_m_s2, ..v1::Measurement::default() }
        .encode_length_delimited_to_vec()
}

/// In steps of 1 µs; forward, right, down.
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

fn record(t_ns: i64) -> Vec<u8> {
    let numbers = [0, 0, (RATE_RAD_S * 1000.0) as i16, 0, 0, (FORCE_M_S2 * 100.0) as i16, 0, 0];
    [numbers.map(i16::to_le_bytes).concat(), t_ns.to_le_bytes().into()].concat()
}

fn pipe(path: &Path) -> Result<File, Failure> {
    mkfifoat(CWD, path, Mode::RUSR | Mode::WUSR)?;
    // Whoever has both ends open waits for nobody.
    let mut options = OpenOptions::new();
    Ok(options.read(true).write(true).custom_flags(OFlags::NONBLOCK.bits() as i32).open(path)?)
}

/// A tree as sysfs makes it, and the file of its records.
fn industrial(root: &Path) -> Result<File, Failure> {
    let device = root.join("iio:device0");
    let put = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n"));
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
        put(name, text)?;
    }
    let vectors =
        ["in_anglvel", "in_accel"].into_iter().flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")));
    for (index, name) in vectors.chain(["in_timestamp".into()]).enumerate() {
        put(&format!("scan_elements/{name}_en"), "0")?;
        put(&format!("scan_elements/{name}_type"), if index < 6 { "le:s16/16>>0" } else { "le:s64/64>>0" })?;
        put(&format!("scan_elements/{name}_index"), &index.to_string())?;
    }
    pipe(&root.join("dev/iio:device0"))
}
