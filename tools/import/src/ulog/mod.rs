//! The topics of a ULog.
//!
//! Input: a log of PX4. Output: the rows of `sensor_combined`, with what the other topics say. Time: the log's own, from microseconds; the
//! rate's is `timestamp`, the force's is that plus `accelerometer_timestamp_relative`. Memory: nothing is kept that grows with the log; it is
//! read once for what is there, and once for the rows and each of field, attitude and receiver. Failure: a log that says nothing; of a
//! damaged one, what was good before is read.

mod fields;
mod messages;
mod series;

use attitude::frames::Body;
use std::{
    fs, iter,
    path::{Path, PathBuf},
};

use crate::{
    Format, ImportError, Note,
    force_aligner::{ForceAligner, Sample},
    error::opening,
    row_writer::{Attitude, RowWriter, Samples},
    source::{Source, Survey, TakeFix},
};
use fields::{AttitudeFields, Combined, Field, Magnetometer, Receiver};
use messages::Ending;
use series::{Series, streamed};

const COMBINED: &str = "sensor_combined";
const MAGNETOMETER: &str = "vehicle_magnetometer";
const ATTITUDE: &str = "vehicle_attitude";
const RECEIVER: &str = "vehicle_gps_position";
/// Of one receiver; the former is made of all of them.
const RECEIVER_RAW: &str = "sensor_gps";
const TOPICS: [&str; 5] = [COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER, RECEIVER_RAW];

pub(crate) struct Log {
    path: PathBuf,
    length_bytes: u64,
    /// `None` before the first reading.
    topics: Option<Topics>,
}

/// What the first reading finds: which instance of which topic is read, and what is left out.
struct Topics {
    combined: Series,
    /// Of the magnetometer, or of an old log's `sensor_combined`.
    fields: Series,
    attitudes: Series,
    fixes: Series,
    ending: Ending,
}

impl Log {
    pub(crate) fn open(path: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| opening(path, cause))?;
        Ok(Self { path: path.to_owned(), length_bytes: found.len(), topics: None })
    }

    /// The first reading. `progress` is told the bytes that have been read.
    fn topics(&self, progress: &mut dyn FnMut(u64)) -> Result<Topics, ImportError> {
        let path = &self.path;
        let mut combined = Series::new(COMBINED, "samples of sensor_combined");
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
                    let layout = layout(&mut of_combined, || Combined::of(path, message))?;
                    if own_fields.admits(message) {
                        own_field(&mut own_fields, layout, message.data);
                    }
                }
                MAGNETOMETER if fields.admits(message) => {
                    let layout = layout(&mut of_magnetometer, || Magnetometer::of(path, message))?;
                    field(&mut fields, layout.field(message.data));
                }
                ATTITUDE if attitudes.admits(message) => {
                    let layout = layout(&mut of_attitude, || AttitudeFields::of(path, message))?;
                    attitudes.take(layout.attitude(message.data), |attitude| attitude.t_ns);
                }
                RECEIVER if blended.admits(message) => {
                    let layout = layout(&mut of_blended, || Receiver::of(path, message))?;
                    blended.take(layout.fix(message.data), |fix| fix.t_ns);
                }
                RECEIVER_RAW if raw.admits(message) => {
                    let layout = layout(&mut of_raw, || Receiver::of(path, message))?;
                    raw.take(layout.fix(message.data), |fix| fix.t_ns);
                }
                _ => {}
            }
            Ok(())
        })?;
        let fields = if own_fields.taken == 0 { fields } else { own_fields };
        let fixes = if blended.taken == 0 { raw } else { blended };
        Ok(Topics { combined, fields, attitudes, fixes, ending })
    }

    /// Reads the fixes of the receiver that was chosen.
    fn fixes(&self, fixes: &Series, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<(), ImportError> {
        let (mut series, mut of_receiver) = (fixes.again(), None);
        messages::read(&self.path, &[fixes.topic], tell, &mut |message| {
            if !series.admits(message) {
                return Ok(());
            }
            let layout = layout(&mut of_receiver, || Receiver::of(&self.path, message))?;
            series.take(layout.fix(message.data), |fix| fix.t_ns).map_or(Ok(()), |fix| take(&fix))
        })?;
        Ok(())
    }

    /// How often the log is read before the rows.
    fn readings_before_rows(&self) -> u64 {
        1 + u64::from(self.topics.as_ref().is_none_or(|topics| topics.fixes.taken > 0))
    }
}

impl Source for Log {
    fn format(&self) -> Format {
        Format::Ulog
    }

    fn total_bytes(&self) -> u64 {
        (self.readings_before_rows() + 1) * self.length_bytes
    }

    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let topics = self.topics(tell)?;
        if topics.fixes.taken > 0 {
            self.fixes(&topics.fixes, take, &mut |bytes| tell(self.length_bytes + bytes))?;
        }
        let Topics { combined, fields, attitudes, ending, .. } = &topics;
        let damage = ending.damage.as_ref().map(|(at_byte, found)| format!("byte {at_byte}: {found}"));
        let expected = if combined.messages == 0 {
            "the topic sensor_combined"
        } else {
            "gyro_rad and accelerometer_m_s2 in sensor_combined"
        };
        let survey = Survey {
            has_field: fields.taken > 0,
            has_reference: attitudes.taken > 0,
            notes: topics.notes(self.length_bytes),
            reason: damage.filter(|_| combined.messages == 0),
            expected: expected.into(),
        };
        self.topics = Some(topics);
        Ok(survey)
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(fields) = self.topics.as_ref().map(|topics| &topics.fields).filter(|fields| fields.taken > 0) else {
            return Ok(Box::new(iter::empty()));
        };
        let (path, mut series) = (self.path.clone(), fields.again());
        let (mut of_combined, mut of_magnetometer) = (None, None);
        Ok(streamed(path.clone(), fields.topic, move |message| {
            if !series.admits(message) {
                return Ok(None);
            }
            let taken = if series.topic == COMBINED {
                let layout = layout(&mut of_combined, || Combined::of(&path, message))?;
                own_field(&mut series, layout, message.data)
            } else {
                let layout = layout(&mut of_magnetometer, || Magnetometer::of(&path, message))?;
                field(&mut series, layout.field(message.data))
            };
            Ok(taken.map(|field| field.sample()))
        }))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some(topics) = self.topics.as_ref().filter(|topics| topics.attitudes.taken > 0) else {
            return Ok(Box::new(iter::empty()));
        };
        let (path, mut series, mut of_attitude) = (self.path.clone(), topics.attitudes.again(), None);
        Ok(streamed(path.clone(), ATTITUDE, move |message| {
            if !series.admits(message) {
                return Ok(None);
            }
            let layout = layout(&mut of_attitude, || AttitudeFields::of(&path, message))?;
            let turned = series.take(layout.attitude(message.data), |attitude| attitude.t_ns);
            Ok(turned.map(|turned| turned.attitude()))
        }))
    }

    fn rows(&self, rows: &mut RowWriter, tell: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let mut aligned = ForceAligner::default();
        let Some(topics) = &self.topics else { return Ok(aligned) };
        let (mut combined, mut of_combined) = (topics.combined.again(), None);
        let before_bytes = self.readings_before_rows() * self.length_bytes;
        messages::read(&self.path, &[COMBINED], &mut |bytes| tell(before_bytes + bytes), &mut |message| {
            if !combined.admits(message) {
                return Ok(());
            }
            let layout = layout(&mut of_combined, || Combined::of(&self.path, message))?;
            if let Some(force) = layout.force(message.data) {
                aligned.push_force(force, rows)?;
            }
            match layout.rate(message.data) {
                Some(rate) => aligned.push_rate(rate, rows),
                None => Ok(()),
            }
        })?;
        aligned.finish(rows)?;
        Ok(aligned)
    }
}

impl Topics {
    fn notes(&self, length_bytes: u64) -> Vec<Note> {
        let Self { combined, fields, attitudes, fixes, ending } = self;
        let Ending { damage, dropouts, dropouts_ms } = ending;
        let mut notes = Vec::new();
        if let Some((at_byte, found)) = damage.clone() {
            notes.push(Note::Damage { at_byte, length_bytes, found });
        }
        combined.notes("", &mut notes);
        fields.notes("a component is no number", &mut notes);
        attitudes.notes("the quaternion is no rotation", &mut notes);
        fixes.notes("the receiver calls its velocity invalid, or has no position", &mut notes);
        for (series, what) in [
            (attitudes, "reference attitude (vehicle_attitude)"),
            (fixes, "velocity of a receiver (vehicle_gps_position, sensor_gps)"),
        ] {
            if series.taken == 0 {
                notes.push(Note::Missing { what });
            }
        }
        if *dropouts > 0 {
            notes.push(Note::Dropouts { count: *dropouts, total_ms: *dropouts_ms });
        }
        notes
    }
}

/// The field where it is a new one of numbers.
fn field(series: &mut Series, field: Option<Field>) -> Option<Field> {
    series.take(field.filter(Field::is_finite), |field| field.t_ns)
}

/// The same of an old log's `sensor_combined`, which has the last one again where none is new.
fn own_field(series: &mut Series, layout: &Combined, data: &[u8]) -> Option<Field> {
    let new = layout.field(data).filter(|field| series.last_ns != Some(field.t_ns))?;
    field(series, Some(new))
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
        Body::Frd.to_native(self.field_ga.map(|part| f64::from(part) * UT_PER_GA))
    }
}
