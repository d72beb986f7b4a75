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
mod sqlite;
mod topics;

use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
    rc::Rc,
    vec,
};

use foreign::ForeignText;

use crate::{
    Format, ImportError, Note,
    error::open_error,
    force_aligner::ForceAligner,
    row_writer::Sample,
    row_writer::{Attitude, RowWriter, Samples},
    source::{FixSink, ReceiverFix, Source, Survey},
};
use message::{InertialSample, Message, Position, ReadError, VelocityFix};
use topics::{Kind, Role, Topic, Topics};

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
    requested_topics: &'a [String],
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// Topics selected by the survey; `None` until the survey has finished.
    selection: Option<Selection>,
}

#[derive(Default)]
struct Selection {
    rows: Option<Topic>,
    field: Option<Topic>,
    /// Topics from which the reference is computed.
    reference: Vec<Topic>,
}

impl<'a> Bag<'a> {
    /// Opens a bag or a single file. `requested_topics` take precedence over other topics.
    pub(crate) fn open(path: &Path, format: Format, requested_topics: &'a [String]) -> Result<Self, ImportError> {
        let files = if format == Format::Bag { bag_files(path)? } else { vec![(path.to_owned(), format)] };
        let length = |(path, _): &(PathBuf, Format)| {
            fs::metadata(path).map(|found| found.len()).map_err(|cause| open_error(path, cause))
        };
        let length_bytes = files.iter().map(length).sum::<Result<_, _>>()?;
        let (path, read_bytes) = (path.to_owned(), Rc::default());
        Ok(Self { path, format, files, requested_topics, length_bytes, read_bytes, selection: None })
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
        let series = self
            .selection
            .as_ref()
            .map_or(2, |selection| u64::from(selection.field.is_some()) + u64::from(!selection.reference.is_empty()));
        (2 + series) * self.length_bytes
    }

    fn survey(&mut self, on_fix: &mut FixSink<'_>, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut topics = Topics::new(self.requested_topics);
        let mut messages = self.read_messages(None);
        let mut fixes = FixCollector::default();
        let mut has_instant_rates = false;
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            let Some(Message { topic, data }) = messages.next()? else { break };
            let inertial = match topic.kind {
                Kind::Imu => ros::inertial(&data),
                Kind::PlumblineImu => plumbline::inertial(&data).map(|(_, inertial)| inertial),
                _ => None,
            };
            has_instant_rates |= inertial.as_ref().is_some_and(|inertial| inertial.is_instant);
            let is_valid = match topic.kind {
                Kind::Imu | Kind::PlumblineImu => inertial.is_some(),
                Kind::MagneticField => ros::field(&data).is_some(),
                Kind::PlumblineMag => plumbline::field(&data).is_some(),
                Kind::PlumblineReference => plumbline::reference(&data).is_some(),
                Kind::Twist => fixes.push(&topic, ros::velocity(&data), topics.is_requested(&topic), on_fix)?,
                Kind::PlumblineFix => fixes.push(&topic, plumbline::fix(&data), true, on_fix)?,
                Kind::NavSatFix => fixes.push_position(&topic, ros::position(&data)),
            };
            let Some(counts) = topics.counts_mut(&topic) else { continue };
            counts.samples += u64::from(is_valid);
            counts.rejected += u64::from(!is_valid);
            counts.attitudes += u64::from(inertial.is_some_and(|inertial| inertial.attitude.is_some()));
        }
        progress(self.read_bytes.get());
        topics.check_requested(&self.path)?;

        let mut notes = messages.notes;
        if has_instant_rates {
            notes.push(Note::InstantRates);
        }
        let rows = topics.select(Role::Rows, &mut notes).cloned();
        let field = topics.select(Role::Field, &mut notes).cloned();
        topics.select(Role::Velocity, &mut notes);
        if fixes.out_of_order > 0 {
            let reason = "timestamps do not increase";
            notes.push(Note::Skipped { what: "fixes", count: fixes.out_of_order, reason });
        }
        let reference = match &rows {
            Some(rows) if rows.kind == Kind::PlumblineImu => {
                topics.select(Role::Reference, &mut notes).map(|reference| vec![rows.clone(), reference.clone()])
            }
            Some(rows) if topics.has_attitudes(rows) => Some(vec![rows.clone()]),
            _ => None,
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
        let selection = Selection { rows, field, reference: reference.unwrap_or_default() };
        let (has_field, has_reference) = (selection.field.is_some(), !selection.reference.is_empty());
        self.selection = Some(selection);
        Ok(Survey { has_field, has_reference, notes, reason, expected })
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(topic) = self.selection.as_ref().and_then(|selection| selection.field.clone()) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let is_plumbline = topic.kind == Kind::PlumblineMag;
        let decode = move |data: &[u8]| if is_plumbline { plumbline::field(data) } else { ros::field(data) };
        let messages = self.read_messages(Some(vec![topic]));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decode(&message.data)).transpose())))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let topics = self.selection.as_ref().map_or_else(Vec::new, |selection| selection.reference.clone());
        let mut join = plumbline::ReferenceJoin::default();
        let mut decode = move |Message { topic, data }: &Message| match topic.kind {
            Kind::PlumblineImu => {
                plumbline::inertial(data).and_then(|(tick, sample)| join.push_sample(tick, sample.t_ns))
            }
            Kind::PlumblineReference => plumbline::reference(data).and_then(|reference| join.push_reference(reference)),
            _ => ros::inertial(data)?.attitude,
        };
        if topics.is_empty() {
            return Ok(Box::new(std::iter::empty()));
        }
        let messages = self.read_messages(Some(topics));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decode(&message)).transpose())))
    }

    fn write_rows(&self, rows: &mut RowWriter, progress: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let mut aligner = ForceAligner::default();
        let Some(topic) = self.selection.as_ref().and_then(|selection| selection.rows.clone()) else {
            return Ok(aligner);
        };
        let is_plumbline = topic.kind == Kind::PlumblineImu;
        let mut messages = self.read_messages(Some(vec![topic]));
        for index in 0u64.. {
            if index.is_multiple_of(PROGRESS_INTERVAL_MESSAGES) {
                progress(self.read_bytes.get());
            }
            let Some(Message { data, .. }) = messages.next()? else { break };
            let inertial = if is_plumbline {
                plumbline::inertial(&data).map(|(_, inertial)| inertial)
            } else {
                ros::inertial(&data)
            };
            if let Some(InertialSample { t_ns, rate_rad_s, force_m_s2, .. }) = inertial {
                aligner.push_force((t_ns, force_m_s2), rows)?;
                aligner.push_rate((t_ns, rate_rad_s), rows)?;
            }
        }
        aligner.finish(rows)?;
        Ok(aligner)
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
            "uncompressed files; unpack them with zstd -d"
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
    /// Losses of the databases read so far.
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

    /// Adds a note for each kind of loss, and resets the counts.
    fn note_losses(&mut self) {
        let sqlite::Losses { missing, stray, without_topic, without_data } = std::mem::take(&mut self.losses);
        for (what, count, reason) in [
            ("message chunks", std::mem::take(&mut self.damaged_chunks), DAMAGED_CHUNK),
            ("messages", missing, "missing from the numbered rows of the database"),
            ("messages", stray, "their row numbers do not increase, or exceed the last"),
            ("messages", without_topic, "their topic is not in the database"),
            ("messages of the topics read", without_data, "no bytes, or more than 64 KiB"),
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

/// Collects the fixes of one topic. A fix that has no position gets the newest position received
/// before it.
#[derive(Default)]
struct FixCollector {
    topic: Option<Rc<Topic>>,
    position_topic: Option<Rc<Topic>>,
    position: Option<Position>,
    last_ns: Option<i64>,
    out_of_order: u64,
}

impl FixCollector {
    /// Passes the fix to `on_fix` if it belongs to the first topic that has fixes and its timestamp
    /// increases.
    ///
    /// Returns `true` if `fix` is `Some`, even if it is not passed on.
    fn push(
        &mut self,
        topic: &Rc<Topic>,
        fix: Option<VelocityFix>,
        is_read: bool,
        on_fix: &mut FixSink<'_>,
    ) -> Result<bool, ImportError> {
        let Some(fix) = fix else { return Ok(false) };
        if !is_read || *self.topic.get_or_insert_with(|| topic.clone()) != *topic {
            return Ok(true);
        }
        if self.last_ns.is_some_and(|last_ns| fix.t_ns <= last_ns) {
            self.out_of_order += 1;
            return Ok(true);
        }
        self.last_ns = Some(fix.t_ns);
        let unknown = Position { latitude_deg: f64::NAN, longitude_deg: f64::NAN, altitude_m: f64::NAN };
        let Position { latitude_deg, longitude_deg, altitude_m } = fix.position.or(self.position).unwrap_or(unknown);
        on_fix(&ReceiverFix {
            t_ns: fix.t_ns,
            velocity_m_s: fix.velocity_m_s,
            latitude_deg,
            longitude_deg,
            altitude_m,
        })?;
        Ok(true)
    }

    /// Stores the position if it belongs to the first topic that has positions.
    ///
    /// Returns `true` if `position` is `Some`.
    fn push_position(&mut self, topic: &Rc<Topic>, position: Option<Position>) -> bool {
        let is_some = position.is_some();
        if is_some && *self.position_topic.get_or_insert_with(|| topic.clone()) == *topic {
            self.position = position;
        }
        is_some
    }
}
