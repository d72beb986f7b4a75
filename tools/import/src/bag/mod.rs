//! Source that reads MCAP files and ROS 2 bags with Plumbline or ROS 2 messages.
//!
//! Input: a file, or the folder of a bag.
//!
//! Output: the rows of one IMU topic, with magnetic field, reference and fixes from other topics.
//!
//! Time: the timestamps in the messages.
//!
//! Memory: one chunk of the file for each topic being read. The files are read once for the survey,
//! once for the rows, once for the magnetic field and once for the reference.
//!
//! Failure: a bag that contains no usable messages is an error. If a bag is damaged, its readable
//! part is imported.

mod compressed;
mod mcap;
mod message;
mod plumbline;
pub(crate) mod ros;
mod samples;
mod sqlite;
mod sqlite_pages;
mod topics;

use std::{
    cell::Cell,
    fs, iter,
    path::{Path, PathBuf},
    rc::Rc,
    vec,
};

use foreign::ForeignText;

use crate::{
    Format, ImportError, Note, Options,
    error::open_error,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
    timeline::SegmentFinder,
};
use message::{Message, ReadError};
use ros::Convention;
use samples::{InertialSample, Position, VelocityFix};
use topics::{Kind, MotionTopics, Role, Topic, Topics};

/// Number of messages between two progress reports.
const PROGRESS_INTERVAL_MESSAGES: u64 = 1024;
/// Reason for skipping a chunk of an MCAP file.
const DAMAGED_CHUNK: &str = "damaged, or too large when decompressed";
/// Maximum number of directory entries that are inspected in a bag.
const MAX_FILES: usize = 10_000;

/// Files of a bag and the topics selected from them.
pub(crate) struct Bag<'a> {
    path: PathBuf,
    format: Format,
    files: Vec<(PathBuf, Format)>,
    options: &'a Options,
    convention: Convention,
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// Topics selected by the survey; `None` until the survey has finished.
    selection: Option<Selection>,
}

#[derive(Default)]
struct Selection {
    rows: Option<MotionTopics>,
    field: Option<Topic>,
    /// Topics from which the reference is computed.
    reference: Vec<Topic>,
    /// Topics from which the GNSS fixes are computed.
    fixes: Vec<Topic>,
    /// `true` if the times at which messages were logged replace their timestamps.
    uses_log_times: bool,
}

impl<'a> Bag<'a> {
    /// Opens a bag or a single file. Requested topics take precedence over other topics.
    pub(crate) fn open(path: &Path, format: Format, options: &'a Options) -> Result<Self, ImportError> {
        let files = if format == Format::Bag { bag_files(path)? } else { vec![(path.to_owned(), format)] };
        let length = |(path, _): &(PathBuf, Format)| {
            fs::metadata(path).map(|found| found.len()).map_err(|cause| open_error(path, cause))
        };
        let length_bytes = files.iter().map(length).sum::<Result<_, _>>()?;
        let (path, read_bytes) = (path.to_owned(), Rc::default());
        let convention = options.mapping.as_ref().map_or_else(Convention::default, Convention::new);
        Ok(Self { path, format, files, options, convention, length_bytes, read_bytes, selection: None })
    }

    /// Returns a reader for the messages of the `wanted` topics, or of all readable topics if
    /// `wanted` is `None`.
    fn read_messages(&self, wanted: Option<Vec<Topic>>) -> MessageReader {
        let (files, read_bytes) = (self.files.clone().into_iter(), self.read_bytes.clone());
        let (losses, notes) = (sqlite::Losses::default(), Vec::new());
        MessageReader { files, current: None, wanted, read_bytes, damaged_chunks: 0, losses, notes }
    }
}

impl Source for Bag<'_> {
    fn format(&self) -> Format {
        self.format
    }

    fn total_bytes(&self) -> u64 {
        let series = self.selection.as_ref().map_or(3, |selection| {
            let Selection { rows, field, reference, fixes, .. } = selection;
            let is_joined = rows.as_ref().is_some_and(|rows| rows.force.is_some());
            let read = [field.is_some(), !reference.is_empty(), !fixes.is_empty(), is_joined];
            read.into_iter().filter(|is_read| *is_read).count()
        });
        (2 + series as u64) * self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.read_bytes.get()
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut topics = Topics::new(&self.options.topics);
        let mut messages = self.read_messages(None);
        let mut has_instant_rates = false;
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            let Some(Message { topic, log_ns, data }) = messages.next()? else { break };
            let inertial = self.inertial(&topic, &data);
            has_instant_rates |= inertial.as_ref().is_some_and(|inertial| inertial.is_instant);
            // Time in ns with the magnetic field of a magnetometer or the velocity of a receiver.
            let sample = match topic.kind {
                Kind::Imu | Kind::PlumblineImu => inertial.as_ref().map(|inertial| (inertial.t_ns, None)),
                Kind::MagneticField => {
                    ros::field(&data, &self.convention).map(|(t_ns, field_ut)| (t_ns, Some(field_ut)))
                }
                Kind::PlumblineMag => plumbline::field(&data).map(|(t_ns, field_ut)| (t_ns, Some(field_ut))),
                Kind::Twist => ros::velocity(&data).map(|fix| (fix.t_ns, Some(fix.velocity_m_s))),
                Kind::PlumblineFix => plumbline::fix(&data).map(|fix| (fix.t_ns, Some(fix.velocity_m_s))),
                Kind::Pose | Kind::ChildPose => {
                    ros::attitude(topic.kind, &data, &self.convention).map(|attitude| (attitude.t_ns, None))
                }
                Kind::PlumblineReference => plumbline::reference(&data).map(|attitude| (attitude.t_ns, None)),
                // The times of these messages are not used.
                Kind::NavSatFix => None,
            };
            let is_valid = match topic.kind {
                Kind::NavSatFix => ros::position(&data).is_some(),
                _ => sample.is_some(),
            };
            let Some(counts) = topics.counts_mut(&topic) else { continue };
            counts.samples += u64::from(is_valid);
            counts.rejected += u64::from(!is_valid);
            if let Some((t_ns, vector)) = sample {
                counts.push_stamp(t_ns);
                if vector.is_some() {
                    counts.state.push(log_ns, [vector, None], true);
                }
            }
            if let Some(inertial) = &inertial {
                counts.push_inertial(inertial, log_ns);
            }
        }
        progress(self.read_bytes.get());
        topics.check_requested(&self.path)?;

        let mut notes = messages.notes;
        if has_instant_rates {
            notes.push(Note::InstantRates);
        }
        let rows = topics.select_motion(&self.path, self.options.imu, &mut notes)?;
        let field = topics.select_numbered(&self.path, Role::Field, self.options.mag, &mut notes)?;
        let velocity = topics.select_numbered(&self.path, Role::Velocity, self.options.gnss, &mut notes)?;
        let position = topics.select(Role::Position, &mut Vec::new()).cloned();
        let reference = match &rows {
            Some(MotionTopics { rate, .. }) if rate.kind == Kind::PlumblineImu => {
                topics.select(Role::Reference, &mut notes).map(|reference| vec![reference.clone()])
            }
            Some(MotionTopics { rate, .. }) => {
                let has_attitudes = topics.has_attitudes(rate);
                // Poses could be read as the reference. A note on this is needed only if there is
                // no other reference.
                let unused = &mut Vec::new();
                let poses = topics.select(Role::Reference, if has_attitudes { unused } else { &mut notes });
                poses.cloned().or_else(|| has_attitudes.then(|| rate.clone())).map(|reference| vec![reference])
            }
            None => None,
        };
        if reference.is_none() {
            notes.push(Note::Missing { what: "reference attitude" });
        }
        let expected = match &topics.names()[..] {
            [] => "sensor_msgs/msg/Imu (CDR) or plumbline.v1.ImuSample (protobuf); no topic has a known type".into(),
            names => format!(
                "sensor_msgs/msg/Imu or plumbline.v1.ImuSample; readable topics: {}",
                foreign::list(names.iter().copied())
            )
            .into(),
        };
        let reason =
            notes.iter().find(|note| matches!(note, Note::DamagedFile { .. })).map(|note| note.to_string().into());
        let counts = rows.as_ref().and_then(|rows| topics.counts(&rows.rate));
        let read = rows.iter().flat_map(|rows| iter::once(&rows.rate).chain(&rows.force));
        let read = read.chain(&field).chain(&velocity).chain(reference.iter().flatten());
        let has_constant_stamps =
            |topic: &&Topic| topics.counts(topic).is_some_and(topics::MessageCounts::has_constant_stamps);
        let constant = read.into_iter().find(has_constant_stamps);
        // If one topic has no usable timestamps, all topics use the clock of the log.
        let uses_log_times = constant.is_some();
        if let Some(topic) = constant {
            notes.insert(0, Note::LogTimes { topic: topic.name.clone() });
        }
        let finder = counts.map(|counts| &counts.segments[usize::from(uses_log_times)]);
        let segments = finder.map_or_else(Vec::new, |finder| finder.segments().to_vec());
        let wraps = finder.map_or(0, |finder| finder.wraps);
        let clock = finder.map(SegmentFinder::clock).unwrap_or_default();
        let mut sensors = topics.sensors(rows.as_ref().map(|rows| &rows.rate), uses_log_times);
        sensors.extend(topics.other_sensors("--mag", Role::Field, field.as_ref()));
        sensors.extend(topics.other_sensors("--gnss", Role::Velocity, velocity.as_ref()));
        let fixes = velocity.map_or_else(Vec::new, |velocity| iter::once(velocity).chain(position).collect());
        let selection = Selection { rows, field, reference: reference.unwrap_or_default(), fixes, uses_log_times };
        let survey = Survey {
            has_field: selection.field.is_some(),
            has_reference: !selection.reference.is_empty(),
            has_fixes: !selection.fixes.is_empty(),
            notes,
            sensors,
            reason,
            expected,
            clock,
            segments,
            wraps,
            ..Survey::default()
        };
        self.selection = Some(selection);
        Ok(survey)
    }

    fn field_factor(&self) -> Option<f64> {
        let topic = self.selection.as_ref().and_then(|selection| selection.field.as_ref());
        topic.filter(|topic| topic.kind == Kind::MagneticField).map(|_| self.convention.field_factor())
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(topic) = self.selection.as_ref().and_then(|selection| selection.field.clone()) else {
            return Ok(Box::new(iter::empty()));
        };
        let (is_plumbline, convention) = (topic.kind == Kind::PlumblineMag, self.convention);
        let uses_log_times = self.uses_log_times();
        let decode = move |Message { data, log_ns, .. }: Message| {
            let sample = if is_plumbline { plumbline::field(&data) } else { ros::field(&data, &convention) };
            sample.map(|(t_ns, field_ut)| (if uses_log_times { log_ns } else { t_ns }, field_ut))
        };
        let messages = self.read_messages(Some(vec![topic]));
        Ok(Box::new(messages.filter_map(move |message| message.map(decode).transpose())))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let topics = self.selection.as_ref().map_or_else(Vec::new, |selection| selection.reference.clone());
        let (convention, uses_log_times) = (self.convention, self.uses_log_times());
        let decode = move |Message { topic, log_ns, data }: &Message| match topic.kind {
            Kind::PlumblineReference => plumbline::reference(data),
            kind => {
                let attitude = match kind {
                    Kind::Imu => ros::inertial(data, &convention)?.attitude?,
                    _ => ros::attitude(kind, data, &convention)?,
                };
                Some(if uses_log_times { Attitude { t_ns: *log_ns, ..attitude } } else { attitude })
            }
        };
        if topics.is_empty() {
            return Ok(Box::new(iter::empty()));
        }
        let messages = self.read_messages(Some(topics));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decode(&message)).transpose())))
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        let topics = self.selection.as_ref().map_or_else(Vec::new, |selection| selection.fixes.clone());
        if topics.is_empty() {
            return Ok(Box::new(iter::empty()));
        }
        let uses_log_times = self.uses_log_times();
        // A fix without a position gets the newest position received before the fix.
        let mut newest = None;
        let mut decode = move |Message { topic, log_ns, data }: &Message| {
            let VelocityFix { t_ns, velocity_m_s, position } = match topic.kind {
                Kind::NavSatFix => {
                    newest = ros::position(data);
                    return None;
                }
                Kind::PlumblineFix => plumbline::fix(data)?,
                _ => ros::velocity(data)?,
            };
            let unknown = Position { latitude_deg: f64::NAN, longitude_deg: f64::NAN, altitude_m: f64::NAN };
            let Position { latitude_deg, longitude_deg, altitude_m } = position.or(newest).unwrap_or(unknown);
            let t_ns = if uses_log_times { *log_ns } else { t_ns };
            Some(ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })
        };
        let messages = self.read_messages(Some(topics));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decode(&message)).transpose())))
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        let Some(MotionTopics { rate, force }) = self.selection.as_ref().and_then(|selection| selection.rows.clone())
        else {
            return Ok(Motion::Joint(Box::new(iter::empty())));
        };
        Ok(match force {
            None => Motion::Joint(self.inertial_samples(rate, |t_ns, sample| {
                Some(Inertial::joint(t_ns, sample.rate_rad_s?, sample.force_m_s2?))
            })),
            Some(force) => Motion::Separate {
                rates: self.inertial_samples(rate, |t_ns, sample| Some((t_ns, sample.rate_rad_s?))),
                forces: self.inertial_samples(force, |t_ns, sample| Some((t_ns, sample.force_m_s2?))),
            },
        })
    }
}

impl Bag<'_> {
    fn uses_log_times(&self) -> bool {
        self.selection.as_ref().is_some_and(|selection| selection.uses_log_times)
    }

    /// Decodes a message that contains a rate or a force.
    fn inertial(&self, topic: &Topic, data: &[u8]) -> Option<InertialSample> {
        match topic.kind {
            Kind::Imu => ros::inertial(data, &self.convention),
            Kind::PlumblineImu => plumbline::inertial(data),
            _ => None,
        }
    }

    /// Converts the samples of a topic with `convert`, which receives the time in ns and the
    /// sample.
    fn inertial_samples<T>(
        &self,
        topic: Topic,
        convert: impl Fn(i64, &InertialSample) -> Option<T> + 'static,
    ) -> Samples<'_, T> {
        let uses_log_times = self.uses_log_times();
        let messages = self.read_messages(Some(vec![topic]));
        let decode = move |Message { topic, log_ns, data }: Message| {
            let sample = self.inertial(&topic, &data)?;
            convert(if uses_log_times { log_ns } else { sample.t_ns }, &sample)
        };
        Box::new(messages.filter_map(move |message| message.map(&decode).transpose()))
    }
}

/// Returns the files of a bag, ordered by the number at the end of each file name.
fn bag_files(folder: &Path) -> Result<Vec<(PathBuf, Format)>, ImportError> {
    let failed = |cause| open_error(folder, cause);
    let mut files = Vec::new();
    let mut has_compressed = false;
    for entry in fs::read_dir(folder).map_err(failed)?.take(MAX_FILES) {
        let path = entry.map_err(failed)?.path();
        has_compressed |= path.extension().is_some_and(|end| end == "zstd");
        let is_file = fs::metadata(&path).is_ok_and(|found| found.is_file());
        if let Some(format) = is_file.then(|| Format::detect(&path).ok()).flatten()
            && matches!(format, Format::Mcap | Format::Sqlite)
        {
            files.push((path, format));
        }
    }
    if files.is_empty() {
        let found = if has_compressed { "only compressed files" } else { "no message file" };
        let expected = if has_compressed {
            "uncompressed files; unpack them with `zstd -d FOLDER/*.zstd`"
        } else {
            "a .mcap or .db3 file next to metadata.yaml; copy the complete folder"
        };
        return Err(ImportError::UnreadableBag { path: folder.into(), found: found.into(), expected });
    }
    files.sort_by_cached_key(|(path, _)| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (name, number) = stem.rsplit_once('_').unwrap_or((&stem, ""));
        (number.parse::<u64>().unwrap_or(0), name.to_owned())
    });
    Ok(files)
}

/// Reader of the messages of several files in sequence.
struct MessageReader {
    files: vec::IntoIter<(PathBuf, Format)>,
    current: Option<(PathBuf, Cursor)>,
    wanted: Option<Vec<Topic>>,
    read_bytes: Rc<Cell<u64>>,
    damaged_chunks: u64,
    /// Rows of the databases read so far that are missing or unusable.
    losses: sqlite::Losses,
    notes: Vec<Note>,
}

enum Cursor {
    Mcap(Box<mcap::Cursor>),
    Sqlite(Box<sqlite::Cursor>),
}

impl MessageReader {
    /// Returns the next message, or `None` at the end of the last file.
    ///
    /// If a file cannot be read further, a note is added and reading continues with the next file.
    fn next(&mut self) -> Result<Option<Message>, ImportError> {
        loop {
            let Some((path, cursor)) = &mut self.current else {
                let Some((path, format)) = self.files.next() else {
                    self.note_losses();
                    return Ok(None);
                };
                let (wanted, read_bytes) = (self.wanted.as_deref(), &self.read_bytes);
                let cursor = match format {
                    Format::Sqlite => sqlite::Cursor::open(&path, wanted, read_bytes).map(Box::new).map(Cursor::Sqlite),
                    _ => Ok(Cursor::Mcap(mcap::Cursor::open(&path, wanted, read_bytes)?.into())),
                };
                match cursor {
                    Ok(cursor) => self.current = Some((path, cursor)),
                    Err(ReadError::Fatal(error)) => return Err(error),
                    Err(ReadError::Damage(found)) => self.note_damage(&path, found),
                }
                continue;
            };
            let next = match cursor {
                Cursor::Mcap(cursor) => cursor.next(),
                Cursor::Sqlite(cursor) => cursor.next(),
            };
            let path = path.clone();
            match next {
                Ok(Some(message)) => return Ok(Some(compressed::decompress(message))),
                Err(ReadError::Fatal(error)) => return Err(error),
                Ok(None) => {}
                Err(ReadError::Damage(found)) => self.note_damage(&path, found),
            }
            match self.current.take() {
                Some((_, Cursor::Mcap(cursor))) => self.damaged_chunks += cursor.damaged_chunks,
                Some((_, Cursor::Sqlite(cursor))) => self.losses = self.losses + cursor.losses,
                None => {}
            }
        }
    }

    fn note_damage(&mut self, path: &Path, found: ForeignText) {
        let file = foreign::path(Path::new(path.file_name().unwrap_or_default()));
        self.notes.push(Note::DamagedFile { file, found });
    }

    /// Adds a note for each kind of unreadable data, and resets the counts.
    fn note_losses(&mut self) {
        let sqlite::Losses { missing, stray, without_topic, without_data } = std::mem::take(&mut self.losses);
        for (what, count, reason) in [
            ("message chunks", std::mem::take(&mut self.damaged_chunks), DAMAGED_CHUNK),
            ("messages", missing, "missing from the numbered rows of the database"),
            ("messages", stray, "their row numbers do not increase or are beyond the last row"),
            ("messages", without_topic, "their topic is not in the database"),
            ("messages of the topics read", without_data, "they are empty or longer than 64 KiB"),
        ] {
            if count > 0 {
                self.notes.push(Note::Skipped { what, count, reason });
            }
        }
    }
}

impl Iterator for MessageReader {
    type Item = Result<Message, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        Self::next(self).transpose()
    }
}
