//! The topics of a ULog.
//!
//! Input: a log of PX4. Output: the rows of `sensor_combined`, with what the other topics say. Time: the log's own, from microseconds; the
//! rate's is `timestamp`, the force's is that plus `accelerometer_timestamp_relative`. Memory: the samples of field, attitude and
//! receiver, each up to [`SAMPLES_MAX`]; the log is read twice, so that rows are not kept. Failure: a log that says nothing; of a
//! damaged one, what was good before is read.

mod fields;
mod messages;

use attitude::frames::Body;
use std::{
    fs,
    path::{Path, PathBuf},
};

use px4_ulog::stream_parser::DataMessage;

use crate::{
    Format, ImportError, Note,
    aligned::{Aligned, Sample},
    error::opening,
    rows::{Attitude, Rows, Samples},
    source::{Fixed, Source, Survey, TakeFix},
};
use fields::{AttitudeFields, Combined, Field, Magnetometer, Receiver, Turned};
use messages::Ending;

const COMBINED: &str = "sensor_combined";
const MAGNETOMETER: &str = "vehicle_magnetometer";
const ATTITUDE: &str = "vehicle_attitude";
const RECEIVER: &str = "vehicle_gps_position";
/// Of one receiver; the former is made of all of them.
const RECEIVER_RAW: &str = "sensor_gps";
const TOPICS: [&str; 5] = [COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER, RECEIVER_RAW];

/// Samples of a topic that are kept: nine hours at 250 Hz.
const SAMPLES_MAX: usize = 1 << 23;
pub(crate) struct Log {
    path: PathBuf,
    length_bytes: u64,
    topics: Topics,
}

/// What the first reading finds: everything but the rows; each series in the order of time.
#[derive(Default)]
struct Topics {
    /// Samples of `sensor_combined`.
    combined: u64,
    combined_instance: u8,
    fields: Vec<Field>,
    attitudes: Vec<Turned>,
    fixes: Vec<Fixed>,
    ending: Ending,
    notes: Vec<Note>,
}

/// The samples of the first instance of a topic, in the order of time.
struct Series<T> {
    topic: &'static str,
    what: &'static str,
    instance: Option<u8>,
    samples: Vec<T>,
    /// Of other instances.
    others: u64,
    not_after: u64,
    beyond: u64,
    refused: u64,
}

impl<T> Series<T> {
    fn new(topic: &'static str, what: &'static str) -> Self {
        Self { topic, what, instance: None, samples: Vec::new(), others: 0, not_after: 0, beyond: 0, refused: 0 }
    }

    /// The message is one of the first instance.
    fn admits(&mut self, message: &DataMessage) -> bool {
        let found = message.multi_id.value();
        match self.instance {
            Some(instance) if found == instance => true,
            Some(instance) if found > instance => {
                self.others += 1;
                false
            }
            _ => {
                // An earlier one has come later.
                self.others += self.samples.len() as u64;
                *self = Self { instance: Some(found), others: self.others, ..Self::new(self.topic, self.what) };
                true
            }
        }
    }

    /// Takes a sample; `None` is one that says nothing. `order` is that of the time.
    fn push(&mut self, sample: Option<T>, time: impl Fn(&T) -> i64) {
        let Some(sample) = sample else {
            self.refused += 1;
            return;
        };
        match self.samples.last() {
            Some(last) if time(&sample) <= time(last) => self.not_after += 1,
            _ if self.samples.len() >= SAMPLES_MAX => self.beyond += 1,
            _ => self.samples.push(sample),
        }
    }

    fn notes(&self, refusal: &'static str, notes: &mut Vec<Note>) {
        let Self { topic, what, .. } = *self;
        if let (1.., Some(read)) = (self.others, self.instance) {
            notes.push(Note::OtherInstances { topic, read, others: self.others });
        }
        for (count, why) in [
            (self.refused, refusal),
            (self.not_after, "they are not later than the one before them"),
            (self.beyond, "there are more than are kept; cut the log"),
        ] {
            if count > 0 {
                notes.push(Note::LeftOut { what, count, why });
            }
        }
    }
}

impl Log {
    pub(crate) fn open(path: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| opening(path, cause))?;
        Ok(Self { path: path.to_owned(), length_bytes: found.len(), topics: Topics::default() })
    }

    /// Reads everything but the rows. `progress` is told the bytes that have been read.
    fn topics(&self, progress: &mut dyn FnMut(u64)) -> Result<Topics, ImportError> {
        let path = &self.path;
        let mut combined = Series::<()>::new(COMBINED, "samples of sensor_combined");
        let mut combined_count = 0;
        let mut own_fields = Series::new(COMBINED, "samples of the field");
        let mut fields = Series::new(MAGNETOMETER, "samples of the field");
        let mut attitudes = Series::new(ATTITUDE, "reference attitudes");
        let mut blended = Series::new(RECEIVER, "fixes");
        let mut raw = Series::new(RECEIVER_RAW, "fixes");
        let (mut of_combined, mut of_magnetometer, mut of_attitude) = (None, None, None);
        let (mut of_blended, mut of_raw) = (None, None);
        let ending = messages::read(path, &TOPICS, progress, &mut |message| {
            match message.flattened_format.message_name() {
                COMBINED if combined.admits(message) => {
                    combined_count += 1;
                    let layout = layout(&mut of_combined, || Combined::of(path, message))?;
                    if own_fields.admits(message)
                        && let Some(field) = layout.field(message.data)
                        // The last one again: none is new.
                        && own_fields.samples.last().is_none_or(|last: &Field| last.t_ns != field.t_ns)
                    {
                        own_fields.push(Some(field).filter(Field::is_finite), |field| field.t_ns);
                    }
                }
                MAGNETOMETER if fields.admits(message) => {
                    let layout = layout(&mut of_magnetometer, || Magnetometer::of(path, message))?;
                    fields.push(layout.field(message.data).filter(Field::is_finite), |field| field.t_ns);
                }
                ATTITUDE if attitudes.admits(message) => {
                    let layout = layout(&mut of_attitude, || AttitudeFields::of(path, message))?;
                    attitudes.push(layout.attitude(message.data), |attitude| attitude.t_ns);
                }
                RECEIVER if blended.admits(message) => {
                    let layout = layout(&mut of_blended, || Receiver::of(path, message))?;
                    blended.push(layout.fix(message.data), |fix| fix.t_ns);
                }
                RECEIVER_RAW if raw.admits(message) => {
                    let layout = layout(&mut of_raw, || Receiver::of(path, message))?;
                    raw.push(layout.fix(message.data), |fix| fix.t_ns);
                }
                _ => {}
            }
            Ok(())
        })?;

        let fields = if own_fields.samples.is_empty() { fields } else { own_fields };
        let fixes = if blended.samples.is_empty() { raw } else { blended };
        let mut notes = Vec::new();
        combined.notes("", &mut notes);
        fields.notes("a component is no number", &mut notes);
        attitudes.notes("the quaternion is no rotation", &mut notes);
        fixes.notes("the receiver calls its velocity invalid, or has no position", &mut notes);
        Ok(Topics {
            combined: combined_count,
            combined_instance: combined.instance.unwrap_or(0),
            fields: fields.samples,
            attitudes: attitudes.samples,
            fixes: fixes.samples,
            ending,
            notes,
        })
    }
}

impl Source for Log {
    fn format(&self) -> Format {
        Format::Ulog
    }

    fn total_bytes(&self) -> u64 {
        2 * self.length_bytes
    }

    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        self.topics = self.topics(tell)?;
        let Topics { combined, fields, attitudes, fixes, ending, .. } = &self.topics;
        fixes.iter().try_for_each(take)?;
        let damage = ending.damage.as_ref().map(|(at_byte, found)| format!("byte {at_byte}: {found}"));
        let expected = if *combined == 0 {
            "the topic sensor_combined"
        } else {
            "gyro_rad and accelerometer_m_s2 in sensor_combined"
        };
        Ok(Survey {
            has_field: !fields.is_empty(),
            has_reference: !attitudes.is_empty(),
            notes: self.topics.notes(self.length_bytes),
            reason: damage.filter(|_| *combined == 0),
            expected: expected.into(),
        })
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        Ok(Box::new(self.topics.fields.iter().map(|field| Ok(field.sample()))))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        Ok(Box::new(self.topics.attitudes.iter().map(|turned| Ok(turned.attitude()))))
    }

    fn rows(&self, rows: &mut Rows, tell: &mut dyn FnMut(u64)) -> Result<Aligned, ImportError> {
        let mut aligned = Aligned::default();
        let mut of_combined = None;
        let mut tell = |bytes: u64| tell(self.length_bytes + bytes);
        messages::read(&self.path, &[COMBINED], &mut tell, &mut |message| {
            if message.multi_id.value() != self.topics.combined_instance {
                return Ok(());
            }
            let layout = layout(&mut of_combined, || Combined::of(&self.path, message))?;
            if let Some(force) = layout.force(message.data) {
                aligned.force(force, rows)?;
            }
            match layout.rate(message.data) {
                Some(rate) => aligned.rate(rate, rows),
                None => Ok(()),
            }
        })?;
        aligned.finish(rows)?;
        Ok(aligned)
    }
}

impl Topics {
    fn notes(&self, length_bytes: u64) -> Vec<Note> {
        let Ending { damage, dropouts, dropouts_ms } = &self.ending;
        let mut notes = Vec::new();
        if let Some((at_byte, found)) = damage.clone() {
            notes.push(Note::Damage { at_byte, length_bytes, found });
        }
        notes.extend_from_slice(&self.notes);
        for (is_empty, what) in [
            (self.attitudes.is_empty(), "reference attitude (vehicle_attitude)"),
            (self.fixes.is_empty(), "velocity of a receiver (vehicle_gps_position, sensor_gps)"),
        ] {
            if is_empty {
                notes.push(Note::Missing { what });
            }
        }
        if *dropouts > 0 {
            notes.push(Note::Dropouts { count: *dropouts, total_ms: *dropouts_ms });
        }
        notes
    }
}

/// Where the fields of a topic are: found out at its first message.
fn layout<T>(known: &mut Option<T>, of: impl FnOnce() -> Result<T, ImportError>) -> Result<&T, ImportError> {
    Ok(match known {
        Some(known) => known,
        None => known.insert(of()?),
    })
}

impl Field {
    pub(crate) fn sample(&self) -> Sample {
        (self.t_ns, self.field_ut())
    }

    fn is_finite(&self) -> bool {
        self.field_ga.iter().all(|part| part.is_finite())
    }

    /// In our axes.
    fn field_ut(&self) -> [f64; 3] {
        const UT_PER_GA: f64 = 100.0;
        Body::Frd.ours(self.field_ga.map(|part| f64::from(part) * UT_PER_GA))
    }
}
