//! A device of Linux industrial I/O, or the two that a chip may be.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    path::Path,
    thread,
    time::{Duration, Instant},
};

use decoders::{
    Counts, Decoder, Framed, Measurement,
    iio::{Clock, Iio, IioError, Layout, Pair, sysfs},
};
use launch::IioDevice;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::{Mode, OFlags, open},
    io::Errno,
};

use crate::{
    DriversError,
    input::{Input, Report, Step},
    line::Absence,
};

const BYTES: usize = 1 << 16;
/// From one attempt to open the device to the next.
const PAUSE: Duration = Duration::from_secs(1);
const REMEDY: &str = "see that it is there: cat /sys/bus/iio/devices/*/name";

/// The device, whether or not it is there.
pub(crate) struct IioInput {
    settings: IioDevice,
    open: Option<Open>,
    again: Instant,
    absence: Option<Absence>,
    before: Counts,
    bytes: Vec<u8>,
    taken_bytes: u64,
    measurements: u64,
}

enum Open {
    One(File, Box<Framed<Iio>>),
    Two { gyro: File, accel: File, pair: Box<Pair> },
}

/// Why a device is not open.
#[derive(Debug, thiserror::Error)]
enum OpenError {
    #[error(transparent)]
    Iio(#[from] IioError),
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("its time stamps are by {0:?}, not by CLOCK_MONOTONIC")]
    Clock(Clock),
}

impl IioInput {
    pub(crate) fn new(settings: IioDevice) -> Self {
        Self {
            settings,
            open: None,
            again: Instant::now(),
            absence: None,
            before: Counts::default(),
            bytes: vec![0; BYTES],
            taken_bytes: 0,
            measurements: 0,
        }
    }

    fn give_up(&mut self, error: &OpenError) {
        if let Some(open) = self.open.take() {
            self.before = self.before + open.counts();
        }
        self.again = Instant::now() + PAUSE;
        let remedy = match error {
            OpenError::Clock(_) => r#"set clock = "host" in [ingest.iio]"#,
            // It says the remedy itself.
            OpenError::Iio(_) => REMEDY,
            OpenError::Io(error) if error.kind() == ErrorKind::PermissionDenied => {
                "give this user the right to it by a udev rule"
            }
            OpenError::Io(error) if error.kind() == ErrorKind::ResourceBusy => "another program has it open: end that",
            OpenError::Io(_) => REMEDY,
        };
        self.absence = Some(Absence { found: error.to_string(), remedy });
    }
}

impl Input for IioInput {
    fn take(&mut self, limit: Duration, found: &mut Vec<Measurement>) -> Result<Step, DriversError> {
        let now = Instant::now();
        if self.open.is_none() {
            if now < self.again {
                thread::sleep((self.again - now).min(limit));
                return Ok(Step::Nothing);
            }
            match Open::device(&self.settings) {
                Ok(open) => (self.open, self.absence) = (Some(open), None),
                Err(error) => self.give_up(&error),
            }
        }
        let Some(open) = &mut self.open else { return Ok(Step::Nothing) };
        let before = found.len();
        match open.read(&mut self.bytes, limit, found) {
            Ok(0) => Ok(Step::Nothing),
            Ok(count) => {
                let after_absence = self.taken_bytes > 0 && self.before != Counts::default();
                self.taken_bytes += count as u64;
                self.measurements += (found.len() - before) as u64;
                Ok(Step::Given { after_absence })
            }
            Err(error) => {
                self.give_up(&error.into());
                Ok(Step::Nothing)
            }
        }
    }

    fn report(&self) -> Report {
        Report {
            place: self.settings.device.clone(),
            format: "iio",
            absence: self.absence.clone(),
            bytes: self.taken_bytes,
            counts: self.before + self.open.as_ref().map_or(Counts::default(), Open::counts),
            measurements: self.measurements,
            strangers: 0,
        }
    }
}

impl Open {
    fn device(settings: &IioDevice) -> Result<Self, OpenError> {
        let IioDevice { root, dev, device, accel_device, stream } = settings;
        let one = |name: &str| -> Result<(File, Layout), OpenError> {
            let folder = sysfs::find(root, name)?;
            // A second of them, so that a process that stands still loses none.
            let layout = sysfs::prepare(&folder, (stream.rate_hz.ceil() as u32).max(64), Some(stream.rate_hz))?;
            if stream.clock == launch::Clock::Device && layout.clock != Clock::Monotonic {
                return Err(OpenError::Clock(layout.clock));
            }
            Ok((character_device(&dev.join(folder.file_name().unwrap_or_default()))?, layout))
        };
        let (file, layout) = one(device)?;
        if accel_device.is_empty() {
            return Ok(Self::One(file, Box::new(Framed::new(Iio::new(layout)?))));
        }
        let (accel, accel_layout) = one(accel_device)?;
        Ok(Self::Two { gyro: file, accel, pair: Box::new(Pair::new(layout, accel_layout)?) })
    }

    /// How many bytes came within the limit.
    fn read(&mut self, bytes: &mut [u8], limit: Duration, found: &mut Vec<Measurement>) -> io::Result<usize> {
        match self {
            Self::One(file, decoder) => {
                wait_for(&[&*file], limit)?;
                let count = read(file, bytes)?;
                decoder.push(bytes.get(..count).unwrap_or_default(), found);
                Ok(count)
            }
            Self::Two { gyro, accel, pair } => {
                wait_for(&[&*gyro, &*accel], limit)?;
                // The force first: a rate waits for the one behind it.
                let force_bytes = read(accel, bytes)?;
                pair.push_accel(bytes.get(..force_bytes).unwrap_or_default(), found);
                let rate_bytes = read(gyro, bytes)?;
                pair.push_gyro(bytes.get(..rate_bytes).unwrap_or_default(), found);
                Ok(force_bytes + rate_bytes)
            }
        }
    }

    fn counts(&self) -> Counts {
        match self {
            Self::One(_, decoder) => decoder.counts(),
            Self::Two { pair, .. } => pair.counts(),
        }
    }
}

fn character_device(path: &Path) -> io::Result<File> {
    Ok(open(path, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?.into())
}

/// Nothing where there is none; a device that has gone away says so, or has an end.
fn read(file: &mut File, bytes: &mut [u8]) -> io::Result<usize> {
    match file.read(bytes) {
        Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "its records have ended")),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
        read => read,
    }
}

fn wait_for(files: &[&File], limit: Duration) -> io::Result<()> {
    let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
    let mut polled: Vec<_> = files.iter().map(|file| PollFd::new(*file, PollFlags::IN)).collect();
    match poll(&mut polled, Some(&limit)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}
