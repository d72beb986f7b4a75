//! Reader of the messages in the pages of a damaged ROS 2 database, without the B-tree that
//! connects the pages.
//!
//! Input: the file. A page that holds rows of the table of messages is recognised by its rows: each
//! row contains two integers and a blob, and no stored value for the row number.
//!
//! Output: the rows in the order of their numbers.
//!
//! Memory: 16 bytes for each page with messages, and one page.
//!
//! Failure: pages and rows that are not well-formed are skipped, and so are rows that do not fit
//! into one page.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    path::Path,
    vec,
};

/// Length of the file header, bytes.
const HEADER_BYTES: usize = 100;
/// Position of the page size in the header. The value 1 means 65,536.
const PAGE_SIZE_AT: usize = 16;
/// Position of the number of unused bytes at the end of each page.
const RESERVED_AT: usize = 20;
/// Type of a page that holds rows of a table.
const LEAF_OF_TABLE: u8 = 13;
/// Length of the header of a page with rows, bytes.
const PAGE_HEADER_BYTES: usize = 8;
/// Number of bytes in a page that are not available to a row.
const PAGE_OVERHEAD_BYTES: usize = 35;
/// Maximum number of pages with messages.
const MAX_PAGES: usize = 1 << 24;

/// Row of the table of messages.
pub(super) struct PageRow {
    pub(super) id: i64,
    pub(super) topic: i64,
    pub(super) log_ns: i64,
    pub(super) data: Vec<u8>,
}

/// Pages with messages of a file.
pub(super) struct Pages {
    file: File,
    page: Vec<u8>,
    usable_bytes: usize,
    /// Row number of the first row of each page, and byte position of the page.
    pages: vec::IntoIter<(i64, u64)>,
    rows: vec::IntoIter<PageRow>,
}

impl Pages {
    /// Finds the pages of a file that hold messages.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let mut header = [0; HEADER_BYTES];
        file.read_exact(&mut header)?;
        let size = match u16::from_be_bytes([header[PAGE_SIZE_AT], header[PAGE_SIZE_AT + 1]]) {
            1 => 65_536,
            size => usize::from(size),
        };
        if !size.is_power_of_two() || size < 512 {
            return Err(io::Error::other("no valid page size"));
        }
        let usable_bytes = size.saturating_sub(header[RESERVED_AT].into());
        let mut found =
            Self { file, page: vec![0; size], usable_bytes, pages: vec![].into_iter(), rows: vec![].into_iter() };
        let mut pages = Vec::new();
        // The first page is skipped, because it describes the tables.
        for at in (1u64..).map(|number| number * size as u64) {
            if !found.read_page(at)? || pages.len() == MAX_PAGES {
                break;
            }
            pages.extend(found.page_rows().next().map(|row| (row.id, at)));
        }
        pages.sort_unstable();
        found.pages = pages.into_iter();
        Ok(found)
    }

    /// Returns the next row, or `None` after the last one.
    pub(super) fn next(&mut self) -> io::Result<Option<PageRow>> {
        loop {
            if let Some(row) = self.rows.next() {
                return Ok(Some(row));
            }
            let Some((_, at)) = self.pages.next() else { return Ok(None) };
            if self.read_page(at)? {
                self.rows = self.page_rows().collect::<Vec<_>>().into_iter();
            }
        }
    }

    /// Reads a page. Returns `false` at the end of the file.
    fn read_page(&mut self, at: u64) -> io::Result<bool> {
        self.file.seek(SeekFrom::Start(at))?;
        match self.file.read_exact(&mut self.page) {
            Err(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
            result => result.map(|()| true),
        }
    }

    /// Returns the messages in the page that was read.
    fn page_rows(&self) -> impl Iterator<Item = PageRow> + '_ {
        let is_leaf = self.page.first() == Some(&LEAF_OF_TABLE);
        let count = self.page.get(3..5).map_or(0, |count| usize::from(u16::from_be_bytes([count[0], count[1]])));
        let pointers = self.page.get(PAGE_HEADER_BYTES..).unwrap_or_default().chunks_exact(2).take(count);
        let pointers = pointers.take_while(move |_| is_leaf);
        let rows =
            pointers.filter_map(|pointer| self.row_at(usize::from(u16::from_be_bytes([pointer[0], pointer[1]]))));
        // In a damaged page, rows can overlap. Their total length is therefore limited to that of a
        // page.
        let mut left_bytes = self.page.len();
        rows.map_while(move |row| {
            left_bytes = left_bytes.checked_sub(row.data.len())?;
            Some(row)
        })
    }

    fn row_at(&self, at: usize) -> Option<PageRow> {
        let mut cell = self.page.get(at..self.usable_bytes)?;
        let length = usize::try_from(integer(&mut cell)?).ok()?;
        let id = integer(&mut cell)?;
        let record = cell.get(..length).filter(|_| length <= self.usable_bytes - PAGE_OVERHEAD_BYTES)?;
        let mut types = record;
        let header_bytes = usize::try_from(integer(&mut types)?).ok()?;
        let mut types = record.get(record.len() - types.len()..header_bytes)?;
        let mut values = record.get(header_bytes..)?;
        // No value is stored for the column of the row number.
        let (0, topic, time, blob) =
            (integer(&mut types)?, integer(&mut types)?, integer(&mut types)?, integer(&mut types)?)
        else {
            return None;
        };
        let (topic, log_ns) = (value(topic, &mut values)?, value(time, &mut values)?);
        let data_bytes = usize::try_from(blob).ok().filter(|blob| *blob >= 12 && blob.is_multiple_of(2))?;
        Some(PageRow { id, topic, log_ns, data: values.get(..(data_bytes - 12) / 2)?.to_vec() })
    }
}

/// Reads an integer of variable length: seven bits in each byte, and eight bits in the ninth byte,
/// if present.
fn integer(bytes: &mut &[u8]) -> Option<i64> {
    let mut number = 0u64;
    for index in 0..9 {
        let (byte, rest) = bytes.split_first()?;
        *bytes = rest;
        if index == 8 {
            return Some((number << 8 | u64::from(*byte)).cast_signed());
        }
        number = number << 7 | u64::from(byte & 0x7f);
        if *byte < 0x80 {
            break;
        }
    }
    Some(number.cast_signed())
}

/// Reads an integer with the storage type `kind`; `None` if this is not the type of an integer.
fn value(kind: i64, bytes: &mut &[u8]) -> Option<i64> {
    let length = match kind {
        8 => return Some(0),
        9 => return Some(1),
        1..=4 => usize::try_from(kind).ok()?,
        5 => 6,
        6 => 8,
        _ => return None,
    };
    let (found, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    let is_negative = found.first().is_some_and(|first| *first >= 0x80);
    let start = if is_negative { u64::MAX } else { 0 };
    Some(found.iter().fold(start, |number, byte| number << 8 | u64::from(*byte)).cast_signed())
}
