//! A DataFlash log (BIN) of ArduPilot.
//!
//! Input: a log. Output: the rows of its first IMU, with what others say. Frames: forward, right, down and north, east, down. Time: the
//! log's own, from microseconds. Memory: a buffer for each series; the log is read once for what is there and once for each of
//! them. Failure: a log that says nothing; of a damaged one, every message that is whole is read.

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
    force_aligner::{ForceAligner, Sample},
    error::opening,
    row_writer::{Attitude, RowWriter, Samples},
    source::{Source, Survey, TakeFix},
};
use fields::{Estimator, Kind, Said};
use messages::Messages;

/// Messages between two signs of progress.
const TELL_EVERY: u64 = 4096;

pub(crate) struct Log {
    path: PathBuf,
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// What the first reading chose; `None` before it.
    choice: Option<Choice>,
}

/// The instance of each kind that is read.
struct Choice {
    inertial: Option<u8>,
    field: Option<u8>,
    attitude: Option<(Estimator, u8)>,
}

/// What came of the messages of a kind, by instance: those that say something, and those that do not.
type Counts = BTreeMap<Kind, BTreeMap<u8, (u64, u64)>>;

impl Log {
    pub(crate) fn open(path: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| opening(path, cause))?;
        Ok(Self { path: path.to_owned(), length_bytes: found.len(), read_bytes: Rc::default(), choice: None })
    }

    fn messages(&self) -> Result<Messages, ImportError> {
        Messages::open(&self.path, &self.read_bytes).map_err(|cause| opening(&self.path, cause))
    }

    /// What the messages of one kind and instance say, in the order of the log.
    fn said(&self, kind: Kind, instance: u8) -> Result<impl Iterator<Item = Result<Said, ImportError>>, ImportError> {
        let mut messages = self.messages()?;
        let mut next = move || -> Result<Option<Said>, ImportError> {
            while let Some((layout, message)) = messages.next().map_err(|cause| opening(&self.path, cause))? {
                if layout.kind == kind
                    && layout.instance(message) == instance
                    && let Some(said) = layout.said(message)
                {
                    return Ok(Some(said));
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
            .choice
            .as_ref()
            .map_or(2, |choice| u64::from(choice.field.is_some()) + u64::from(choice.attitude.is_some()));
        (2 + series) * self.length_bytes
    }

    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut counts = Counts::new();
        let mut messages = self.messages()?;
        let mut receiver = None;
        let (mut last_ns, mut fixes_not_after) = (None, 0);
        for index in 0u64.. {
            if index.is_multiple_of(TELL_EVERY) {
                tell(self.read_bytes.get());
            }
            let next = messages.next().map_err(|cause| opening(&self.path, cause))?;
            let Some((layout, message)) = next else { break };
            let (instance, said) = (layout.instance(message), layout.said(message));
            let (samples, refused) = counts.entry(layout.kind).or_default().entry(instance).or_default();
            *samples += u64::from(said.is_some());
            *refused += u64::from(said.is_none());
            // Of several receivers the one that had a fix first.
            if let Some(Said::Fix(fix)) = said
                && *receiver.get_or_insert(instance) == instance
            {
                if last_ns.is_some_and(|last_ns| fix.t_ns <= last_ns) {
                    fixes_not_after += 1;
                } else {
                    last_ns = Some(fix.t_ns);
                    take(&fix)?;
                }
            }
        }
        tell(self.read_bytes.get());

        let mut notes = Vec::new();
        if messages.passed_over > 0 {
            let why = "they are no message, or are damaged";
            notes.push(Note::LeftOut { what: "bytes of the log", count: messages.passed_over, why });
        }
        let inertial = choose(&counts, Kind::Inertial, "IMU", None, &mut notes);
        let field = choose(&counts, Kind::Field, "MAG", None, &mut notes);
        choose(&counts, Kind::Fix, "GPS", receiver, &mut notes);
        if fixes_not_after > 0 {
            let why = "they are not later than the one before them";
            notes.push(Note::LeftOut { what: "fixes", count: fixes_not_after, why });
        }
        let attitude = Estimator::ALL.into_iter().find_map(|(estimator, topic)| {
            let instance = choose(&counts, Kind::Attitude(estimator), topic, None, &mut notes)?;
            Some((estimator, instance))
        });
        for (is_there, what) in [
            (attitude.is_some(), "reference attitude (XKQ, NKQ, ATT, XKF1, NKF1, AHR2)"),
            (receiver.is_some(), "velocity of a receiver (GPS)"),
        ] {
            if !is_there {
                notes.push(Note::Missing { what });
            }
        }
        let (has_field, has_reference) = (field.is_some(), attitude.is_some());
        self.choice = Some(Choice { inertial, field, attitude });
        let expected = "IMU with GyrX and AccX".into();
        Ok(Survey { has_field, has_reference, notes, reason: None, expected })
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(instance) = self.choice.as_ref().and_then(|choice| choice.field) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let said = self.said(Kind::Field, instance)?;
        Ok(Box::new(said.filter_map(|said| match said {
            Ok(Said::Field { t_ns, field_ut }) => Some(Ok((t_ns, field_ut))),
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some((estimator, instance)) = self.choice.as_ref().and_then(|choice| choice.attitude) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let said = self.said(Kind::Attitude(estimator), instance)?;
        Ok(Box::new(said.filter_map(|said| match said {
            Ok(Said::Attitude(attitude)) => Some(Ok(attitude)),
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })))
    }

    fn rows(&self, rows: &mut RowWriter, tell: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let mut aligned = ForceAligner::default();
        let Some(instance) = self.choice.as_ref().and_then(|choice| choice.inertial) else { return Ok(aligned) };
        for (index, said) in (0u64..).zip(self.said(Kind::Inertial, instance)?) {
            if index.is_multiple_of(TELL_EVERY) {
                tell(self.read_bytes.get());
            }
            if let Said::Inertial { t_ns, rate_rad_s, force_m_s2 } = said? {
                aligned.push_force((t_ns, force_m_s2), rows)?;
                aligned.push_rate((t_ns, rate_rad_s), rows)?;
            }
        }
        aligned.finish(rows)?;
        Ok(aligned)
    }
}

/// The instance of a kind to read: the one `given`, else the first of those that say something.
fn choose(counts: &Counts, kind: Kind, topic: &'static str, given: Option<u8>, notes: &mut Vec<Note>) -> Option<u8> {
    let instances = counts.get(&kind)?;
    let read = given.or_else(|| instances.iter().find(|(_, (samples, _))| *samples > 0).map(|(read, _)| *read))?;
    let others = instances.iter().filter(|(instance, _)| **instance != read).map(|(_, (samples, _))| samples).sum();
    if others > 0 {
        notes.push(Note::OtherInstances { topic, read, others });
    }
    if let Some((_, count @ 1..)) = instances.get(&read) {
        let (what, why) = match kind {
            Kind::Fix => ("fixes", "the receiver has no position in three dimensions, or they are no numbers"),
            _ => ("messages of the types read", "they are no numbers, or no rotation"),
        };
        notes.push(Note::LeftOut { what, count: *count, why });
    }
    Some(read)
}
