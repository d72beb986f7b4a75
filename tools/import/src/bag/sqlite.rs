//! The messages of a database of ROS 2, in the order in which they were written.
//!
//! The file is opened for reading alone, and nothing in it runs: what is read are two tables, no views. Memory: [`BATCH`] messages
//! of at most [`MAX_MESSAGE_BYTES`] each.

use std::{
    cell::Cell,
    collections::{HashMap, VecDeque},
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use rusqlite::{Connection, OpenFlags, limits::Limit};

use super::{Message, Stop, topics::Topic};

const BATCH: i64 = 256;
const MAX_MESSAGE_BYTES: i32 = 1 << 16;
const MAX_TOPICS: i64 = 4096;
/// The longest text or blob that SQLite makes.
const MAX_LENGTH: i32 = 1 << 24;

pub(super) struct Cursor {
    database: Connection,
    topics: HashMap<i64, Rc<Topic>>,
    batch: VecDeque<Message>,
    query: String,
    after: i64,
    has_ended: bool,
    progress: Progress,
}

/// How far the file has been read, as far as the numbers of the messages tell.
struct Progress {
    read_bytes: Rc<Cell<u64>>,
    length_bytes: u64,
    told_bytes: u64,
    first: i64,
    last: i64,
}

impl Cursor {
    /// Opens a file for the messages of the `wanted` topics, or of all that can be read.
    pub(super) fn open(path: &Path, wanted: Option<&[Topic]>, read_bytes: &Rc<Cell<u64>>) -> Result<Self, Stop> {
        let length_bytes = fs::metadata(path).map_err(|cause| Stop::Failed(crate::error::opening(path, cause)))?.len();
        let database = connection(path)?;
        for table in ["topics", "messages"] {
            let query =
                "SELECT count(*) FROM sqlite_master WHERE name = ?1 AND type = 'table' AND sql LIKE 'CREATE TABLE%'";
            let count: i64 = database.query_row(query, [table], |row| row.get(0))?;
            if count != 1 {
                return Err(Stop::Damage(format!("it has no table {table}, so it is no bag")));
            }
        }
        let mut topics = HashMap::new();
        let mut statement = database.prepare("SELECT id, name, type, serialization_format FROM topics LIMIT ?1")?;
        let mut rows = statement.query([MAX_TOPICS])?;
        while let Some(row) = rows.next()? {
            let [name, schema, encoding]: [String; 3] = [row.get(1)?, row.get(2)?, row.get(3)?];
            let topic = Topic::of(&name, &encoding, &schema);
            if let Some(topic) = topic.filter(|topic| wanted.is_none_or(|wanted| wanted.contains(topic))) {
                topics.insert(row.get(0)?, Rc::new(topic));
            }
        }
        drop(rows);
        drop(statement);
        let ends = "SELECT min(rowid), max(rowid) FROM messages";
        let (first, last): (Option<i64>, Option<i64>) =
            database.query_row(ends, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        let ids: Vec<_> = topics.keys().map(i64::to_string).collect();
        let query = format!(
            "SELECT rowid, topic_id, data FROM messages WHERE rowid > ?1 AND topic_id IN ({}) AND typeof(data) = 'blob' \
             AND length(data) <= {MAX_MESSAGE_BYTES} ORDER BY rowid LIMIT {BATCH}",
            ids.join(",")
        );
        let [first, last] = [first, last].map(Option::unwrap_or_default);
        let progress = Progress { read_bytes: read_bytes.clone(), length_bytes, told_bytes: 0, first, last };
        let (batch, after, has_ended) = (VecDeque::new(), i64::MIN, topics.is_empty());
        Ok(Self { database, topics, batch, query, after, has_ended, progress })
    }

    /// The next message; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Message>, Stop> {
        while self.batch.is_empty() && !self.has_ended {
            self.read()?;
        }
        let next = self.batch.pop_front();
        if next.is_none() {
            self.progress.tell(self.progress.last);
        }
        Ok(next)
    }

    fn read(&mut self) -> Result<(), Stop> {
        let mut statement = self.database.prepare(&self.query)?;
        let mut rows = statement.query([self.after])?;
        let mut count = 0;
        // What was read before the damage is given first.
        let mut next = || rows.next().map(|row| row.map(|row| (row.get(0), row.get(1), row.get(2))));
        self.has_ended = loop {
            match next() {
                Ok(Some((Ok(id), Ok(topic), Ok(data)))) => {
                    count += 1;
                    self.after = id;
                    let topic: i64 = topic;
                    if let Some(topic) = self.topics.get(&topic) {
                        self.batch.push_back(Message { topic: topic.clone(), data });
                    }
                }
                Ok(None) => break count < BATCH,
                Ok(Some((Err(cause), ..) | (_, Err(cause), _) | (_, _, Err(cause)))) | Err(cause) => {
                    if count == 0 {
                        return Err(cause.into());
                    }
                    break false;
                }
            }
        };
        self.progress.tell(self.after);
        Ok(())
    }
}

/// For reading alone; where nothing waits to be written into it, as if it could never change, so that nothing is made beside it.
fn connection(path: &Path) -> Result<Connection, Stop> {
    let journal = |end: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(end);
        PathBuf::from(name)
    };
    let has_journal = ["-wal", "-journal"].iter().any(|end| journal(end).exists());
    let text = path.to_string_lossy().replace('%', "%25").replace('?', "%3f").replace('#', "%23");
    let address = format!("file:{text}?{}", if has_journal { "mode=ro" } else { "immutable=1" });
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let database = Connection::open_with_flags(address, flags)?;
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_LENGTH)?;
    database.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA query_only = ON")?;
    Ok(database)
}

impl Progress {
    fn tell(&mut self, id: i64) {
        let span = self.last.abs_diff(self.first).max(1) as f64;
        let part = (id.max(self.first).abs_diff(self.first) as f64 / span).min(1.0);
        let bytes = (part * self.length_bytes as f64) as u64;
        self.read_bytes.set(self.read_bytes.get() + bytes.saturating_sub(self.told_bytes));
        self.told_bytes = self.told_bytes.max(bytes);
    }
}

impl From<rusqlite::Error> for Stop {
    fn from(cause: rusqlite::Error) -> Self {
        Self::Damage(cause.to_string())
    }
}
