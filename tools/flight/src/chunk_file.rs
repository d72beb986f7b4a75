//! A file that grows by whole chunks: whatever happens, it ends where one does.
//!
//! Input: bytes, and at the end of a chunk a flush. Output: the file, under its own name from the first moment, that only this user may
//! read. Failure: what a full disk has taken of a chunk is cut off again, and nothing more is written.

use std::{
    fs::{File, OpenOptions},
    io::{self, ErrorKind, Seek, SeekFrom, Write},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};

use crate::error::{FlightError, creating};

#[derive(Debug)]
pub(crate) struct ChunkFile {
    file: File,
    /// What the chunk under way has so far.
    pending: Vec<u8>,
    /// Bytes up to the end of the last whole chunk.
    whole_bytes: u64,
    ended: bool,
}

impl ChunkFile {
    /// Makes the file. What is there already stays: neither replaced, nor followed where it is a link.
    pub(crate) fn create(path: &Path) -> Result<Self, FlightError> {
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let file = file.map_err(|cause| creating(path, cause))?;
        Ok(Self { file, pending: Vec::new(), whole_bytes: 0, ended: false })
    }

    /// Bytes in the file.
    pub(crate) fn bytes(&self) -> u64 {
        self.whole_bytes
    }

    /// Waits until the disk has them.
    pub(crate) fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }
}

impl Write for ChunkFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.pending.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    /// Ends a chunk: it is in the file, or nothing of it is.
    fn flush(&mut self) -> io::Result<()> {
        if self.ended {
            return Err(io::Error::other("the file has ended"));
        }
        if let Err(cause) = self.file.write_all(&self.pending) {
            self.ended = true;
            // Should it fail, a reader passes over what is not whole.
            let _ = self.file.set_len(self.whole_bytes);
            return Err(cause);
        }
        self.whole_bytes += self.pending.len() as u64;
        self.pending.clear();
        Ok(())
    }
}

/// Tells the position, which is all that is asked of a file that only grows.
impl Seek for ChunkFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.whole_bytes + self.pending.len() as u64),
            _ => Err(ErrorKind::Unsupported.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use super::*;

    #[test]
    fn what_is_not_flushed_is_not_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut file = ChunkFile::create(&path).unwrap();
        file.write_all(b"one").unwrap();
        assert_eq!((fs::read(&path).unwrap(), file.stream_position().unwrap()), (Vec::new(), 3));
        file.flush().unwrap();
        file.write_all(b"two").unwrap();
        assert_eq!((fs::read(&path).unwrap(), file.bytes()), (b"one".to_vec(), 3));
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn what_is_there_stays_and_a_planted_link_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let [there, link, aim] = ["there", "link", "aim"].map(|name| folder.path().join(name));
        fs::write(&there, "mine").unwrap();
        std::os::unix::fs::symlink(&aim, &link).unwrap();
        for path in [&there, &link] {
            let error = ChunkFile::create(path).unwrap_err();
            assert!(matches!(error, FlightError::Exists { .. }), "{error}");
        }
        assert_eq!((fs::read(&there).unwrap(), aim.exists()), (b"mine".to_vec(), false));
    }
}
