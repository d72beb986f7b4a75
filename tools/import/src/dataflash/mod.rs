//! Source that reads ArduPilot DataFlash logs (BIN).
//!
//! Input: a log. Body axes: forward, right, down. Earth axes: north, east, down.
//!
//! Output: the rows of the first IMU, with field, reference and fixes.
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
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use crate::{
    Format, ImportError, Note,
    error::open_error,
    force_aligner::ForceAligner,
    row_writer::Sample,
    row_writer::{Attitude, RowWriter, Samples},
    source::{FixSink, Source, Survey},
};
use fields::{Estimator, Kind, Measurement};
use messages::MessageReader;

/// Number of messages between two progress reports.
const PROGRESS_INTERVAL_MESSAGES: u64 = 4096;

/// DataFlash log, and the instances selected from it.
pub(crate) struct Log {
    path: PathBuf,
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
}

/// Counts of valid and rejected messages, by kind and instance.
type Counts = BTreeMap<Kind, BTreeMap<u8, (u64, u64)>>;

impl Log {
    pub(crate) fn open(path: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| open_error(path, cause))?;
        Ok(Self { path: path.to_owned(), length_bytes: found.len(), read_bytes: Rc::default(), selection: None })
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
        let series = self
            .selection
            .as_ref()
            .map_or(2, |selection| u64::from(selection.field.is_some()) + u64::from(selection.attitude.is_some()));
        (2 + series) * self.length_bytes
    }

    fn survey(&mut self, on_fix: &mut FixSink<'_>, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut counts = Counts::new();
        let mut messages = self.messages()?;
        let mut receiver = None;
        let (mut last_ns, mut fixes_out_of_order) = (None, 0);
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
            // If there are several receivers, the one with the first fix is used.
            if let Some(Measurement::Fix(fix)) = measurement
                && *receiver.get_or_insert(instance) == instance
            {
                if last_ns.is_some_and(|last_ns| fix.t_ns <= last_ns) {
                    fixes_out_of_order += 1;
                } else {
                    last_ns = Some(fix.t_ns);
                    on_fix(&fix)?;
                }
            }
        }
        progress(self.read_bytes.get());

        let mut notes = Vec::new();
        if messages.skipped_bytes > 0 {
            let reason = "not a message, or damaged";
            notes.push(Note::Skipped { what: "bytes", count: messages.skipped_bytes, reason });
        }
        let inertial = select_instance(&counts, Kind::Inertial, "IMU", None, &mut notes);
        let field = select_instance(&counts, Kind::Field, "MAG", None, &mut notes);
        select_instance(&counts, Kind::Fix, "GPS", receiver, &mut notes);
        if fixes_out_of_order > 0 {
            let reason = "timestamps do not increase";
            notes.push(Note::Skipped { what: "fixes", count: fixes_out_of_order, reason });
        }
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
        self.selection = Some(Selection { inertial, field, attitude });
        let expected = "IMU with GyrX and AccX".into();
        Ok(Survey { has_field, has_reference, notes, reason: None, expected })
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(instance) = self.selection.as_ref().and_then(|selection| selection.field) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let measurements = self.measurements(Kind::Field, instance)?;
        Ok(Box::new(measurements.filter_map(|measurement| match measurement {
            Ok(Measurement::Field { t_ns, field_ut }) => Some(Ok((t_ns, field_ut))),
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

    fn write_rows(&self, rows: &mut RowWriter, progress: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let mut aligner = ForceAligner::default();
        let Some(instance) = self.selection.as_ref().and_then(|selection| selection.inertial) else {
            return Ok(aligner);
        };
        for (index, measurement) in (0u64..).zip(self.measurements(Kind::Inertial, instance)?) {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            if let Measurement::Inertial { t_ns, rate_rad_s, force_m_s2 } = measurement? {
                aligner.push_force((t_ns, force_m_s2), rows)?;
                aligner.push_rate((t_ns, rate_rad_s), rows)?;
            }
        }
        aligner.finish(rows)?;
        Ok(aligner)
    }
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
