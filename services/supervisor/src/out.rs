//! The file of attitudes.
//!
//! Input: attitudes in the order of ticks. Output: `t_s,qw,qx,qy,qz`, one line per tick, every number with all its digits. Time: the source's.
//! Failure: a file that cannot be made is refused; one that cannot be written any more ends with a whole line.

use std::{
    fmt::Write as _,
    fs::{self, File},
    io::{self, Write},
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
};

use messages::AttitudeOutput;

use crate::UpError;

/// Lines are written when there are so many bytes of them.
const BATCH_BYTES: usize = 8192;

/// The file and the lines that are still to be written to it.
pub(crate) struct Out {
    path: PathBuf,
    file: File,
    lines: String,
    /// What is written: a number of whole lines, bytes.
    written_bytes: u64,
}

impl Out {
    /// An empty file, but for the names of its columns.
    pub(crate) fn create(path: &Path) -> Result<Self, UpError> {
        let failed = |cause| UpError::Out { path: path.into(), cause };
        // A pipe would hold up the run for as long as its reader pleases.
        if fs::metadata(path).is_ok_and(|at_path| at_path.file_type().is_fifo()) {
            return Err(failed(io::Error::other("it is a pipe; name a file")));
        }
        let file = File::create(path).map_err(failed)?;
        Ok(Self { path: path.into(), file, lines: "t_s,qw,qx,qy,qz\n".into(), written_bytes: 0 })
    }

    /// Takes the attitude of a tick. Once that has failed the file is closed.
    pub(crate) fn write(&mut self, output: &AttitudeOutput) -> Result<(), UpError> {
        let t_ns = output.header.t_end_ns;
        let sign = if t_ns < 0 { "-" } else { "" };
        let (s, ns) = (t_ns.unsigned_abs() / 1_000_000_000, t_ns.unsigned_abs() % 1_000_000_000);
        let [w, x, y, z] = output.quaternion;
        // A text in memory takes whatever is written to it.
        let _ = writeln!(self.lines, "{sign}{s}.{ns:09},{w},{x},{y},{z}");
        if self.lines.len() < BATCH_BYTES { Ok(()) } else { self.flush() }
    }

    /// Writes what is still to be written.
    pub(crate) fn flush(&mut self) -> Result<(), UpError> {
        self.file.write_all(self.lines.as_bytes()).map_err(|cause| {
            // A number that was cut would be another one. What is no file, as a device, has no length.
            let _ = self.file.set_len(self.written_bytes);
            UpError::OutEnds { path: self.path.clone(), cause }
        })?;
        self.written_bytes += self.lines.len() as u64;
        self.lines.clear();
        Ok(())
    }
}
