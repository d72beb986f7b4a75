//! Source that reads PX4 ULog files.
//!
//! Input: a PX4 log.
//!
//! Output: the rows of `sensor_combined`, or of one instance of `vehicle_imu`, or of `sensor_gyro`
//! and `sensor_accel`, with magnetic field, reference and fixes from other topics.
//!
//! Time: the log's clock, converted from microseconds. The time of a rate sample in
//! `sensor_combined` is `timestamp`; that of a force sample is `timestamp` plus
//! `accelerometer_timestamp_relative`.
//!
//! Memory: independent of the length of the log. The log is read once for the survey, and once each
//! for the rows, magnetic field, attitude and fixes.
//!
//! Failure: a log that contains no usable samples is an error. Damaged parts of a log are skipped
//! and counted.

mod fields;
mod kind;
mod messages;
mod series;
mod topics;

use std::{
    collections::BTreeMap,
    fs, iter,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{
    Format, ImportError, Note, Options, Sensor,
    error::open_error,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    sensor_state::SensorState,
    source::{Motion, ReceiverFix, Source, Survey},
};
use kind::Kind;
use messages::LogStatus;
use series::{Series, stream};
use topics::{Layouts, Measurement};

/// ULog file, and the series selected from it.
pub(crate) struct Log {
    path: PathBuf,
    /// Requested numbers of the inertial sensor, the magnetometer and the receiver.
    requested: [Option<usize>; 3],
    length_bytes: u64,
    /// Number of bytes read by the pass for the rows, which runs in a separate thread.
    row_bytes: Arc<AtomicU64>,
    /// Series selected by the survey; `None` until the survey has finished.
    selection: Option<Selection>,
}

/// One instance of a kind of series.
type Instance = (Kind, u8);
/// All series of the log.
type AllSeries = BTreeMap<Instance, Series>;

/// Series that are read.
#[derive(Debug, Clone, Default)]
struct Selection {
    rates: Option<Instance>,
    /// Series of the force, if it differs from that of the rate.
    forces: Option<Instance>,
    fields: Option<Instance>,
    attitudes: Option<Instance>,
    fixes: Option<Instance>,
}

impl Log {
    pub(crate) fn open(path: &Path, options: &Options) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| open_error(path, cause))?;
        let requested = [options.imu, options.mag, options.gnss];
        let (path, row_bytes) = (path.to_owned(), Arc::default());
        Ok(Self { path, requested, length_bytes: found.len(), row_bytes, selection: None })
    }

    /// Reads the log and counts the samples of all series.
    fn survey_series(&self, progress: &mut dyn FnMut(u64)) -> Result<(AllSeries, LogStatus), ImportError> {
        let (mut all, mut layouts) = (AllSeries::new(), Layouts::default());
        // Health of each sensor by its kind and device number, as last reported.
        let mut health = BTreeMap::<(Kind, u32), bool>::new();
        let status = messages::read(&self.path, &Kind::TOPICS.map(|(topic, _)| topic), progress, &mut |message| {
            for kind in Kind::of_topic(message.flattened_format.message_name()) {
                let Some(layout) = layouts.find(&self.path, *kind, message)? else { continue };
                let instance = (*kind, message.multi_id.value());
                let new = || Series { state: kind.new_state(), ..Series::default() };
                if *kind == Kind::Health {
                    health.extend(layout.health(message.data));
                    continue;
                }
                let series = all.entry(instance).or_insert_with(new);
                series.messages += 1;
                let Some(measurement) = series.accept(*kind, layout.decode(message.data)) else { continue };
                let is_healthy = layout.devices(message.data).all(|device| health.get(&device) != Some(&false));
                series.state.push(measurement.t_ns(), measurement.values(), is_healthy);
            }
            Ok(())
        })?;
        Ok((all, status))
    }

    /// Returns the number of the requested sensor, or `None` if no sensor is requested. Fails if
    /// the number is not in `numbers`.
    fn requested(
        &self,
        requested: Option<usize>,
        what: &'static str,
        numbers: &[u8],
    ) -> Result<Option<u8>, ImportError> {
        let Some(found) = requested else { return Ok(None) };
        let number = u8::try_from(found).ok().filter(|number| numbers.contains(number));
        let count = numbers.len();
        number.map(Some).ok_or_else(|| ImportError::UnknownSensor { path: self.path.clone(), what, found, count })
    }

    /// Selects the series of rate and force. Adds the inertial sensors to `sensors`.
    fn select_motion(
        &self,
        all: &AllSeries,
        selection: &mut Selection,
        sensors: &mut Vec<Sensor>,
        notes: &mut Vec<Note>,
    ) -> Result<(), ImportError> {
        let integrated = numbers(all, Kind::Integrated);
        let forces = numbers(all, Kind::Force);
        let separate: Vec<u8> = numbers(all, Kind::Rate).into_iter().filter(|rate| forces.contains(rate)).collect();
        let is_integrated = !integrated.is_empty();
        let candidates = if is_integrated { integrated } else { separate };
        let pair = |number: u8| {
            let (rate, force) = if is_integrated { (Kind::Integrated, None) } else { (Kind::Rate, Some(Kind::Force)) };
            ((rate, number), force.map(|force| (force, number)))
        };
        let problem = |(rate, force): (Instance, Option<Instance>)| {
            iter::once(rate).chain(force).find_map(|series| all.get(&series)?.state.problem())
        };
        let combined = numbers(all, Kind::Combined).first().map(|number| ((Kind::Combined, *number), None));
        let requested = self.requested(self.requested[0], "--imu", &candidates)?.map(pair);
        let all_sensors = || combined.into_iter().chain(candidates.iter().map(|number| pair(*number)));
        let healthy = || all_sensors().find(|sensor| problem(*sensor).is_none());
        let read = requested.or_else(healthy).or_else(|| all_sensors().next());
        let name = |(rate, force): (Instance, Option<Instance>)| {
            let series = iter::once(rate).chain(force).map(|(kind, number)| format!("{} {number}", kind.topic()));
            series.collect::<Vec<_>>().join(" and ")
        };
        if let (None, Some(first), Some(read)) = (requested, all_sensors().next(), read)
            && first != read
        {
            notes.push(Note::DeadSensor { sensor: name(first).into(), read: name(read).into() });
        }
        for sensor in all_sensors() {
            let (rate @ (kind, number), _) = sensor;
            let Some(series) = all.get(&rate) else { continue };
            let is_read = read == Some(sensor);
            let mut entry = series.state.sensor("--imu", number.into(), name(sensor), is_read);
            entry.state = problem(sensor).unwrap_or(entry.state);
            if kind == Kind::Combined {
                entry.option = "default".into();
            }
            sensors.push(entry);
        }
        if let Some((rate, force)) = read {
            (selection.rates, selection.forces) = (Some(rate), force);
        }
        Ok(())
    }

    /// Selects the series of a sensor: the requested one, otherwise the first one that works.
    ///
    /// The kind is the first of `kinds` with samples. Adds all sensors of that kind to `sensors`.
    fn select_sensor(
        &self,
        all: &AllSeries,
        kinds: &[Kind],
        (requested, option): (Option<usize>, &'static str),
        sensors: &mut Vec<Sensor>,
        notes: &mut Vec<Note>,
    ) -> Result<Option<Instance>, ImportError> {
        let has_samples = |kind: &Kind| all.iter().any(|((other, _), series)| other == kind && series.accepted > 0);
        let kind = kinds
            .iter()
            .copied()
            .find(has_samples)
            .or_else(|| kinds.iter().copied().find(|kind| !numbers(all, *kind).is_empty()));
        let numbers = kind.map_or_else(Vec::new, |kind| numbers(all, kind));
        let requested = self.requested(requested, option, &numbers)?;
        let Some(kind) = kind else { return Ok(None) };
        let state = |number: u8| all.get(&(kind, number)).map(|series| &series.state);
        let healthy = || numbers.iter().copied().find(|number| state(*number).is_some_and(SensorState::is_healthy));
        let read = requested.or_else(healthy).or(numbers.first().copied());
        if let (None, Some(first), Some(read)) = (requested, numbers.first(), read)
            && *first != read
        {
            let [sensor, read] = [*first, read].map(|number| format!("{} {number}", kind.topic()).into());
            notes.push(Note::DeadSensor { sensor, read });
        }
        for number in &numbers {
            let name = format!("{} {number}", kind.topic());
            let sensor =
                state(*number).map(|state| state.sensor(option, (*number).into(), name, read == Some(*number)));
            sensors.extend(sensor);
        }
        Ok(read.map(|number| (kind, number)))
    }

    /// Returns the measurements of a series in log order.
    fn measurements<T: Send + 'static>(
        &self,
        (kind, number): Instance,
        read_bytes: Arc<AtomicU64>,
        convert: impl Fn(Measurement) -> Option<T> + Send + 'static,
    ) -> Samples<'static, T> {
        let (path, mut layouts, mut series) = (self.path.clone(), Layouts::default(), Series::default());
        stream(path.clone(), kind.topic(), read_bytes, move |message| {
            if message.multi_id.value() != number {
                return Ok(None);
            }
            let Some(layout) = layouts.find(&path, kind, message)? else { return Ok(None) };
            Ok(series.accept(kind, layout.decode(message.data)).and_then(&convert))
        })
    }

    fn selected(&self, series: impl Fn(&Selection) -> Option<Instance>) -> Option<Instance> {
        self.selection.as_ref().and_then(series)
    }
}

/// Returns the instances of a kind.
fn numbers(all: &AllSeries, kind: Kind) -> Vec<u8> {
    all.keys().filter(|(other, _)| *other == kind).map(|(_, number)| *number).collect()
}

impl Series {
    /// Counts a measurement. Returns it unless it is invalid or repeats the previous one.
    fn accept(&mut self, kind: Kind, measurement: Option<Measurement>) -> Option<Measurement> {
        let is_combined_field = kind == Kind::CombinedField;
        let Some(measurement) = measurement else {
            // A message without a new magnetic field marks the field's time as invalid. This is not
            // an error.
            self.rejected += u64::from(!is_combined_field);
            return None;
        };
        if is_combined_field && self.last_ns == Some(measurement.t_ns()) {
            return None;
        }
        if !measurement.is_finite() {
            self.rejected += 1;
            return None;
        }
        self.last_ns = Some(measurement.t_ns());
        self.accepted += 1;
        Some(measurement)
    }
}

impl Source for Log {
    fn format(&self) -> Format {
        Format::Ulog
    }

    fn total_bytes(&self) -> u64 {
        2 * self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.length_bytes + self.row_bytes.load(Ordering::Relaxed)
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let (all, status) = self.survey_series(progress)?;
        let [_, mag, gnss] = self.requested;
        let (mut selection, mut sensors, mut choices) = (Selection::default(), Vec::new(), Vec::new());
        self.select_motion(&all, &mut selection, &mut sensors, &mut choices)?;
        let fields = [Kind::CombinedField, Kind::Field, Kind::RawField];
        selection.fields = self.select_sensor(&all, &fields, (mag, "--mag"), &mut sensors, &mut choices)?;
        let receivers = if gnss.is_some() { [Kind::RawFix, Kind::Fix] } else { [Kind::Fix, Kind::RawFix] };
        selection.fixes = self.select_sensor(&all, &receivers, (gnss, "--gnss"), &mut sensors, &mut choices)?;
        selection.attitudes = numbers(&all, Kind::Attitude).first().map(|number| (Kind::Attitude, *number));
        let accepted = |series: Option<Instance>| {
            series.and_then(|series| all.get(&series)).is_some_and(|series| series.accepted > 0)
        };
        let has_motion = selection.rates.is_some();
        let expected = if has_motion {
            "gyro_rad and accelerometer_m_s2 in sensor_combined"
        } else {
            "the topic sensor_combined, vehicle_imu, or sensor_gyro and sensor_accel"
        };
        let damage = status.damage.as_ref().map(|(at_byte, found)| format!("byte {at_byte}: {found}").into());
        let mut notes = selection.notes(&all, &status, self.length_bytes);
        notes.splice(0..0, choices);
        let finder = selection.rates.and_then(|rates| all.get(&rates)).map(|series| series.state.segments.clone());
        let finder = finder.unwrap_or_default();
        let survey = Survey {
            has_field: accepted(selection.fields),
            has_reference: accepted(selection.attitudes),
            has_fixes: accepted(selection.fixes),
            clock: finder.clock(),
            segments: finder.segments().to_vec(),
            wraps: finder.wraps,
            notes,
            sensors,
            reason: damage.filter(|_| !has_motion),
            expected: expected.into(),
            ..Survey::default()
        };
        self.selection = Some(selection);
        Ok(survey)
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(fields) = self.selected(|selection| selection.fields) else { return Ok(Box::new(iter::empty())) };
        Ok(self.measurements(fields, Arc::default(), |measurement| match measurement {
            Measurement::Field(field) => Some(field),
            _ => None,
        }))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let attitudes = self.selected(|selection| selection.attitudes);
        let Some(attitudes) = attitudes else { return Ok(Box::new(iter::empty())) };
        Ok(self.measurements(attitudes, Arc::default(), |measurement| match measurement {
            Measurement::Attitude(attitude) => Some(attitude),
            _ => None,
        }))
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        let Some(fixes) = self.selected(|selection| selection.fixes) else { return Ok(Box::new(iter::empty())) };
        Ok(self.measurements(fixes, Arc::default(), |measurement| match measurement {
            Measurement::Fix(fix) => Some(fix),
            _ => None,
        }))
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        let rates = self.selected(|selection| selection.rates);
        let Some(rates) = rates else { return Ok(Motion::Joint(Box::new(iter::empty()))) };
        let inertial = |measurement| match measurement {
            Measurement::Inertial(inertial) => Some(inertial),
            _ => None,
        };
        let Some(forces) = self.selected(|selection| selection.forces) else {
            return Ok(Motion::Joint(self.measurements(rates, self.row_bytes.clone(), inertial)));
        };
        Ok(Motion::Separate {
            rates: self.measurements(rates, self.row_bytes.clone(), move |measurement| inertial(measurement)?.rate),
            forces: self.measurements(forces, Arc::default(), move |measurement| inertial(measurement)?.force),
        })
    }
}

impl Selection {
    fn notes(&self, all: &AllSeries, status: &LogStatus, length_bytes: u64) -> Vec<Note> {
        let LogStatus { damage, dropouts, dropouts_ms, malformed, skipped_bytes } = status;
        let mut notes = Vec::new();
        if let Some((at_byte, found)) = damage.clone() {
            notes.push(Note::Damage { at_byte, length_bytes, found });
        }
        for (what, count, reason) in [
            ("bytes", skipped_bytes, "not a message, or damaged"),
            ("messages", malformed, "damaged: unknown type or topic, or invalid content"),
        ] {
            if *count > 0 {
                notes.push(Note::Skipped { what, count: *count, reason });
            }
        }
        for (selected, what, reason) in [
            (self.rates, None, "the time is out of range"),
            (self.forces, None, "the time is out of range"),
            (self.fields, Some("field samples"), "a component is not a number"),
            (self.attitudes, Some("reference attitudes"), "the quaternion is not a rotation"),
            (self.fixes, Some("fixes"), "velocity invalid, or no 3D fix"),
        ] {
            let Some((kind, read)) = selected else { continue };
            let others = all.iter().filter(|((other, number), _)| *other == kind && *number != read);
            let others: u64 = others.map(|(_, series)| series.messages).sum();
            if others > 0 {
                notes.push(Note::OtherInstances { topic: kind.topic(), read, others });
            }
            let count = all.get(&(kind, read)).map_or(0, |series| series.rejected);
            if count > 0 {
                notes.push(Note::Skipped { what: what.unwrap_or(kind.samples()), count, reason });
            }
        }
        for (series, what) in [
            (self.attitudes, "reference attitude (vehicle_attitude)"),
            (self.fixes, "receiver velocity (vehicle_gps_position, sensor_gps)"),
        ] {
            if series.and_then(|series| all.get(&series)).is_none_or(|series| series.accepted == 0) {
                notes.push(Note::Missing { what });
            }
        }
        if *dropouts > 0 {
            notes.push(Note::Dropouts { count: *dropouts, total_ms: *dropouts_ms });
        }
        notes
    }
}
