//! Stores records in an unnamed file, which is removed when it is closed.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};

/// Number of bytes that are collected before they are written.
const BUFFER_BYTES: usize = 1 << 16;

/// Sequence of records that is read once, at the end.
pub(crate) struct SpillFile {
    file: File,
    buffer: Vec<u8>,
    count: u32,
}

impl SpillFile {
    /// Creates the file in the folder of the recording `path`. It has the name `PATH.KIND` only
    /// while it is being opened.
    pub(crate) fn create(path: &Path, kind: &str) -> io::Result<Self> {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{kind}"));
        let file = OpenOptions::new().read(true).write(true).create_new(true).mode(0o600).open(&name)?;
        fs::remove_file(&name)?;
        Ok(Self { file, buffer: Vec::new(), count: 0 })
    }

    /// Returns the number of records.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// Adds a record.
    pub(crate) fn push(&mut self, record: &[u8]) -> io::Result<()> {
        self.buffer.extend_from_slice(record);
        self.count += 1;
        if self.buffer.len() >= BUFFER_BYTES {
            self.file.write_all(&self.buffer)?;
            self.buffer.clear();
        }
        Ok(())
    }

    /// Passes all records to `visit`, in parts of limited size. A part may end in the middle of a
    /// record.
    pub(crate) fn read(&mut self, visit: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        self.file.write_all(&self.buffer)?;
        self.file.seek(SeekFrom::Start(0))?;
        self.buffer.resize(BUFFER_BYTES, 0);
        loop {
            match self.file.read(&mut self.buffer)? {
                0 => return Ok(()),
                count => visit(&self.buffer[..count])?,
            }
        }
    }
}
