//! Source that reads ArduPilot DataFlash logs (BIN).
//!
//! Input: a log. Body axes: forward, right, down. Earth axes: north, east, down.
//!
//! Output: the rows of the first IMU, with magnetic field, reference and fixes.
//!
//! Time: the log's clock, converted from microseconds or milliseconds.
//!
//! Memory: a buffer for each series. The log is read once for the survey and once for each series.
//!
//! Failure: a log that contains no usable messages is an error. If a log is damaged, all complete
//! messages are read.

mod field;
mod fields;
mod messages;

use std::{
    cell::Cell,
    collections::BTreeMap,
    fs, iter,
    path::{Path, PathBuf},
    rc::Rc,
};

use crate::{
    Format, ImportError, Note, Options,
    error::open_error,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    sensor_state::SensorState,
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
};
use fields::{Estimator, Kind, Measurement};
use messages::MessageReader;

/// Number of messages between two progress reports.
const PROGRESS_INTERVAL_MESSAGES: u64 = 4096;

/// DataFlash log, and the instances selected from it.
pub(crate) struct Log {
    path: PathBuf,
    /// Requested instances of IMU, MAG and GPS.
    requested: [Option<usize>; 3],
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// Instances selected by the survey; `None` until the survey has finished.
    selection: Option<Selection>,
}

/// Instance to read for each kind of message.
struct Selection {
    inertial: Option<u8>,
    field: Option<u8>,
    attitude: Option<(Estimator, u8)>,
    receiver: Option<u8>,
}

/// Counts of valid and rejected messages, by kind and instance.
type Counts = BTreeMap<Kind, BTreeMap<u8, (u64, u64)>>;
/// States of the sensors of a kind, by instance.
type States = BTreeMap<u8, SensorState>;

impl Log {
    pub(crate) fn open(path: &Path, options: &Options) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| open_error(path, cause))?;
        let requested = [options.imu, options.mag, options.gnss];
        let (path, read_bytes) = (path.to_owned(), Rc::default());
        Ok(Self { path, requested, length_bytes: found.len(), read_bytes, selection: None })
    }

    /// Returns the requested instance of a kind, which must exist.
    fn requested(
        &self,
        counts: &Counts,
        kind: Kind,
        requested: Option<usize>,
        what: &'static str,
    ) -> Result<Option<u8>, ImportError> {
        let Some(found) = requested else { return Ok(None) };
        let instances = counts.get(&kind);
        let instance =
            u8::try_from(found).ok().filter(|instance| instances.is_some_and(|all| all.contains_key(instance)));
        let count = instances.map_or(0, BTreeMap::len);
        instance.map(Some).ok_or_else(|| ImportError::UnknownSensor { path: self.path.clone(), what, found, count })
    }

    fn messages(&self) -> Result<MessageReader, ImportError> {
        MessageReader::open(&self.path, &self.read_bytes).map_err(|cause| open_error(&self.path, cause))
    }

    /// Returns the valid messages of one kind and instance, in log order.
    fn measurements(
        &self,
        kind: Kind,
        instance: u8,
    ) -> Result<impl Iterator<Item = Result<Measurement, ImportError>>, ImportError> {
        let mut messages = self.messages()?;
        let mut next = move || -> Result<Option<Measurement>, ImportError> {
            while let Some((layout, message)) = messages.next().map_err(|cause| open_error(&self.path, cause))? {
                if layout.kind == kind
                    && layout.instance(message) == instance
                    && let Some(measurement) = layout.decode(message)
                {
                    return Ok(Some(measurement));
                }
            }
            Ok(None)
        };
        Ok(std::iter::from_fn(move || next().transpose()))
    }
}

impl Source for Log {
    fn format(&self) -> Format {
        Format::ArduPilot
    }

    fn total_bytes(&self) -> u64 {
        let series = self.selection.as_ref().map_or(3, |selection| {
            let Selection { field, attitude, receiver, .. } = selection;
            [field.is_some(), attitude.is_some(), receiver.is_some()].into_iter().filter(|is_read| *is_read).count()
        });
        (2 + series as u64) * self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.read_bytes.get()
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut counts = Counts::new();
        let (mut imus, mut magnetometers, mut receivers) = (States::new(), States::new(), States::new());
        let mut messages = self.messages()?;
        let mut receiver = None;
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            let next = messages.next().map_err(|cause| open_error(&self.path, cause))?;
            let Some((layout, message)) = next else { break };
            let (instance, measurement) = (layout.instance(message), layout.decode(message));
            let (samples, rejected) = counts.entry(layout.kind).or_default().entry(instance).or_default();
            *samples += u64::from(measurement.is_some());
            *rejected += u64::from(measurement.is_none());
            match measurement {
                Some(Measurement::Inertial { t_ns, rate_rad_s, force_m_s2, is_healthy }) => {
                    let values = [Some(rate_rad_s), Some(force_m_s2)];
                    imus.entry(instance).or_default().push(t_ns, values, is_healthy);
                }
                Some(Measurement::Field { t_ns, field_ut, is_healthy }) => {
                    magnetometers.entry(instance).or_default().push(t_ns, [Some(field_ut), None], is_healthy);
                }
                // If there are several receivers, the one with the first fix is used.
                Some(Measurement::Fix(ReceiverFix { t_ns, velocity_m_s, .. })) => {
                    receiver.get_or_insert(instance);
                    let state = receivers.entry(instance).or_insert_with(SensorState::of_receiver);
                    state.push(t_ns, [Some(velocity_m_s), None], true);
                }
                _ => {}
            }
        }
        progress(self.read_bytes.get());

        let mut notes = Vec::new();
        if messages.skipped_bytes > 0 {
            let reason = "not a message, or damaged";
            notes.push(Note::Skipped { what: "bytes", count: messages.skipped_bytes, reason });
        }
        let [imu, mag, gnss] = self.requested;
        let imu = self.requested(&counts, Kind::Inertial, imu, "--imu")?;
        let healthy_imu = first_healthy(&imus, imu, "IMU", &mut notes);
        let inertial = select_instance(&counts, Kind::Inertial, "IMU", imu.or(healthy_imu), &mut notes);
        let mag = self.requested(&counts, Kind::Field, mag, "--mag")?;
        let healthy_mag = first_healthy(&magnetometers, mag, "MAG", &mut notes);
        let field = select_instance(&counts, Kind::Field, "MAG", mag.or(healthy_mag), &mut notes);
        let receiver = self.requested(&counts, Kind::Fix, gnss, "--gnss")?.or(receiver);
        select_instance(&counts, Kind::Fix, "GPS", receiver, &mut notes);
        let attitude = Estimator::ALL.into_iter().find_map(|(estimator, topic)| {
            let instance = select_instance(&counts, Kind::Attitude(estimator), topic, None, &mut notes)?;
            Some((estimator, instance))
        });
        for (is_present, what) in [
            (attitude.is_some(), "reference attitude (XKQ, NKQ, ATT, XKF1, NKF1, AHR2)"),
            (receiver.is_some(), "receiver velocity (GPS)"),
        ] {
            if !is_present {
                notes.push(Note::Missing { what });
            }
        }
        let (has_field, has_reference) = (field.is_some(), attitude.is_some());
        let sensors = [
            ("--imu", "IMU", &imus, inertial),
            ("--mag", "MAG", &magnetometers, field),
            ("--gnss", "GPS", &receivers, receiver),
        ];
        let sensors = sensors.into_iter().flat_map(|(option, name, states, read)| {
            states.iter().map(move |(instance, state)| {
                let is_read = read == Some(*instance);
                state.sensor(option, usize::from(*instance), format!("{name} {instance}"), is_read)
            })
        });
        let sensors = sensors.collect();
        self.selection = Some(Selection { inertial, field, attitude, receiver });
        let finder = inertial.and_then(|instance| imus.remove(&instance)).unwrap_or_default().segments;
        Ok(Survey {
            has_field,
            has_reference,
            has_fixes: receiver.is_some(),
            notes,
            sensors,
            expected: "IMU with GyrX and AccX".into(),
            clock: finder.clock(),
            segments: finder.segments().to_vec(),
            wraps: finder.wraps,
            ..Survey::default()
        })
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(instance) = self.selection.as_ref().and_then(|selection| selection.field) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let measurements = self.measurements(Kind::Field, instance)?;
        Ok(Box::new(measurements.filter_map(|measurement| match measurement {
            Ok(Measurement::Field { t_ns, field_ut, .. }) => Some(Ok((t_ns, field_ut))),
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some((estimator, instance)) = self.selection.as_ref().and_then(|selection| selection.attitude) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let measurements = self.measurements(Kind::Attitude(estimator), instance)?;
        Ok(Box::new(measurements.filter_map(|measurement| match measurement {
            Ok(Measurement::Attitude(attitude)) => Some(Ok(attitude)),
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })))
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        let Some(instance) = self.selection.as_ref().and_then(|selection| selection.receiver) else {
            return Ok(Box::new(iter::empty()));
        };
        let measurements = self.measurements(Kind::Fix, instance)?;
        Ok(Box::new(measurements.filter_map(|measurement| match measurement {
            Ok(Measurement::Fix(fix)) => Some(Ok(fix)),
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })))
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        let Some(instance) = self.selection.as_ref().and_then(|selection| selection.inertial) else {
            return Ok(Motion::Joint(Box::new(iter::empty())));
        };
        let measurements = self.measurements(Kind::Inertial, instance)?;
        Ok(Motion::Joint(Box::new(measurements.filter_map(|measurement| match measurement {
            Ok(Measurement::Inertial { t_ns, rate_rad_s, force_m_s2, .. }) => {
                Some(Ok(Inertial::joint(t_ns, rate_rad_s, force_m_s2)))
            }
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        }))))
    }
}

/// Returns the number of the first sensor that works, if any. Adds a note that names the skipped
/// sensors, unless a sensor is requested.
fn first_healthy(states: &States, requested: Option<u8>, topic: &str, notes: &mut Vec<Note>) -> Option<u8> {
    let healthy = states.iter().find(|(_, state)| state.is_healthy()).map(|(instance, _)| *instance);
    let first = states.keys().next().copied();
    if let (None, Some(first), Some(read)) = (requested, first, healthy)
        && first != read
    {
        let [sensor, read] = [first, read].map(|instance| format!("{topic} {instance}").into());
        notes.push(Note::DeadSensor { sensor, read });
    }
    healthy
}

/// Selects the instance that is read for a kind. This is `preferred`, or else the first instance
/// with valid messages.
fn select_instance(
    counts: &Counts,
    kind: Kind,
    topic: &'static str,
    preferred: Option<u8>,
    notes: &mut Vec<Note>,
) -> Option<u8> {
    let instances = counts.get(&kind)?;
    let read = preferred.or_else(|| instances.iter().find(|(_, (samples, _))| *samples > 0).map(|(read, _)| *read))?;
    let others = instances.iter().filter(|(instance, _)| **instance != read).map(|(_, (samples, _))| samples).sum();
    if others > 0 {
        notes.push(Note::OtherInstances { topic, read, others });
    }
    if let Some((_, count @ 1..)) = instances.get(&read) {
        let (what, reason) = match kind {
            Kind::Fix => ("fixes", "no 3D fix, or not a number"),
            _ => ("messages of the types read", "not a number, or not a rotation"),
        };
        notes.push(Note::Skipped { what, count: *count, reason });
    }
    Some(read)
}
