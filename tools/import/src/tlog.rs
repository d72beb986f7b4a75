//! Source that reads telemetry logs of ground stations (tlog).
//!
//! Input: MAVLink messages, each after its time of arrival in µs since 1970, big-endian.
//!
//! Output: rate, force, magnetic field, fixes and attitude of one autopilot, which the MAVLink
//! decoder chooses. The reference is ATTITUDE_QUATERNION, or ATTITUDE if the log has no quaternion.
//! Rate and force are taken from one kind of message: the first kind whose sensor works. RAW_IMU is
//! tried last.
//!
//! Time: the autopilot's clock, or the times of arrival if that clock never changes. The clock of a
//! fix may differ from that of the samples. The time of a fix is therefore computed from the time
//! of the latest sample and the difference of the two arrival times. The same applies to an
//! attitude if the samples have UNIX time.
//!
//! Memory: a buffer for each series.
//!
//! Failure: bytes that are not part of a message are skipped and counted.

use std::{
    cell::Cell,
    fs::{self, File},
    io::{self, Read},
    iter,
    path::{Path, PathBuf},
    rc::Rc,
};

use attitude::frames::{self, Body, Earth};
use decoders::{
    DeviceTime, Format as _, Measurement, Value,
    framed::ParseOutcome,
    mavlink::{AttitudeEstimate, ImuMessage, Mavlink, MavlinkSettings, RawScale},
};
use mapping::is_rotation;
use recording::Reference;

use crate::{
    Format, ImportError, Note, Options, Sensor,
    csv_reader::CountingReader,
    error::open_error,
    row_writer::{Attitude, Sample, Samples},
    sensor_state::SensorState,
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
    timeline::{SegmentFinder, SourceClock},
};

const STAMP_BYTES: usize = 8;
const BUFFER_BYTES: usize = 1 << 16;
/// Maximum length of a message with its time of arrival, bytes.
const MAX_RECORD_BYTES: usize = STAMP_BYTES + 280 + 1;
const STX_V1: u8 = 0xfe;
const STX_V2: u8 = 0xfd;
/// Number of messages between two progress reports.
const PROGRESS_INTERVAL_MESSAGES: u64 = 4096;

/// Messages with rate and force, in order of preference, with their names.
const IMU_MESSAGES: [(ImuMessage, &str); 5] = [
    (ImuMessage::HighresImu, "HIGHRES_IMU"),
    (ImuMessage::ScaledImu, "SCALED_IMU"),
    (ImuMessage::ScaledImu2, "SCALED_IMU2"),
    (ImuMessage::ScaledImu3, "SCALED_IMU3"),
    (ImuMessage::RawImu, "RAW_IMU"),
];
/// Minimum number of equal times at which the clock of the autopilot is considered stopped.
const MIN_CONSTANT_TIMES: u64 = 10;

/// Telemetry log.
pub(crate) struct Tlog {
    path: PathBuf,
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// Number of the requested sensor.
    requested: Option<usize>,
    /// Message with rate and force; `None` before the survey.
    imu: Option<ImuMessage>,
    /// `true` if the times of arrival replace those of the autopilot.
    uses_arrival_times: bool,
    /// `true` if the reference is taken from ATTITUDE_QUATERNION messages.
    has_quaternions: bool,
}

/// Measurement with its time on the clock of the samples, ns.
struct TimedValue {
    t_ns: i64,
    value: LogValue,
}

/// Content of a message.
enum LogValue {
    Measurement(Value),
    Attitude(AttitudeEstimate),
}

impl Tlog {
    pub(crate) fn open(path: &Path, options: &Options) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| open_error(path, cause))?;
        let (length_bytes, read_bytes) = (found.len(), Rc::default());
        Ok(Self {
            path: path.to_owned(),
            length_bytes,
            read_bytes,
            requested: options.imu,
            imu: None,
            uses_arrival_times: false,
            has_quaternions: false,
        })
    }

    fn messages(&self) -> Result<MessageReader, ImportError> {
        let mut messages = MessageReader::open(&self.path, &self.read_bytes, self.imu)
            .map_err(|cause| open_error(&self.path, cause))?;
        messages.uses_arrival_times = self.uses_arrival_times;
        Ok(messages)
    }

    /// Reads the log to choose the message with rate and force. Returns the sensors of the log.
    fn choose_imu(&mut self, progress: &mut dyn FnMut(u64), notes: &mut Vec<Note>) -> Result<Vec<Sensor>, ImportError> {
        let mut messages = self.messages()?;
        messages.observers = IMU_MESSAGES.map(|(imu, name)| Observer::new(imu, name)).into();
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            if messages.next().map_err(|cause| open_error(&self.path, cause))?.is_none() {
                break;
            }
        }
        let found: Vec<_> = messages.observers.into_iter().filter(|observer| observer.state.samples > 0).collect();
        let read = match self.requested {
            Some(number) if number < found.len() => number,
            Some(number) => {
                let (path, count) = (self.path.clone(), found.len());
                return Err(ImportError::UnknownSensor { path, what: "--imu", found: number, count });
            }
            None => found.iter().position(|observer| observer.state.is_healthy()).unwrap_or(0),
        };
        let Some(Observer { imu, name, state, .. }) = found.get(read) else { return Ok(Vec::new()) };
        self.imu = Some(*imu);
        let has_one_time = |state: &SensorState| match state.segments.segments() {
            [segment] => segment.first_ns == segment.last_ns && state.samples >= MIN_CONSTANT_TIMES,
            _ => false,
        };
        if has_one_time(state) {
            self.uses_arrival_times = true;
            notes.push(Note::LogTimes { topic: (*name).into() });
        }
        if let (None, Some(first), true) = (self.requested, found.first(), read > 0) {
            notes.push(Note::DeadSensor { sensor: first.name.into(), read: (*name).into() });
        }
        let sensor = |(number, observer): (usize, &Observer)| {
            observer.state.sensor("--imu", number, observer.name, number == read)
        };
        Ok(found.iter().enumerate().map(sensor).collect())
    }

    /// Converts the measurements with `convert`.
    fn values<T>(&self, convert: impl Fn(TimedValue) -> Option<T> + 'static) -> Result<Samples<'_, T>, ImportError> {
        let mut messages = self.messages()?;
        let mut next = move || -> Result<Option<T>, ImportError> {
            while let Some(value) = messages.next().map_err(|cause| open_error(&self.path, cause))? {
                if let Some(converted) = convert(value) {
                    return Ok(Some(converted));
                }
            }
            Ok(None)
        };
        Ok(Box::new(iter::from_fn(move || next().transpose())))
    }
}

impl Tlog {
    /// Adds all messages to the survey.
    fn survey_messages(
        &mut self,
        messages: &mut MessageReader,
        survey: &mut Survey,
        finder: &mut SegmentFinder,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ImportError> {
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            let next = messages.next().map_err(|cause| open_error(&self.path, cause))?;
            let Some(TimedValue { t_ns, value }) = next else { break };
            match value {
                LogValue::Measurement(Value::Imu { field_ut, .. }) => {
                    finder.push(t_ns);
                    survey.has_field |= field_ut.is_some();
                }
                LogValue::Measurement(Value::Field(_)) => survey.has_field = true,
                LogValue::Measurement(Value::Fix { .. }) => survey.has_fixes = true,
                LogValue::Attitude(AttitudeEstimate { is_quaternion, .. }) => {
                    survey.has_reference = true;
                    self.has_quaternions |= is_quaternion;
                }
            }
        }
        Ok(())
    }
}

impl Source for Tlog {
    fn format(&self) -> Format {
        Format::Tlog
    }

    fn total_bytes(&self) -> u64 {
        // The log is read once each for the choice of the sensor, the survey, the samples, the
        // magnetic field and the fixes, and twice for the reference.
        7 * self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.read_bytes.get()
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut finder = SegmentFinder::new(&SourceClock::default());
        let mut survey = Survey { expected: "HIGHRES_IMU, SCALED_IMU or RAW_IMU".into(), ..Survey::default() };
        survey.sensors = self.choose_imu(progress, &mut survey.notes)?;
        let mut messages = self.messages()?;
        self.survey_messages(&mut messages, &mut survey, &mut finder, progress)?;
        progress(self.read_bytes.get());
        for (count, what, reason) in [
            (messages.skipped_bytes, "bytes", "not a message, or damaged"),
            (messages.foreign, "messages", "of another system, component or IMU"),
        ] {
            if count > 0 {
                survey.notes.push(Note::Skipped { what, count, reason });
            }
        }
        if !survey.has_reference {
            survey.notes.push(Note::Missing { what: "reference attitude" });
        }
        survey.clock = finder.clock();
        survey.segments = finder.segments().to_vec();
        survey.wraps = finder.wraps;
        Ok(survey)
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        Ok(Motion::Joint(self.values(|TimedValue { t_ns, value }| match value {
            LogValue::Measurement(Value::Imu { rate_rad_s, force_m_s2, .. }) => {
                Some(Inertial::joint(t_ns, rate_rad_s, force_m_s2))
            }
            _ => None,
        })?))
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        self.values(|TimedValue { t_ns, value }| match value {
            LogValue::Measurement(Value::Imu { field_ut, .. }) => Some((t_ns, field_ut?)),
            LogValue::Measurement(Value::Field(field_ut)) => Some((t_ns, field_ut)),
            _ => None,
        })
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let has_quaternions = self.has_quaternions;
        self.values(move |TimedValue { t_ns, value }| match value {
            LogValue::Attitude(AttitudeEstimate { quaternion, is_quaternion, .. })
                if is_quaternion == has_quaternions && is_rotation(quaternion) =>
            {
                let quaternion = frames::quaternion_to_native(Earth::Ned, Body::Frd, quaternion);
                let reference = Reference { quaternion, scored: true };
                Some(Attitude { t_ns, reference, reset_counter: Some(0) })
            }
            _ => None,
        })
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        self.values(|TimedValue { t_ns, value }| match value {
            LogValue::Measurement(Value::Fix { velocity_m_s, position, .. }) => {
                let degrees = |angle: Option<f64>| angle.map_or(f64::NAN, f64::to_degrees);
                let [latitude_deg, longitude_deg] = [position.latitude_rad, position.longitude_rad].map(degrees);
                let altitude_m = position.altitude_m.unwrap_or(f64::NAN);
                Some(ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })
            }
            _ => None,
        })
    }
}

/// Decoder of one message type with rate and force, and the state of the sensor.
struct Observer {
    imu: ImuMessage,
    name: &'static str,
    format: Mavlink,
    state: SensorState,
}

impl Observer {
    fn new(imu: ImuMessage, name: &'static str) -> Self {
        Self { imu, name, format: Mavlink::new(settings(Some(imu))), state: SensorState::default() }
    }

    /// Adds the measurement in a frame, if any.
    fn observe(&mut self, frame: &[u8]) {
        let mut measurements = Vec::new();
        self.format.parse(frame, &mut measurements);
        for Measurement { time, value } in measurements {
            if let Value::Imu { rate_rad_s, force_m_s2, .. } = value {
                self.state.push(time.map_or(0, device_ns), [Some(rate_rad_s), Some(force_m_s2)], true);
            }
        }
    }
}

fn settings(imu: Option<ImuMessage>) -> MavlinkSettings {
    MavlinkSettings { raw_scale: Some(RawScale::ARDUPILOT), imu, ..MavlinkSettings::default() }
}

/// Returns the time on the autopilot's clock, ns.
fn device_ns(time: DeviceTime) -> i64 {
    match time {
        DeviceTime::Counter { now_ns, .. } | DeviceTime::SinceBoot { now_ns } | DeviceTime::Unix { now_ns } => {
            now_ns.cast_signed()
        }
    }
}

/// Reader of the messages of a log.
struct MessageReader {
    file: CountingReader,
    buffer: Vec<u8>,
    start: usize,
    has_ended: bool,
    format: Mavlink,
    pending: Vec<Measurement>,
    pending_attitude: Option<AttitudeEstimate>,
    /// Additional decoders that receive each frame.
    observers: Vec<Observer>,
    /// `true` if the times of arrival replace those of the autopilot.
    uses_arrival_times: bool,
    /// `true` if the times of the samples count from the start of the autopilot.
    is_since_boot: bool,
    arrival_ns: i64,
    /// Time of the latest sample minus its time of arrival, ns.
    offset_ns: i64,
    skipped_bytes: u64,
    foreign: u64,
}

impl MessageReader {
    fn open(path: &Path, read_bytes: &Rc<Cell<u64>>, imu: Option<ImuMessage>) -> io::Result<Self> {
        Ok(Self {
            file: CountingReader::new(File::open(path)?, read_bytes),
            buffer: Vec::new(),
            start: 0,
            has_ended: false,
            format: Mavlink::new(settings(imu)),
            pending: Vec::new(),
            pending_attitude: None,
            observers: Vec::new(),
            uses_arrival_times: false,
            is_since_boot: false,
            arrival_ns: 0,
            offset_ns: 0,
            skipped_bytes: 0,
            foreign: 0,
        })
    }

    /// Returns the next measurement, or `None` at the end of the log.
    fn next(&mut self) -> io::Result<Option<TimedValue>> {
        loop {
            if let Some(Measurement { time, value }) = self.pending.pop() {
                let is_sample = matches!(value, Value::Imu { .. } | Value::Field(_));
                if let Some(time) = time.filter(|_| is_sample && !self.uses_arrival_times) {
                    self.offset_ns = device_ns(time).saturating_sub(self.arrival_ns);
                    self.is_since_boot = matches!(time, DeviceTime::SinceBoot { .. });
                }
                let t_ns = self.arrival_ns.saturating_add(self.offset_ns);
                return Ok(Some(TimedValue { t_ns, value: LogValue::Measurement(value) }));
            }
            if let Some(attitude) = self.pending_attitude.take() {
                let t_ns = match attitude.time {
                    DeviceTime::SinceBoot { now_ns } if self.is_since_boot => now_ns.cast_signed(),
                    _ => self.arrival_ns.saturating_add(self.offset_ns),
                };
                return Ok(Some(TimedValue { t_ns, value: LogValue::Attitude(attitude) }));
            }
            if !self.read_record()? {
                return Ok(None);
            }
        }
    }

    /// Reads the next record. Returns `false` at the end of the log.
    fn read_record(&mut self) -> io::Result<bool> {
        self.fill()?;
        let rest = &self.buffer[self.start..];
        let Some((stamp, message)) = rest.split_first_chunk::<STAMP_BYTES>() else {
            self.skipped_bytes += rest.len() as u64;
            return Ok(false);
        };
        if message.is_empty() {
            self.skipped_bytes += STAMP_BYTES as u64;
            return Ok(false);
        }
        let first = self.pending.len();
        let length = match self.format.parse(message, &mut self.pending) {
            ParseOutcome::Frame(length) => {
                let frame = message.get(..length);
                self.pending_attitude = frame.and_then(|frame| self.format.attitude(frame));
                let observe = |observer: &mut Observer| frame.iter().for_each(|frame| observer.observe(frame));
                self.observers.iter_mut().for_each(observe);
                Some(length)
            }
            ParseOutcome::Foreign(length) => {
                self.foreign += 1;
                Some(length)
            }
            _ => {
                self.pending.truncate(first);
                unknown_message_bytes(message)
            }
        };
        match length {
            Some(length) => {
                let arrival_us = i64::try_from(u64::from_be_bytes(*stamp)).unwrap_or(0);
                self.arrival_ns = arrival_us.saturating_mul(1000);
                self.start += STAMP_BYTES + length;
            }
            None => {
                self.skipped_bytes += 1;
                self.start += 1;
            }
        }
        Ok(true)
    }

    /// Reads until a complete record is buffered or the file ends.
    fn fill(&mut self) -> io::Result<()> {
        // The start of the record after the next one is needed as well.
        if self.has_ended || self.buffer.len() - self.start >= 2 * MAX_RECORD_BYTES {
            return Ok(());
        }
        self.buffer.drain(..self.start);
        self.start = 0;
        let mut part = vec![0; BUFFER_BYTES];
        while !self.has_ended && self.buffer.len() < 2 * MAX_RECORD_BYTES {
            let count = self.file.read(&mut part)?;
            self.has_ended = count == 0;
            self.buffer.extend_from_slice(&part[..count]);
        }
        Ok(())
    }
}

/// Returns the length of a message that the decoder does not know, if another record follows it.
fn unknown_message_bytes(message: &[u8]) -> Option<usize> {
    let payload_bytes = usize::from(*message.get(1)?);
    let is_signed = message.get(2).is_some_and(|flags| flags & 1 != 0);
    let length = match *message.first()? {
        STX_V1 => 8 + payload_bytes,
        STX_V2 => 12 + payload_bytes + if is_signed { 13 } else { 0 },
        _ => return None,
    };
    let next = message.get(length..)?;
    let is_followed = next.is_empty() || next.get(STAMP_BYTES).is_some_and(|byte| [STX_V1, STX_V2].contains(byte));
    is_followed.then_some(length)
}
