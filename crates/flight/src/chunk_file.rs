//! File that consists of complete chunks and always ends at a chunk boundary.
//!
//! Input: bytes, and a flush at the end of each chunk or of the summary.
//!
//! Output: the file under its final name, readable by its owner only.
//!
//! Failure: if a chunk can be written only in part, for example because the disk is full, that part
//! is removed. Nothing is written after that.

use std::{
    fs::{File, OpenOptions},
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};

use crate::error::{FlightError, create_error};

/// Size of a chunk or summary above which it is written in parts, bytes.
const MAX_PENDING_BYTES: usize = 4 << 20;

#[derive(Debug)]
pub(crate) struct ChunkFile {
    file: File,
    /// Bytes of the current, incomplete chunk.
    pending: Vec<u8>,
    /// Length of the file up to the end of the last complete chunk.
    complete_bytes: u64,
    /// Number of bytes written after the last complete chunk.
    incomplete_bytes: u64,
    has_failed: bool,
}

impl ChunkFile {
    /// Creates the file. An existing file is not replaced and a symbolic link is not followed.
    pub(crate) fn create(path: &Path) -> Result<Self, FlightError> {
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let file = file.map_err(|cause| create_error(path, cause))?;
        Ok(Self { file, pending: Vec::new(), complete_bytes: 0, incomplete_bytes: 0, has_failed: false })
    }

    /// Returns the number of bytes in the file.
    pub(crate) fn written_bytes(&self) -> u64 {
        self.complete_bytes
    }

    /// Returns the position of the next byte.
    pub(crate) fn position(&self) -> u64 {
        self.complete_bytes + self.incomplete_bytes + self.pending.len() as u64
    }

    /// Adds bytes to the current chunk in memory.
    pub(crate) fn append(&mut self, bytes: &[u8]) {
        self.pending.extend_from_slice(bytes);
    }

    /// Writes the pending bytes. On failure, everything after the last complete chunk is removed.
    fn write_pending(&mut self) -> io::Result<()> {
        if self.has_failed {
            return Err(io::Error::other("the file was closed after a write error"));
        }
        if let Err(cause) = self.file.write_all(&self.pending) {
            self.has_failed = true;
            // If truncation fails, readers skip the incomplete chunk.
            let _ = self.file.set_len(self.complete_bytes);
            return Err(cause);
        }
        self.incomplete_bytes += self.pending.len() as u64;
        self.pending.clear();
        Ok(())
    }

    /// Waits until the data is on disk.
    pub(crate) fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }
}

impl Write for ChunkFile {
    /// Adds bytes to the current chunk, which is written in parts if it is large.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.append(bytes);
        if self.pending.len() >= MAX_PENDING_BYTES {
            self.write_pending()?;
        }
        Ok(bytes.len())
    }

    /// Completes the pending chunk. It is written completely or not at all.
    fn flush(&mut self) -> io::Result<()> {
        self.write_pending()?;
        self.complete_bytes += std::mem::take(&mut self.incomplete_bytes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use super::*;

    #[test]
    fn unflushed_bytes_are_not_in_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut file = ChunkFile::create(&path).unwrap();
        file.write_all(b"one").unwrap();
        assert_eq!((fs::read(&path).unwrap(), file.position()), (Vec::new(), 3));
        file.flush().unwrap();
        file.write_all(b"two").unwrap();
        assert_eq!((fs::read(&path).unwrap(), file.written_bytes()), (b"one".to_vec(), 3));
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn existing_files_and_links_are_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let [existing, link, target] = ["existing", "link", "target"].map(|name| folder.path().join(name));
        fs::write(&existing, "mine").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        for path in [&existing, &link] {
            let error = ChunkFile::create(path).unwrap_err();
            assert!(matches!(error, FlightError::Exists { .. }), "{error}");
        }
        assert_eq!((fs::read(&existing).unwrap(), target.exists()), (b"mine".to_vec(), false));
    }
}
