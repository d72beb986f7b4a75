//! Writes the attitude file in a separate thread.
//!
//! Input: lines.
//!
//! Output: the file, or standard output. While the disk stalls, lines are queued in memory and the
//! run continues.
//!
//! Failure: a file that cannot be created is an error. A file that can no longer be written ends
//! with a complete line.

use std::{
    fs::{self, File},
    io::{self, Write},
    os::{
        fd::AsFd,
        unix::fs::{FileTypeExt, MetadataExt},
    },
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, Receiver, SyncSender, TrySendError},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use crate::error::CollectorError;

/// Path that stands for standard output.
pub const STANDARD_OUTPUT: &str = "-";
/// Size in bytes at which a batch of lines is sent to the writer thread.
const BATCH_BYTES: usize = 8192;
/// Maximum number of queued batches. They hold 32 MiB, which is several minutes of lines at 1 kHz.
const MAX_BATCHES: usize = 4096;
/// Maximum time without disk progress while the run waits for the disk. The run waits when the
/// queue is full and when the run ends.
const STALL_TIMEOUT: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Writer of the attitude file, with the lines not yet sent to the writer thread.
pub(crate) struct CsvWriter {
    path: PathBuf,
    buffer: String,
    batches: Option<SyncSender<String>>,
    /// Writer thread; `None` once it has been joined.
    writer: Option<JoinHandle<io::Result<()>>>,
    written_bytes: Arc<AtomicU64>,
    /// Maximum time without disk progress while the caller waits.
    stall_timeout: Duration,
}

impl CsvWriter {
    /// Creates the file with the header line. An existing file keeps its content until the first
    /// lines are written, so a run that fails to start does not destroy it.
    ///
    /// [`STANDARD_OUTPUT`] is not created, and its earlier content is kept.
    pub(crate) fn create(path: &Path, header: String) -> Result<Self, CollectorError> {
        let create_error = |cause| CollectorError::Create { path: path.into(), cause };
        if path == Path::new(STANDARD_OUTPUT) {
            let path = Path::new("standard output");
            let file = io::stdout().as_fd().try_clone_to_owned().map(File::from);
            return file
                .and_then(|file| Self::new(path, file, header, false, STALL_TIMEOUT))
                .map_err(|cause| CollectorError::Create { path: path.into(), cause });
        }
        // Opening a named pipe would block until a reader opens it.
        if fs::metadata(path).is_ok_and(|metadata| metadata.file_type().is_fifo()) {
            return Err(create_error(io::Error::other("the path is a named pipe; choose a regular file")));
        }
        let file = File::options().write(true).create(true).truncate(false).open(path);
        file.and_then(|file| Self::new(path, file, header, true, STALL_TIMEOUT)).map_err(create_error)
    }

    /// Creates a writer to an open file. Its earlier content is removed if `replaces_content` is
    /// `true`.
    fn new(
        path: &Path,
        file: File,
        buffer: String,
        replaces_content: bool,
        stall_timeout: Duration,
    ) -> io::Result<Self> {
        let (batches, receiver) = mpsc::sync_channel(MAX_BATCHES);
        let written_bytes = Arc::new(AtomicU64::new(0));
        let written = written_bytes.clone();
        let writer = thread::Builder::new()
            .name("out".into())
            .spawn(move || write_batches(file, &receiver, &written, replaces_content))?;
        Ok(Self {
            path: path.into(),
            buffer,
            batches: Some(batches),
            writer: Some(writer),
            written_bytes,
            stall_timeout,
        })
    }

    /// Returns the buffer to which the next line is appended.
    pub(crate) fn buffer(&mut self) -> &mut String {
        &mut self.buffer
    }

    /// Sends the buffered lines if they fill a batch. After an error the file accepts no more data.
    pub(crate) fn send_full_batch(&mut self) -> Result<(), CollectorError> {
        if self.buffer.len() < BATCH_BYTES { Ok(()) } else { self.send_batch() }
    }

    /// Sends the remaining lines and waits until everything is written.
    pub(crate) fn finish(mut self) -> Result<(), CollectorError> {
        self.send_batch()?;
        self.batches = None;
        self.wait_for(|this| this.writer.as_ref().is_none_or(JoinHandle::is_finished).then_some(()))?;
        self.join_writer()
    }

    fn send_batch(&mut self) -> Result<(), CollectorError> {
        let mut batch = std::mem::take(&mut self.buffer);
        let is_sent = self.wait_for(|this| {
            match this.batches.as_ref().map(|batches| batches.try_send(std::mem::take(&mut batch))) {
                Some(Err(TrySendError::Full(returned))) => {
                    batch = returned;
                    None
                }
                Some(Ok(())) => Some(true),
                Some(Err(TrySendError::Disconnected(_))) | None => Some(false),
            }
        })?;
        if is_sent { Ok(()) } else { self.join_writer() }
    }

    /// Polls `done` until it returns a value. Fails after `stall_timeout` without disk progress.
    fn wait_for<T>(&mut self, mut done: impl FnMut(&mut Self) -> Option<T>) -> Result<T, CollectorError> {
        let (mut written, mut progress_at) = (self.written_bytes.load(Ordering::Relaxed), Instant::now());
        loop {
            if let Some(done) = done(self) {
                return Ok(done);
            }
            let now = self.written_bytes.load(Ordering::Relaxed);
            if std::mem::replace(&mut written, now) != now {
                progress_at = Instant::now();
            }
            if progress_at.elapsed() > self.stall_timeout {
                let cause =
                    format!("the disk or the reader has accepted no data for {} s", self.stall_timeout.as_secs());
                return Err(self.write_error(io::Error::new(io::ErrorKind::TimedOut, cause)));
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    /// Joins the writer thread and returns its result.
    fn join_writer(&mut self) -> Result<(), CollectorError> {
        let result = self.writer.take().map(JoinHandle::join);
        match result {
            Some(Ok(written)) => written.map_err(|cause| self.write_error(cause)),
            Some(Err(_)) | None => Err(self.write_error(io::Error::other("the writer thread has ended"))),
        }
    }

    fn write_error(&self, cause: io::Error) -> CollectorError {
        CollectorError::Write { path: self.path.clone(), cause }
    }
}

/// Writes batches of complete lines until the channel is closed or a write fails. If
/// `replaces_content` is set, the batches replace the content of the file. Otherwise, the file is
/// standard output, and batches are dropped once its reader has closed it.
fn write_batches(
    mut file: File,
    batches: &Receiver<String>,
    written_bytes: &AtomicU64,
    replaces_content: bool,
) -> io::Result<()> {
    let mut is_closed = false;
    for batch in batches {
        if replaces_content && written_bytes.load(Ordering::Relaxed) == 0 && file.metadata()?.is_file() {
            file.set_len(0)?;
        }
        match if is_closed { Ok(()) } else { file.write_all(batch.as_bytes()) } {
            Ok(()) => {}
            Err(cause) if !replaces_content && cause.kind() == io::ErrorKind::BrokenPipe => is_closed = true,
            Err(cause) => {
                if replaces_content {
                    // A partial line is cut off, because its last number would be wrong. A failure
                    // is ignored, because a device cannot be truncated.
                    let _ = file.set_len(written_bytes.load(Ordering::Relaxed));
                }
                return Err(cause);
            }
        }
        written_bytes.fetch_add(batch.len() as u64, Ordering::Relaxed);
    }
    Ok(())
}

/// Returns `true` if both paths refer to the same existing file.
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|file| (file.dev(), file.ino())).ok();
    identity(one).is_some_and(|one| Some(one) == identity(other))
}

#[cfg(test)]
mod tests {
    use std::{io::Read, os::fd::OwnedFd};

    use super::*;

    /// Returns a writer to a pipe. The pipe accepts 64 KiB and then stalls until it is read.
    fn slow_writer(limit: Duration) -> (io::PipeReader, CsvWriter) {
        let (reader, writer) = io::pipe().unwrap();
        (
            reader,
            CsvWriter::new(Path::new("slow"), File::from(OwnedFd::from(writer)), "t_s\n".into(), true, limit).unwrap(),
        )
    }

    fn add_line(out: &mut CsvWriter) -> Result<(), CollectorError> {
        out.buffer().push_str("0.000000000,0,0,0,0\n");
        out.send_full_batch()
    }

    #[test]
    fn stalled_disk_delays_no_caller_and_loses_nothing() {
        let (mut reader, mut out) = slow_writer(STALL_TIMEOUT);
        let lines = 100_000;
        (0..lines).for_each(|_| add_line(&mut out).unwrap());
        let all = thread::spawn(move || {
            let mut text = String::new();
            reader.read_to_string(&mut text).map(|_| text)
        });
        out.finish().unwrap();
        let text = all.join().unwrap().unwrap();
        assert_eq!((text.lines().count(), text.ends_with('\n')), (lines + 1, true));
    }

    #[test]
    fn closed_reader_ends_output_without_error() {
        let (reader, writer) = io::pipe().unwrap();
        let file = File::from(OwnedFd::from(writer));
        let mut out = CsvWriter::new(Path::new("pipe"), file, "t_s\n".into(), false, STALL_TIMEOUT).unwrap();
        drop(reader);
        (0..10_000).for_each(|_| add_line(&mut out).unwrap());
        out.finish().unwrap();
    }

    #[test]
    fn existing_file_is_replaced_only_by_new_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.csv");
        fs::write(&path, "an earlier run with a longer text\n").unwrap();
        drop(CsvWriter::create(&path, "t_s\n".into()).unwrap());
        assert_eq!(fs::read_to_string(&path).unwrap(), "an earlier run with a longer text\n");
        CsvWriter::create(&path, "t_s\n".into()).unwrap().finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "t_s\n");
    }

    #[test]
    fn full_queue_fails_after_stall_timeout() {
        let (_reader, mut out) = slow_writer(Duration::from_secs(1));
        let error = (0..).find_map(|_| add_line(&mut out).err()).unwrap();
        assert!(error.to_string().contains("accepted no data for 1 s"), "{error}");
    }

    #[test]
    fn finish_fails_after_stall_timeout() {
        let (_reader, mut out) = slow_writer(Duration::from_secs(1));
        (0..10_000).for_each(|_| add_line(&mut out).unwrap());
        assert!(out.finish().is_err());
    }
}
