//! The file of attitudes.
//!
//! Input: lines. Output: the file. Time: none. Failure: a file that cannot be made is refused; one that cannot be written any more ends with a whole line. A thread writes: a disk that
//! stands still for a while holds up nobody, and what it takes later waits in memory.

use std::{
    fs::{self, File},
    io::{self, Write},
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, Receiver, SyncSender, TrySendError},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use crate::CollectorError;

/// Lines are handed over when there are so many bytes of them.
const BATCH_BYTES: usize = 8192;
/// Batches that wait for the disk: 32 MiB, some minutes at 1 kHz.
const MAX_BATCHES: usize = 4096;
/// How long a disk may take nothing while the run waits for it: where that many batches wait already, and at the end.
const STILL_LIMIT: Duration = Duration::from_secs(5);
const POLL: Duration = Duration::from_millis(1);

/// The file, and the lines that are still to be handed to it.
pub(crate) struct Out {
    path: PathBuf,
    lines: String,
    batches: Option<SyncSender<String>>,
    /// `None` once it has said how it ended.
    writer: Option<JoinHandle<io::Result<()>>>,
    written_bytes: Arc<AtomicU64>,
    /// How long the disk may take nothing while it is waited for.
    still_limit: Duration,
}

impl Out {
    /// An empty file, but for the names of its columns.
    pub(crate) fn create(path: &Path, head: String) -> Result<Self, CollectorError> {
        let failed = |cause| CollectorError::Create { path: path.into(), cause };
        // To open a pipe is to wait for its reader.
        if fs::metadata(path).is_ok_and(|at_path| at_path.file_type().is_fifo()) {
            return Err(failed(io::Error::other("it is a pipe; name a file")));
        }
        File::create(path).and_then(|file| Self::new(path, file, head, STILL_LIMIT)).map_err(failed)
    }

    fn new(path: &Path, file: File, lines: String, still_limit: Duration) -> io::Result<Self> {
        let (batches, taken) = mpsc::sync_channel(MAX_BATCHES);
        let written_bytes = Arc::new(AtomicU64::new(0));
        let written = written_bytes.clone();
        let writer = thread::Builder::new().name("out".into()).spawn(move || write_all(file, &taken, &written))?;
        Ok(Self { path: path.into(), lines, batches: Some(batches), writer: Some(writer), written_bytes, still_limit })
    }

    /// Where a line is added.
    pub(crate) fn lines(&mut self) -> &mut String {
        &mut self.lines
    }

    /// A whole line was added. Once that has failed nothing more is taken.
    pub(crate) fn line_added(&mut self) -> Result<(), CollectorError> {
        if self.lines.len() < BATCH_BYTES { Ok(()) } else { self.hand_over() }
    }

    /// Waits until everything is written.
    pub(crate) fn finish(mut self) -> Result<(), CollectorError> {
        self.hand_over()?;
        self.batches = None;
        self.moving(|out| out.writer.as_ref().is_none_or(JoinHandle::is_finished).then_some(()))?;
        self.ended()
    }

    fn hand_over(&mut self) -> Result<(), CollectorError> {
        let mut lines = std::mem::take(&mut self.lines);
        let taken = self.moving(|out| {
            match out.batches.as_ref().map(|batches| batches.try_send(std::mem::take(&mut lines))) {
                Some(Err(TrySendError::Full(back))) => {
                    lines = back;
                    None
                }
                Some(Ok(())) => Some(true),
                Some(Err(TrySendError::Disconnected(_))) | None => Some(false),
            }
        })?;
        if taken { Ok(()) } else { self.ended() }
    }

    /// Waits for `done` as long as the disk takes anything.
    fn moving<T>(&mut self, mut done: impl FnMut(&mut Self) -> Option<T>) -> Result<T, CollectorError> {
        let (mut written, mut since) = (self.written_bytes.load(Ordering::Relaxed), Instant::now());
        loop {
            if let Some(done) = done(self) {
                return Ok(done);
            }
            let now = self.written_bytes.load(Ordering::Relaxed);
            if std::mem::replace(&mut written, now) != now {
                since = Instant::now();
            }
            if since.elapsed() > self.still_limit {
                let cause = format!("the disk has taken nothing for {} s", self.still_limit.as_secs());
                return Err(self.ends(io::Error::new(io::ErrorKind::TimedOut, cause)));
            }
            thread::sleep(POLL);
        }
    }

    /// How the writer, which has ended, did.
    fn ended(&mut self) -> Result<(), CollectorError> {
        let ended = self.writer.take().map(JoinHandle::join);
        match ended {
            Some(Ok(written)) => written.map_err(|cause| self.ends(cause)),
            Some(Err(_)) | None => Err(self.ends(io::Error::other("its writer has ended"))),
        }
    }

    fn ends(&self, cause: io::Error) -> CollectorError {
        CollectorError::Ends { path: self.path.clone(), cause }
    }
}

/// Writes batches of whole lines until there are no more, or the disk refuses one.
fn write_all(mut file: File, batches: &Receiver<String>, written_bytes: &AtomicU64) -> io::Result<()> {
    for lines in batches {
        file.write_all(lines.as_bytes()).inspect_err(|_| {
            // A number that was cut would be another one. What is no file, as a device, has no length.
            let _ = file.set_len(written_bytes.load(Ordering::Relaxed));
        })?;
        written_bytes.fetch_add(lines.len() as u64, Ordering::Relaxed);
    }
    Ok(())
}

/// Two names of one file.
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|file| (file.dev(), file.ino())).ok();
    identity(one).is_some_and(|one| Some(one) == identity(other))
}

#[cfg(test)]
mod tests {
    use std::{io::Read, os::fd::OwnedFd};

    use super::*;

    /// A disk that takes what a pipe holds, 64 KiB, and the rest when somebody reads.
    fn slow_disk(limit: Duration) -> (io::PipeReader, Out) {
        let (reader, writer) = io::pipe().unwrap();
        (reader, Out::new(Path::new("slow"), File::from(OwnedFd::from(writer)), "t_s\n".into(), limit).unwrap())
    }

    fn add(out: &mut Out) -> Result<(), CollectorError> {
        out.lines().push_str("0.000000000,0,0,0,0\n");
        out.line_added()
    }

    #[test]
    fn a_disk_that_stands_still_for_a_while_holds_up_nobody_and_has_everything_later() {
        let (mut reader, mut out) = slow_disk(STILL_LIMIT);
        let lines = 100_000;
        (0..lines).for_each(|_| add(&mut out).unwrap());
        let all = thread::spawn(move || {
            let mut text = String::new();
            reader.read_to_string(&mut text).map(|_| text)
        });
        out.finish().unwrap();
        let text = all.join().unwrap().unwrap();
        assert_eq!((text.lines().count(), text.ends_with('\n')), (lines + 1, true));
    }

    #[test]
    fn a_disk_that_takes_nothing_more_is_given_up() {
        let (_reader, mut out) = slow_disk(Duration::from_secs(1));
        let ended = (0..).find_map(|_| add(&mut out).err()).unwrap();
        assert!(ended.to_string().contains("taken nothing for 1 s"), "{ended}");
    }

    #[test]
    fn a_disk_that_takes_nothing_at_the_end_is_given_up() {
        let (_reader, mut out) = slow_disk(Duration::from_secs(1));
        (0..10_000).for_each(|_| add(&mut out).unwrap());
        assert!(out.finish().is_err());
    }
}
