//! Source that reads PX4 ULog files.
//!
//! Input: a PX4 log.
//!
//! Output: the rows of `sensor_combined`, with field, reference and fixes from other topics.
//!
//! Time: the log's clock, converted from microseconds. The time of a rate sample is `timestamp`;
//! that of a force sample is `timestamp` plus `accelerometer_timestamp_relative`.
//!
//! Memory: independent of the length of the log. The log is read once for the survey, and once each
//! for the rows, field, attitude and fixes.
//!
//! Failure: a log that contains no usable samples is an error. If a log is damaged, the part before
//! the damage is imported.

mod fields;
mod messages;
mod series;

use attitude::frames::Body;
use std::{
    fs, iter,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{
    Format, ImportError, Note,
    error::open_error,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
    timeline::{SegmentFinder, SourceClock, Timed},
};
use fields::{AttitudeFields, CombinedFields, FieldSample, MagnetometerFields, ReceiverFields};
use messages::LogStatus;
use series::{Series, stream};

const COMBINED: &str = "sensor_combined";
const MAGNETOMETER: &str = "vehicle_magnetometer";
const ATTITUDE: &str = "vehicle_attitude";
const RECEIVER: &str = "vehicle_gps_position";
/// Topic of a single receiver. The topic [`RECEIVER`], in contrast, is blended from all receivers.
const RECEIVER_RAW: &str = "sensor_gps";
const TOPICS: [&str; 5] = [COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER, RECEIVER_RAW];

/// ULog, and the topics selected from it.
pub(crate) struct Log {
    path: PathBuf,
    length_bytes: u64,
    /// Number of bytes read by the pass for the rows.
    row_bytes: Arc<AtomicU64>,
    /// Topics selected by the survey; `None` until the survey has finished.
    selection: Option<Selection>,
}

/// Topics and instances selected by the survey, with counts of skipped samples.
struct Selection {
    combined: Series,
    /// Segments of the rate samples.
    segments: SegmentFinder,
    /// Field samples from the magnetometer topic, or from `sensor_combined` in an old log.
    fields: Series,
    attitudes: Series,
    fixes: Series,
    status: LogStatus,
}

impl Log {
    pub(crate) fn open(path: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(path).map_err(|cause| open_error(path, cause))?;
        Ok(Self { path: path.to_owned(), length_bytes: found.len(), row_bytes: Arc::default(), selection: None })
    }

    /// Makes the first pass. `progress` receives the bytes read so far.
    fn survey_topics(&self, progress: &mut dyn FnMut(u64)) -> Result<Selection, ImportError> {
        let path = &self.path;
        let mut combined = Series::new(COMBINED, "sensor_combined samples");
        let mut combined_field_series = Series::new(COMBINED, "field samples");
        let mut fields = Series::new(MAGNETOMETER, "field samples");
        let mut attitudes = Series::new(ATTITUDE, "reference attitudes");
        let mut blended = Series::new(RECEIVER, "fixes");
        let mut raw = Series::new(RECEIVER_RAW, "fixes");
        let mut segments = SegmentFinder::new(&SourceClock::default());
        let (mut combined_fields, mut magnetometer_fields, mut attitude_fields) = (None, None, None);
        let (mut blended_fields, mut raw_fields) = (None, None);
        let status = messages::read(path, &TOPICS, progress, &mut |message| {
            match message.flattened_format.message_name() {
                COMBINED if combined.accept_instance(message) => {
                    let layout = cached_fields(&mut combined_fields, || CombinedFields::new(path, message))?;
                    if combined.messages == 1 {
                        // A lower instance has replaced the previous one.
                        segments = SegmentFinder::new(&SourceClock::default());
                    }
                    match layout.motion(message.data) {
                        Some(motion) => segments.push(motion.t_ns()),
                        None => combined.reject(),
                    }
                    if combined_field_series.accept_instance(message) {
                        push_combined_field(&mut combined_field_series, layout, message.data);
                    }
                }
                MAGNETOMETER if fields.accept_instance(message) => {
                    let layout = cached_fields(&mut magnetometer_fields, || MagnetometerFields::new(path, message))?;
                    push_field(&mut fields, layout.field(message.data));
                }
                ATTITUDE if attitudes.accept_instance(message) => {
                    let layout = cached_fields(&mut attitude_fields, || AttitudeFields::new(path, message))?;
                    attitudes.push(layout.attitude(message.data), |attitude| attitude.t_ns);
                }
                RECEIVER if blended.accept_instance(message) => {
                    let layout = cached_fields(&mut blended_fields, || ReceiverFields::new(path, message))?;
                    blended.push(layout.fix(message.data), |fix| fix.t_ns);
                }
                RECEIVER_RAW if raw.accept_instance(message) => {
                    let layout = cached_fields(&mut raw_fields, || ReceiverFields::new(path, message))?;
                    raw.push(layout.fix(message.data), |fix| fix.t_ns);
                }
                _ => {}
            }
            Ok(())
        })?;
        let fields = if combined_field_series.accepted == 0 { fields } else { combined_field_series };
        let fixes = if blended.accepted == 0 { raw } else { blended };
        Ok(Selection { combined, segments, fields, attitudes, fixes, status })
    }
}

impl Source for Log {
    fn format(&self) -> Format {
        Format::Ulog
    }

    /// Returns the number of bytes of the survey and the pass for the rows. The other passes run
    /// alongside the latter.
    fn total_bytes(&self) -> u64 {
        2 * self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.length_bytes + self.row_bytes.load(Ordering::Relaxed)
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let selection = self.survey_topics(progress)?;
        let Selection { combined, fields, attitudes, status: ending, .. } = &selection;
        let damage = ending.damage.as_ref().map(|(at_byte, found)| format!("byte {at_byte}: {found}").into());
        let expected = if combined.messages == 0 {
            "the topic sensor_combined"
        } else {
            "gyro_rad and accelerometer_m_s2 in sensor_combined"
        };
        let survey = Survey {
            has_field: fields.accepted > 0,
            has_reference: attitudes.accepted > 0,
            has_fixes: selection.fixes.accepted > 0,
            segments: selection.segments.segments().to_vec(),
            wraps: selection.segments.wraps,
            notes: selection.notes(self.length_bytes),
            reason: damage.filter(|_| combined.messages == 0),
            expected: expected.into(),
            ..Survey::default()
        };
        self.selection = Some(selection);
        Ok(survey)
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(fields) =
            self.selection.as_ref().map(|selection| &selection.fields).filter(|fields| fields.accepted > 0)
        else {
            return Ok(Box::new(iter::empty()));
        };
        let (path, mut series) = (self.path.clone(), fields.restarted());
        let (mut combined_fields, mut magnetometer_fields) = (None, None);
        Ok(stream(path.clone(), fields.topic, Arc::default(), move |message| {
            if !series.accept_instance(message) {
                return Ok(None);
            }
            let field = if series.topic == COMBINED {
                let layout = cached_fields(&mut combined_fields, || CombinedFields::new(&path, message))?;
                push_combined_field(&mut series, layout, message.data)
            } else {
                let layout = cached_fields(&mut magnetometer_fields, || MagnetometerFields::new(&path, message))?;
                push_field(&mut series, layout.field(message.data))
            };
            Ok(field.map(|field| field.sample()))
        }))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some(selection) = self.selection.as_ref().filter(|topics| topics.attitudes.accepted > 0) else {
            return Ok(Box::new(iter::empty()));
        };
        let (path, mut series, mut attitude_fields) = (self.path.clone(), selection.attitudes.restarted(), None);
        Ok(stream(path.clone(), ATTITUDE, Arc::default(), move |message| {
            if !series.accept_instance(message) {
                return Ok(None);
            }
            let layout = cached_fields(&mut attitude_fields, || AttitudeFields::new(&path, message))?;
            let sample = series.push(layout.attitude(message.data), |attitude| attitude.t_ns);
            Ok(sample.map(|sample| sample.attitude()))
        }))
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        let Some(selection) = self.selection.as_ref().filter(|topics| topics.fixes.accepted > 0) else {
            return Ok(Box::new(iter::empty()));
        };
        let (path, mut series, mut receiver_fields) = (self.path.clone(), selection.fixes.restarted(), None);
        Ok(stream(path.clone(), selection.fixes.topic, Arc::default(), move |message| {
            if !series.accept_instance(message) {
                return Ok(None);
            }
            let layout = cached_fields(&mut receiver_fields, || ReceiverFields::new(&path, message))?;
            Ok(series.push(layout.fix(message.data), |fix| fix.t_ns))
        }))
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        let Some(selection) = &self.selection else { return Ok(Motion::Joint(Box::new(iter::empty()))) };
        let (path, mut combined, mut combined_fields) = (self.path.clone(), selection.combined.restarted(), None);
        Ok(Motion::Joint(stream(path.clone(), COMBINED, self.row_bytes.clone(), move |message| {
            if !combined.accept_instance(message) {
                return Ok(None);
            }
            Ok(cached_fields(&mut combined_fields, || CombinedFields::new(&path, message))?.motion(message.data))
        })))
    }
}

impl CombinedFields {
    /// Returns rate and force; `None` if the time of the rate is invalid.
    fn motion(&self, data: &[u8]) -> Option<Inertial> {
        Some(Inertial { rate: Some(self.rate(data)?), force: self.force(data) })
    }
}

impl Selection {
    fn notes(&self, length_bytes: u64) -> Vec<Note> {
        let Self { combined, fields, attitudes, fixes, status: ending, .. } = self;
        let LogStatus { damage, dropouts, dropouts_ms, malformed } = ending;
        let mut notes = Vec::new();
        if let Some((at_byte, found)) = damage.clone() {
            notes.push(Note::Damage { at_byte, length_bytes, found });
        }
        if *malformed > 0 {
            let reason = "damaged: unknown type or topic, or invalid content";
            notes.push(Note::Skipped { what: "messages", count: *malformed, reason });
        }
        combined.notes("the time is out of range", &mut notes);
        fields.notes("a component is not a number", &mut notes);
        attitudes.notes("the quaternion is not a rotation", &mut notes);
        fixes.notes("velocity invalid, or no 3D fix", &mut notes);
        for (series, what) in [
            (attitudes, "reference attitude (vehicle_attitude)"),
            (fixes, "receiver velocity (vehicle_gps_position, sensor_gps)"),
        ] {
            if series.accepted == 0 {
                notes.push(Note::Missing { what });
            }
        }
        if *dropouts > 0 {
            notes.push(Note::Dropouts { count: *dropouts, total_ms: *dropouts_ms });
        }
        notes
    }
}

/// Adds a field sample. Returns the sample if it is finite.
fn push_field(series: &mut Series, field: Option<FieldSample>) -> Option<FieldSample> {
    series.push(field.filter(FieldSample::is_finite), |field| field.t_ns)
}

/// Adds the field sample in a `sensor_combined` message of an old log.
///
/// Such a log repeats the last sample until there is a new one. Repetitions are ignored.
fn push_combined_field(series: &mut Series, layout: &CombinedFields, data: &[u8]) -> Option<FieldSample> {
    let new = layout.field(data).filter(|field| series.last_ns != Some(field.t_ns))?;
    push_field(series, Some(new))
}

/// Returns the field parsers of a topic, which are created from its first message.
fn cached_fields<T>(cache: &mut Option<T>, create: impl FnOnce() -> Result<T, ImportError>) -> Result<&T, ImportError> {
    Ok(match cache {
        Some(known) => known,
        None => cache.insert(create()?),
    })
}

impl FieldSample {
    pub(crate) fn sample(&self) -> Sample {
        (self.t_ns, self.field_ut())
    }

    fn is_finite(&self) -> bool {
        self.field_ga.iter().all(|part| part.is_finite())
    }

    /// Returns the field in native axes, µT.
    fn field_ut(&self) -> [f64; 3] {
        const UT_PER_GA: f64 = 100.0;
        Body::Frd.to_native(self.field_ga.map(|part| f64::from(part) * UT_PER_GA))
    }
}
