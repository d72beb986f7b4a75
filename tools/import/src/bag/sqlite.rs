//! Reader of the messages in a ROS 2 database, in the order in which they were written.
//!
//! The database is opened read-only. Only two tables are read and views are rejected, so that no
//! query stored in the file is executed.
//!
//! Memory: [`BATCH_MESSAGES`] messages of at most [`MAX_MESSAGE_BYTES`] each.

use std::{
    cell::Cell,
    collections::{HashMap, VecDeque},
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use rusqlite::{Connection, OpenFlags, limits::Limit};

use super::{
    message::{Message, ReadError},
    topics::Topic,
};

const BATCH_MESSAGES: i64 = 256;
const MAX_MESSAGE_BYTES: i32 = 1 << 16;
const MAX_TOPICS: i64 = 4096;
/// Maximum length of a text or blob that SQLite may load, bytes.
const MAX_VALUE_BYTES: i32 = 1 << 24;

/// Cursor over the messages in a database.
pub(super) struct Cursor {
    connection: Connection,
    topics: HashMap<i64, Rc<Topic>>,
    batch: VecDeque<Message>,
    query: String,
    last_row_id: i64,
    has_ended: bool,
    progress: Progress,
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
                return Err(ReadError::Damage(format!("no table {table}, not a ROS 2 bag")));
            }
        }
        let mut topics = HashMap::new();
        let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics LIMIT ?1")?;
        let mut rows = statement.query([MAX_TOPICS])?;
        while let Some(row) = rows.next()? {
            let [name, schema, encoding]: [String; 3] = [row.get(1)?, row.get(2)?, row.get(3)?];
            let topic = Topic::from_channel(&name, &encoding, &schema);
            if let Some(topic) = topic.filter(|topic| wanted.is_none_or(|wanted| wanted.contains(topic))) {
                topics.insert(row.get(0)?, Rc::new(topic));
            }
        }
        drop(rows);
        drop(statement);
        let row_id_range = "SELECT min(rowid), max(rowid) FROM messages";
        let (first, last): (Option<i64>, Option<i64>) =
            connection.query_row(row_id_range, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        let ids: Vec<_> = topics.keys().map(i64::to_string).collect();
        let query = format!(
            "SELECT rowid, topic_id, data FROM messages WHERE rowid > ?1 AND topic_id IN ({}) AND typeof(data) = 'blob' \
             AND length(data) <= {MAX_MESSAGE_BYTES} ORDER BY rowid LIMIT {BATCH_MESSAGES}",
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
        let (batch, after, has_ended) = (VecDeque::new(), i64::MIN, topics.is_empty());
        Ok(Self { connection, topics, batch, query, last_row_id: after, has_ended, progress })
    }

    /// Returns the next message, or `None` at the end of the database.
    pub(super) fn next(&mut self) -> Result<Option<Message>, ReadError> {
        while self.batch.is_empty() && !self.has_ended {
            self.read_batch()?;
        }
        let next = self.batch.pop_front();
        if next.is_none() {
            self.progress.report(self.progress.final_row_id);
        }
        Ok(next)
    }

    fn read_batch(&mut self) -> Result<(), ReadError> {
        let mut statement = self.connection.prepare(&self.query)?;
        let mut rows = statement.query([self.last_row_id])?;
        let mut count = 0;
        // If the database is damaged, the messages before the damage are returned first, then the
        // error.
        let mut next = || rows.next().map(|row| row.map(|row| (row.get(0), row.get(1), row.get(2))));
        self.has_ended = loop {
            match next() {
                Ok(Some((Ok(id), Ok(topic), Ok(data)))) => {
                    count += 1;
                    self.last_row_id = id;
                    let topic: i64 = topic;
                    if let Some(topic) = self.topics.get(&topic) {
                        self.batch.push_back(Message { topic: topic.clone(), data });
                    }
                }
                Ok(None) => break count < BATCH_MESSAGES,
                Ok(Some((Err(cause), ..) | (_, Err(cause), _) | (_, _, Err(cause)))) | Err(cause) => {
                    if count == 0 {
                        return Err(cause.into());
                    }
                    break false;
                }
            }
        };
        self.progress.report(self.last_row_id);
        Ok(())
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
    connection.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA query_only = ON")?;
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
        Self::Damage(cause.to_string())
    }
}
