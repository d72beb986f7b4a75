//! Linux industrial I/O device, or the separate gyro and accelerometer devices of one chip.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    path::Path,
    thread,
    time::{Duration, Instant},
};

use decoders::{
    Counts, Decoder, Framed, Measurement,
    iio::{Clock, DevicePair, Iio, IioError, Layout, sysfs},
};
use launch::{DEFAULT_IIO_RATE_HZ, IioDevice};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::{Mode, OFlags, open},
    io::Errno,
};

use crate::{
    error::DriversError,
    input::{DeviceReport, Input, ReadOutcome},
    reconnecting_port::DeviceFailure,
};

const BUFFER_BYTES: usize = 1 << 16;
/// Pause before reopening the device.
const RETRY_PAUSE: Duration = Duration::from_secs(1);
const CHECK_DEVICE: &str = "check that the device is present: cat /sys/bus/iio/devices/*/name";

/// Device that may currently be closed.
pub(crate) struct IioInput {
    settings: IioDevice,
    open: Option<OpenDevice>,
    next_attempt: Instant,
    failure: Option<DeviceFailure>,
    previous_counts: Counts,
    bytes: Vec<u8>,
    received_bytes: u64,
    measurements: u64,
}

enum OpenDevice {
    Single(File, Box<Framed<Iio>>),
    Separate { gyro: File, accel: File, pair: Box<DevicePair> },
}

/// Reason why a device cannot be opened or read.
#[derive(Debug, thiserror::Error)]
enum OpenError {
    #[error(transparent)]
    Iio(#[from] IioError),
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("its timestamps use the clock {0:?}, not CLOCK_MONOTONIC")]
    Clock(Clock),
}

impl IioInput {
    pub(crate) fn new(settings: IioDevice) -> Self {
        Self {
            settings,
            open: None,
            next_attempt: Instant::now(),
            failure: None,
            previous_counts: Counts::default(),
            bytes: vec![0; BUFFER_BYTES],
            received_bytes: 0,
            measurements: 0,
        }
    }

    fn mark_failed(&mut self, error: &OpenError) {
        if let Some(open) = self.open.take() {
            self.previous_counts = self.previous_counts + open.counts();
        }
        self.next_attempt = Instant::now() + RETRY_PAUSE;
        let remedy = match error {
            OpenError::Clock(_) => r#"set clock = "host" in [ingest.iio]"#,
            OpenError::Iio(_) => CHECK_DEVICE,
            OpenError::Io(error) if error.kind() == ErrorKind::PermissionDenied => {
                "grant this user access with a udev rule"
            }
            OpenError::Io(error) if error.kind() == ErrorKind::ResourceBusy => {
                "another program uses it: stop that program"
            }
            OpenError::Io(_) => CHECK_DEVICE,
        };
        self.failure = Some(DeviceFailure { cause: error.to_string(), remedy });
    }
}

impl Input for IioInput {
    fn read(&mut self, timeout: Duration, measurements: &mut Vec<Measurement>) -> Result<ReadOutcome, DriversError> {
        let now = Instant::now();
        if self.open.is_none() {
            if now < self.next_attempt {
                thread::sleep((self.next_attempt - now).min(timeout));
                return Ok(ReadOutcome::NoData);
            }
            match OpenDevice::open(&self.settings) {
                Ok(open) => (self.open, self.failure) = (Some(open), None),
                Err(error) => self.mark_failed(&error),
            }
        }
        let Some(open) = &mut self.open else { return Ok(ReadOutcome::NoData) };
        let first = measurements.len();
        match open.read(&mut self.bytes, timeout, measurements) {
            Ok(0) => Ok(ReadOutcome::NoData),
            Ok(count) => {
                let after_outage = self.received_bytes > 0 && self.previous_counts != Counts::default();
                self.received_bytes += count as u64;
                self.measurements += (measurements.len() - first) as u64;
                Ok(ReadOutcome::Data { after_outage })
            }
            Err(error) => {
                self.mark_failed(&error.into());
                Ok(ReadOutcome::NoData)
            }
        }
    }

    fn report(&self) -> DeviceReport {
        DeviceReport {
            port: self.settings.device.clone(),
            format: "iio",
            failure: self.failure.clone(),
            bytes: self.received_bytes,
            counts: self.previous_counts + self.open.as_ref().map_or(Counts::default(), OpenDevice::counts),
            measurements: self.measurements,
            foreign_datagrams: 0,
            dropped_datagrams: 0,
        }
    }
}

impl OpenDevice {
    fn open(settings: &IioDevice) -> Result<Self, OpenError> {
        let IioDevice { root, dev, device, accel_device, stream } = settings;
        let rate_hz = stream.rate_hz.unwrap_or(DEFAULT_IIO_RATE_HZ);
        let open_one = |name: &str| -> Result<(File, Layout), OpenError> {
            let folder = sysfs::find(root, name)?;
            // The buffer holds one second of records, so that no record is lost if this process
            // stalls briefly.
            let layout = sysfs::prepare(&folder, (rate_hz.ceil() as u32).max(64), Some(rate_hz))?;
            if stream.clock == launch::Clock::Device && layout.clock != Clock::Monotonic {
                return Err(OpenError::Clock(layout.clock));
            }
            Ok((character_device(&dev.join(folder.file_name().unwrap_or_default()))?, layout))
        };
        let (file, layout) = open_one(device)?;
        if accel_device.is_empty() {
            return Ok(Self::Single(file, Box::new(Framed::new(Iio::new(layout)?))));
        }
        let (accel, accel_layout) = open_one(accel_device)?;
        Ok(Self::Separate { gyro: file, accel, pair: Box::new(DevicePair::new(layout, accel_layout)?) })
    }

    /// Reads the available bytes, waiting at most `timeout`, and returns their number.
    fn read(&mut self, bytes: &mut [u8], timeout: Duration, measurements: &mut Vec<Measurement>) -> io::Result<usize> {
        match self {
            Self::Single(file, decoder) => {
                wait_for(&[&*file], timeout)?;
                let count = read(file, bytes)?;
                decoder.push(bytes.get(..count).unwrap_or_default(), measurements);
                Ok(count)
            }
            Self::Separate { gyro, accel, pair } => {
                wait_for(&[&*gyro, &*accel], timeout)?;
                // A rate is held until a later force has been read. Forces are therefore read
                // first, so that rates older than the newest force are emitted at once.
                let force_bytes = read(accel, bytes)?;
                pair.push_accel(bytes.get(..force_bytes).unwrap_or_default(), measurements);
                let rate_bytes = read(gyro, bytes)?;
                pair.push_gyro(bytes.get(..rate_bytes).unwrap_or_default(), measurements);
                Ok(force_bytes + rate_bytes)
            }
        }
    }

    fn counts(&self) -> Counts {
        match self {
            Self::Single(_, decoder) => decoder.counts(),
            Self::Separate { pair, .. } => pair.counts(),
        }
    }
}

fn character_device(path: &Path) -> io::Result<File> {
    Ok(open(path, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?.into())
}

/// Returns the number of bytes read, or 0 if none are available. A removed device yields an error.
fn read(file: &mut File, bytes: &mut [u8]) -> io::Result<usize> {
    match file.read(bytes) {
        Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "the device's records have ended")),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
        read => read,
    }
}

fn wait_for(files: &[&File], timeout: Duration) -> io::Result<()> {
    let timeout = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
    let mut polled: Vec<_> = files.iter().map(|file| PollFd::new(*file, PollFlags::IN)).collect();
    match poll(&mut polled, Some(&timeout)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}
