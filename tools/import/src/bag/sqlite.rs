//! Reader of the messages in a ROS 2 database, in the order in which they were written.
//!
//! The database is opened read-only. Only two tables are read. Views and generated columns are
//! rejected, so that no query or expression stored in the file is executed.
//!
//! Memory: [`BATCH_MESSAGES`] messages of at most [`MAX_MESSAGE_BYTES`] each.
//!
//! Failure: rows that are missing or unusable are counted. Row numbers must increase. Rows that
//! violate this are skipped, and reading ends after [`MAX_STRAY_ROWS`] of them. If the B-tree of
//! the table is damaged, the rows after the damage are read from the pages directly.

use std::{
    cell::Cell,
    collections::{HashMap, HashSet, VecDeque},
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use rusqlite::{Connection, OpenFlags, limits::Limit};

use super::{
    message::{Message, ReadError},
    sqlite_pages::{PageRow, Pages},
    topics::Topic,
};

const BATCH_MESSAGES: i64 = 256;
const MAX_MESSAGE_BYTES: i32 = 1 << 16;
const MAX_TOPICS: i64 = 4096;
/// Maximum number of stray rows. A row is stray if its number does not exceed that of the previous
/// row, or exceeds that of the last row. In a damaged database, such rows can recur without end.
const MAX_STRAY_ROWS: u64 = 1000;
/// Maximum length in bytes of a text or blob that SQLite may load.
const MAX_VALUE_BYTES: i32 = 1 << 24;

/// Cursor over the messages in a database.
pub(super) struct Cursor {
    path: PathBuf,
    connection: Connection,
    /// Pages that are read if the tree is damaged.
    pages: Option<Pages>,
    topics: HashMap<i64, Rc<Topic>>,
    batch: VecDeque<Message>,
    query: String,
    /// Identifiers of all topics, including those that are not read.
    topic_ids: HashSet<i64>,
    last_row_id: i64,
    /// Row number of the message with the latest timestamp according to the index; 0 if unknown.
    last_indexed_row_id: i64,
    /// Largest valid row number.
    max_row_id: i64,
    has_ended: bool,
    progress: Progress,
    pub(super) losses: Losses,
}

/// Rows that are missing or unusable.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Losses {
    /// Count of missing rows. Recorders number rows consecutively from 1.
    pub(super) missing: u64,
    /// Stray rows. A row is stray if its number does not exceed that of the previous row, or
    /// exceeds that of the last row.
    pub(super) stray: u64,
    /// Rows that belong to no known topic.
    pub(super) without_topic: u64,
    /// Rows of the selected topics without usable data. The data are not bytes or are too long.
    pub(super) without_data: u64,
}

impl Losses {
    /// Counts the row numbers after `before` and up to `last` as missing. Numbers below 1 are not
    /// counted, because recorders do not use them.
    fn add_missing(&mut self, before: i64, last: i64) {
        let before = before.max(0);
        if last > before {
            self.missing = self.missing.saturating_add(last.abs_diff(before));
        }
    }
}

impl std::ops::Add for Losses {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            missing: self.missing.saturating_add(other.missing),
            stray: self.stray + other.stray,
            without_topic: self.without_topic + other.without_topic,
            without_data: self.without_data + other.without_data,
        }
    }
}

/// Row of the table of messages.
struct Row {
    id: i64,
    topic: Option<i64>,
    data: Option<Vec<u8>>,
    log_ns: i64,
}

/// Reading progress, estimated from the row numbers of the messages.
struct Progress {
    read_bytes: Rc<Cell<u64>>,
    length_bytes: u64,
    reported_bytes: u64,
    first_row_id: i64,
    final_row_id: i64,
}

impl Cursor {
    /// Opens a file to read the messages of the `wanted` topics, or of all readable topics if
    /// `None`.
    pub(super) fn open(path: &Path, wanted: Option<&[Topic]>, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ReadError> {
        let length_bytes =
            fs::metadata(path).map_err(|cause| ReadError::Fatal(crate::error::open_error(path, cause)))?.len();
        let connection = open_read_only(path)?;
        for table in ["topics", "messages"] {
            let query =
                "SELECT count(*) FROM sqlite_master WHERE name = ?1 AND type = 'table' AND sql LIKE 'CREATE TABLE%'";
            let count: i64 = connection.query_row(query, [table], |row| row.get(0))?;
            if count != 1 {
                return Err(ReadError::Damage(format!("no table {table}, not a ROS 2 bag").into()));
            }
            // The expression of a generated column can take hours for each row.
            let query = "SELECT count(*) FROM pragma_table_xinfo(?1) WHERE hidden != 0";
            let generated: i64 = connection.query_row(query, [table], |row| row.get(0))?;
            if generated != 0 {
                return Err(ReadError::Damage(format!("generated columns in {table}, not a ROS 2 bag").into()));
            }
        }
        let (mut topics, mut topic_ids) = (HashMap::new(), HashSet::new());
        let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics LIMIT ?1")?;
        let mut rows = statement.query([MAX_TOPICS])?;
        while let Some(row) = rows.next()? {
            let [name, schema, encoding]: [String; 3] = [row.get(1)?, row.get(2)?, row.get(3)?];
            topic_ids.insert(row.get(0)?);
            let topic = Topic::from_channel(&name, &encoding, &schema);
            if let Some(topic) = topic.filter(|topic| wanted.is_none_or(|wanted| wanted.contains(topic))) {
                topics.insert(row.get(0)?, Rc::new(topic));
            }
        }
        drop(rows);
        drop(statement);
        // Each of these queries needs a single search, whereas a combined query would visit every
        // row. A query fails if the pages that it searches are damaged. Other pages may still be
        // readable.
        let row_id = |query| connection.query_row(query, [], |row| row.get::<_, i64>(0)).ok();
        let (first, last) = (row_id("SELECT min(rowid) FROM messages"), row_id("SELECT max(rowid) FROM messages"));
        let last_indexed =
            row_id("SELECT rowid FROM messages INDEXED BY timestamp_idx ORDER BY timestamp DESC LIMIT 1");
        let max_row_id = last.max(last_indexed).unwrap_or(i64::MAX);
        let ids: Vec<_> = topics.keys().map(i64::to_string).collect();
        let query = format!(
            "SELECT rowid, topic_id, CASE WHEN topic_id IN ({}) AND typeof(data) = 'blob' \
             AND length(data) <= {MAX_MESSAGE_BYTES} THEN data END, timestamp \
             FROM messages WHERE rowid > ?1 ORDER BY rowid LIMIT {BATCH_MESSAGES}",
            ids.join(",")
        );
        let [first, last] = [first, last].map(Option::unwrap_or_default);
        let progress = Progress {
            read_bytes: read_bytes.clone(),
            length_bytes,
            reported_bytes: 0,
            first_row_id: first,
            final_row_id: last,
        };
        let has_ended = topics.is_empty();
        Ok(Self {
            path: path.to_owned(),
            connection,
            pages: None,
            topics,
            batch: VecDeque::new(),
            query,
            topic_ids,
            last_row_id: i64::MIN,
            last_indexed_row_id: last_indexed.unwrap_or(0),
            max_row_id,
            has_ended,
            progress,
            losses: Losses::default(),
        })
    }

    /// Returns the next message, or `None` at the end of the database.
    pub(super) fn next(&mut self) -> Result<Option<Message>, ReadError> {
        while self.batch.is_empty() && !self.has_ended {
            match &self.pages {
                None => self.read_batch()?,
                Some(_) => self.read_page_row()?,
            }
        }
        let next = self.batch.pop_front();
        if next.is_none() {
            self.progress.report(self.progress.final_row_id);
        }
        Ok(next)
    }

    /// Reads the next rows. Each call accepts a row with a larger number, counts a stray row, or
    /// ends reading.
    ///
    /// If the database is damaged, the messages before the damage are returned first. Then the
    /// pages of the file are read directly. If this is not possible, returns the error.
    fn read_batch(&mut self) -> Result<(), ReadError> {
        let mut statement = self.connection.prepare(&self.query)?;
        let mut rows = statement.query([self.last_row_id])?;
        let (mut count, mut last_row_id) = (0, self.last_row_id);
        let mut accepted = Vec::new();
        let damage = loop {
            let row = match rows.next().and_then(|row| row.map(Row::read).transpose()) {
                Ok(Some(row)) => row,
                Ok(None) => break None,
                Err(cause) => break Some(cause.into()),
            };
            count += 1;
            if !(last_row_id < row.id && row.id <= self.max_row_id) {
                self.losses.stray += 1;
                if self.losses.stray >= MAX_STRAY_ROWS {
                    break Some(ReadError::Damage(format!("row {} after row {last_row_id}", row.id).into()));
                }
                continue;
            }
            last_row_id = row.id;
            accepted.push(row);
        };
        drop(rows);
        drop(statement);
        let is_advanced = !accepted.is_empty();
        accepted.into_iter().for_each(|row| self.add_row(row));
        self.progress.report(self.last_row_id);
        match damage {
            Some(damage) if !is_advanced => match Pages::open(&self.path) {
                Ok(pages) if self.losses.stray < MAX_STRAY_ROWS => self.pages = Some(pages),
                _ => {
                    self.has_ended = true;
                    return Err(damage);
                }
            },
            Some(_) => {}
            None => self.has_ended = count < BATCH_MESSAGES,
        }
        if self.has_ended {
            self.losses.add_missing(self.last_row_id, self.last_indexed_row_id);
        }
        Ok(())
    }

    /// Reads the next row from the remaining pages.
    fn read_page_row(&mut self) -> Result<(), ReadError> {
        let row = match &mut self.pages {
            Some(pages) => pages.next().map_err(|cause| ReadError::Damage(cause.to_string().into()))?,
            None => None,
        };
        match row {
            Some(PageRow { id, topic, log_ns, data }) if id > self.last_row_id && id <= self.max_row_id => {
                let data = Some(data).filter(|data| data.len() <= MAX_MESSAGE_BYTES as usize);
                self.add_row(Row { id, topic: Some(topic), data, log_ns });
            }
            Some(_) => {}
            None => {
                self.has_ended = true;
                self.losses.add_missing(self.last_row_id, self.last_indexed_row_id);
                return Err(ReadError::Damage("the tree of its messages is broken; the intact pages were read".into()));
            }
        }
        Ok(())
    }

    /// Adds a row with a number that is larger than that of the last row.
    fn add_row(&mut self, row: Row) {
        self.losses.add_missing(self.last_row_id, row.id.saturating_sub(1));
        self.last_row_id = row.id;
        match (row.topic.and_then(|id| self.topics.get(&id)), row.data) {
            (Some(topic), Some(data)) => {
                self.batch.push_back(Message { topic: topic.clone(), log_ns: row.log_ns, data });
            }
            (Some(_), None) => self.losses.without_data += 1,
            (None, _) => {
                let is_known = row.topic.is_some_and(|id| self.topic_ids.contains(&id));
                self.losses.without_topic += u64::from(!is_known);
            }
        }
    }
}

impl Row {
    fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Self> {
        // In a damaged row, the topic can have another type. The row then counts as a row without a
        // known topic.
        Ok(Self { id: row.get(0)?, topic: row.get(1).ok(), data: row.get(2)?, log_ns: row.get(3).unwrap_or(0) })
    }
}

/// Opens a database read-only.
///
/// A database without a pending journal is opened as immutable, so that SQLite creates no files
/// next to it.
fn open_read_only(path: &Path) -> Result<Connection, ReadError> {
    let journal = |end: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(end);
        PathBuf::from(name)
    };
    let has_journal = ["-wal", "-journal"].iter().any(|end| journal(end).exists());
    let text = path.to_string_lossy().replace('%', "%25").replace('?', "%3f").replace('#', "%23");
    let uri = format!("file:{text}?{}", if has_journal { "mode=ro" } else { "immutable=1" });
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let connection = Connection::open_with_flags(uri, flags)?;
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)?;
    // With a writable schema, SQLite also reads a file that is shorter than stated in its header.
    connection.execute_batch(
        "PRAGMA writable_schema = ON; PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA query_only = ON",
    )?;
    Ok(connection)
}

impl Progress {
    fn report(&mut self, row_id: i64) {
        let span = self.final_row_id.abs_diff(self.first_row_id).max(1) as f64;
        let fraction = (row_id.max(self.first_row_id).abs_diff(self.first_row_id) as f64 / span).min(1.0);
        let bytes = (fraction * self.length_bytes as f64) as u64;
        self.read_bytes.set(self.read_bytes.get() + bytes.saturating_sub(self.reported_bytes));
        self.reported_bytes = self.reported_bytes.max(bytes);
    }
}

impl From<rusqlite::Error> for ReadError {
    fn from(cause: rusqlite::Error) -> Self {
        Self::Damage(cause.to_string().into())
    }
}
