//! Messages of topics: MCAP files and bags of ROS 2, with what this system or ROS 2 writes into them.
//!
//! Input: a file, or a folder with the files of a bag. Output: the rows of one topic, with what others say. Time: that in the
//! messages. Memory: a chunk of the file for each topic that is read; the files are read once for what is there and once for each such
//! topic. Failure: a bag that says nothing; of a damaged one, what can be read is read.

mod mcap;
mod plumbline;
mod compressed;
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

use crate::{
    Format, ImportError, Note,
    force_aligner::{ForceAligner, Sample},
    error::opening,
    row_writer::{Attitude, RowWriter, Samples},
    source::{Fixed, Source, Survey, TakeFix},
};
use topics::{Kind, Role, Topic, Topics};

/// Messages between two signs of progress.
const TELL_EVERY: u64 = 1024;
/// Files of a bag.
const MAX_FILES: usize = 10_000;

/// A message of a topic that can be read.
struct Message {
    topic: Rc<Topic>,
    data: Vec<u8>,
}

/// Why there is no next message.
enum Stop {
    Failed(ImportError),
    Damage(String),
}

/// A sample of rate and force, and the attitude that came with it; in our axes.
pub(crate) struct Inertial {
    pub(crate) t_ns: i64,
    pub(crate) rate_rad_s: [f64; 3],
    pub(crate) force_m_s2: [f64; 3],
    /// The rate is said to be the value at the end of the interval, not its mean.
    is_instant: bool,
    attitude: Option<Attitude>,
}

/// A velocity, east, north, up.
struct Fix {
    t_ns: i64,
    velocity_m_s: [f64; 3],
    /// Where the same message says it.
    position: Option<Position>,
}

/// Where the receiver is.
#[derive(Clone, Copy)]
struct Position {
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: f64,
}

pub(crate) struct Bag<'a> {
    path: PathBuf,
    format: Format,
    files: Vec<(PathBuf, Format)>,
    named: &'a [String],
    length_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// What the first reading chose; `None` before it.
    choice: Option<Choice>,
}

#[derive(Default)]
struct Choice {
    rows: Option<Topic>,
    field: Option<Topic>,
    /// The topics of which the reference is made.
    reference: Vec<Topic>,
}

impl<'a> Bag<'a> {
    /// Finds the files of a bag. `named` are topics to be read before others.
    pub(crate) fn open(path: &Path, format: Format, named: &'a [String]) -> Result<Self, ImportError> {
        let files = if format == Format::Bag { files(path)? } else { vec![(path.to_owned(), format)] };
        let length = |(path, _): &(PathBuf, Format)| {
            fs::metadata(path).map(|found| found.len()).map_err(|cause| opening(path, cause))
        };
        let length_bytes = files.iter().map(length).sum::<Result<_, _>>()?;
        let (path, read_bytes) = (path.to_owned(), Rc::default());
        Ok(Self { path, format, files, named, length_bytes, read_bytes, choice: None })
    }

    /// The messages of `wanted` topics, or of all that can be read.
    fn messages(&self, wanted: Option<Vec<Topic>>) -> Messages {
        let (files, read_bytes) = (self.files.clone().into_iter(), self.read_bytes.clone());
        Messages { files, current: None, wanted, read_bytes, damaged_chunks: 0, notes: Vec::new() }
    }
}

impl Source for Bag<'_> {
    fn format(&self) -> Format {
        self.format
    }

    fn total_bytes(&self) -> u64 {
        let series = self
            .choice
            .as_ref()
            .map_or(2, |choice| u64::from(choice.field.is_some()) + u64::from(!choice.reference.is_empty()));
        (2 + series) * self.length_bytes
    }

    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut topics = Topics::new(self.named);
        let mut messages = self.messages(None);
        let mut fixes = Fixes::default();
        let mut has_instants = false;
        for index in 0u64.. {
            if index.is_multiple_of(TELL_EVERY) {
                tell(self.read_bytes.get());
            }
            let Some(Message { topic, data }) = messages.next()? else { break };
            let inertial = match topic.kind {
                Kind::Imu => ros::inertial(&data),
                Kind::OurSample => plumbline::inertial(&data).map(|(_, inertial)| inertial),
                _ => None,
            };
            has_instants |= inertial.as_ref().is_some_and(|inertial| inertial.is_instant);
            let says = match topic.kind {
                Kind::Imu | Kind::OurSample => inertial.is_some(),
                Kind::MagneticField => ros::field(&data).is_some(),
                Kind::OurField => plumbline::field(&data).is_some(),
                Kind::OurReference => plumbline::reference(&data).is_some(),
                Kind::Twist => fixes.take(&topic, ros::velocity(&data), topics.is_named(&topic), take)?,
                Kind::OurFix => fixes.take(&topic, plumbline::fix(&data), true, take)?,
                Kind::NavSatFix => fixes.locate(&topic, ros::position(&data)),
            };
            let Some(count) = topics.count(&topic) else { continue };
            count.samples += u64::from(says);
            count.refused += u64::from(!says);
            count.attitudes += u64::from(inertial.is_some_and(|inertial| inertial.attitude.is_some()));
        }
        tell(self.read_bytes.get());
        topics.check(&self.path)?;

        let mut notes = messages.notes;
        if has_instants {
            notes.push(Note::Instants);
        }
        let rows = topics.choose(Role::Rows, &mut notes).cloned();
        let field = topics.choose(Role::Field, &mut notes).cloned();
        topics.choose(Role::Velocity, &mut notes);
        if fixes.not_after > 0 {
            let why = "they are not later than the one before them";
            notes.push(Note::LeftOut { what: "fixes", count: fixes.not_after, why });
        }
        let reference = match &rows {
            Some(rows) if rows.kind == Kind::OurSample => {
                topics.choose(Role::Reference, &mut notes).map(|reference| vec![rows.clone(), reference.clone()])
            }
            Some(rows) if topics.has_attitudes(rows) => Some(vec![rows.clone()]),
            _ => None,
        };
        if reference.is_none() {
            notes.push(Note::Missing { what: "reference attitude" });
        }
        let expected = match &topics.names()[..] {
            [] => "sensor_msgs/msg/Imu (CDR) or plumbline.v1.ImuSample (protobuf); no topic is of a known type".into(),
            names => format!("sensor_msgs/msg/Imu or plumbline.v1.ImuSample; known topics are {}", names.join(", ")),
        };
        let reason = notes.iter().find(|note| matches!(note, Note::Unread { .. })).map(Note::to_string);
        let choice = Choice { rows, field, reference: reference.unwrap_or_default() };
        let (has_field, has_reference) = (choice.field.is_some(), !choice.reference.is_empty());
        self.choice = Some(choice);
        Ok(Survey { has_field, has_reference, notes, reason, expected })
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(topic) = self.choice.as_ref().and_then(|choice| choice.field.clone()) else {
            return Ok(Box::new(std::iter::empty()));
        };
        let is_ours = topic.kind == Kind::OurField;
        let decoded = move |data: &[u8]| if is_ours { plumbline::field(data) } else { ros::field(data) };
        let messages = self.messages(Some(vec![topic]));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decoded(&message.data)).transpose())))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let topics = self.choice.as_ref().map_or_else(Vec::new, |choice| choice.reference.clone());
        let mut joined = plumbline::Joined::default();
        let mut decoded = move |Message { topic, data }: &Message| match topic.kind {
            Kind::OurSample => plumbline::inertial(data).and_then(|(tick, sample)| joined.sample(tick, sample.t_ns)),
            Kind::OurReference => plumbline::reference(data).and_then(|reference| joined.reference(reference)),
            _ => ros::inertial(data)?.attitude,
        };
        if topics.is_empty() {
            return Ok(Box::new(std::iter::empty()));
        }
        let messages = self.messages(Some(topics));
        Ok(Box::new(messages.filter_map(move |message| message.map(|message| decoded(&message)).transpose())))
    }

    fn rows(&self, rows: &mut RowWriter, tell: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let mut aligned = ForceAligner::default();
        let Some(topic) = self.choice.as_ref().and_then(|choice| choice.rows.clone()) else { return Ok(aligned) };
        let is_ours = topic.kind == Kind::OurSample;
        let mut messages = self.messages(Some(vec![topic]));
        for index in 0u64.. {
            if index.is_multiple_of(TELL_EVERY) {
                tell(self.read_bytes.get());
            }
            let Some(Message { data, .. }) = messages.next()? else { break };
            let inertial =
                if is_ours { plumbline::inertial(&data).map(|(_, inertial)| inertial) } else { ros::inertial(&data) };
            if let Some(Inertial { t_ns, rate_rad_s, force_m_s2, .. }) = inertial {
                aligned.push_force((t_ns, force_m_s2), rows)?;
                aligned.push_rate((t_ns, rate_rad_s), rows)?;
            }
        }
        aligned.finish(rows)?;
        Ok(aligned)
    }
}

/// The files of a bag, in the order of the numbers in their names.
fn files(folder: &Path) -> Result<Vec<(PathBuf, Format)>, ImportError> {
    let failed = |cause| opening(folder, cause);
    let mut files = Vec::new();
    let mut has_compressed = false;
    for entry in fs::read_dir(folder).map_err(failed)?.take(MAX_FILES) {
        let path = entry.map_err(failed)?.path();
        has_compressed |= path.extension().is_some_and(|end| end == "zstd");
        let is_file = fs::metadata(&path).is_ok_and(|found| found.is_file());
        if let Some(format) = is_file.then(|| Format::of(&path).ok()).flatten()
            && matches!(format, Format::Mcap | Format::Sqlite)
        {
            files.push((path, format));
        }
    }
    if files.is_empty() {
        let found = if has_compressed { "files that are compressed as a whole" } else { "no file of messages" };
        let expected = if has_compressed {
            "files that can be read: unpack them with zstd -d"
        } else {
            "a .mcap or .db3 file beside metadata.yaml; copy the whole folder"
        };
        return Err(ImportError::NoBag { path: folder.into(), found: found.into(), expected });
    }
    files.sort_by_cached_key(|(path, _)| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (name, number) = stem.rsplit_once('_').unwrap_or((&stem, ""));
        (number.parse::<u64>().unwrap_or(0), name.to_owned())
    });
    Ok(files)
}

/// Messages of several files, one after the other.
struct Messages {
    files: vec::IntoIter<(PathBuf, Format)>,
    current: Option<(PathBuf, Cursor)>,
    wanted: Option<Vec<Topic>>,
    read_bytes: Rc<Cell<u64>>,
    damaged_chunks: u64,
    notes: Vec<Note>,
}

enum Cursor {
    Mcap(Box<mcap::Cursor>),
    Sqlite(Box<sqlite::Cursor>),
}

impl Messages {
    /// The next message; `None` at the end of the last file. A file that cannot be read on is noted, and the next is read.
    fn next(&mut self) -> Result<Option<Message>, ImportError> {
        loop {
            let Some((path, cursor)) = &mut self.current else {
                let Some((path, format)) = self.files.next() else {
                    self.note_chunks();
                    return Ok(None);
                };
                let (wanted, read_bytes) = (self.wanted.as_deref(), &self.read_bytes);
                let cursor = match format {
                    Format::Sqlite => sqlite::Cursor::open(&path, wanted, read_bytes).map(Box::new).map(Cursor::Sqlite),
                    _ => Ok(Cursor::Mcap(mcap::Cursor::open(&path, wanted, read_bytes)?.into())),
                };
                match cursor {
                    Ok(cursor) => self.current = Some((path, cursor)),
                    Err(Stop::Failed(error)) => return Err(error),
                    Err(Stop::Damage(found)) => self.note(&path, found),
                }
                continue;
            };
            let next = match cursor {
                Cursor::Mcap(cursor) => cursor.next(),
                Cursor::Sqlite(cursor) => cursor.next(),
            };
            let path = path.clone();
            match next {
                Ok(Some(message)) => return Ok(Some(compressed::unpacked(message))),
                Err(Stop::Failed(error)) => return Err(error),
                Ok(None) => {}
                Err(Stop::Damage(found)) => self.note(&path, found),
            }
            if let Some((_, Cursor::Mcap(cursor))) = self.current.take() {
                self.damaged_chunks += cursor.damaged_chunks;
            }
        }
    }

    fn note(&mut self, path: &Path, found: String) {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.notes.push(Note::Unread { file, found });
    }

    fn note_chunks(&mut self) {
        let count = std::mem::take(&mut self.damaged_chunks);
        if count > 0 {
            self.notes.push(Note::LeftOut { what: "chunks of messages", count, why: "they are damaged" });
        }
    }
}

impl Iterator for Messages {
    type Item = Result<Message, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        Self::next(self).transpose()
    }
}

/// The fixes of one topic, and the newest position before each.
#[derive(Default)]
struct Fixes {
    topic: Option<Rc<Topic>>,
    located: Option<Rc<Topic>>,
    position: Option<Position>,
    last_ns: Option<i64>,
    not_after: u64,
}

impl Fixes {
    /// Hands a fix on where its topic is the one that is read, which is the first; tells whether there is one.
    fn take(
        &mut self,
        topic: &Rc<Topic>,
        fix: Option<Fix>,
        is_read: bool,
        take: &mut TakeFix<'_>,
    ) -> Result<bool, ImportError> {
        let Some(fix) = fix else { return Ok(false) };
        if !is_read || *self.topic.get_or_insert_with(|| topic.clone()) != *topic {
            return Ok(true);
        }
        if self.last_ns.is_some_and(|last_ns| fix.t_ns <= last_ns) {
            self.not_after += 1;
            return Ok(true);
        }
        self.last_ns = Some(fix.t_ns);
        let nowhere = Position { latitude_deg: f64::NAN, longitude_deg: f64::NAN, altitude_m: f64::NAN };
        let Position { latitude_deg, longitude_deg, altitude_m } = fix.position.or(self.position).unwrap_or(nowhere);
        take(&Fixed { t_ns: fix.t_ns, velocity_m_s: fix.velocity_m_s, latitude_deg, longitude_deg, altitude_m })?;
        Ok(true)
    }

    /// Keeps the newest position of the first topic that has one; tells whether there is one.
    fn locate(&mut self, topic: &Rc<Topic>, position: Option<Position>) -> bool {
        let is_some = position.is_some();
        if is_some && *self.located.get_or_insert_with(|| topic.clone()) == *topic {
            self.position = position;
        }
        is_some
    }
}
