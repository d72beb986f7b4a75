//! The thread that writes the state file: a disk may be slow, full or gone, and nobody waits for it.

use std::{
    path::PathBuf,
    sync::mpsc::{self, Receiver, SyncSender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use runtime::Prior;

use super::{file, moment::Moment, record};
use crate::UpError;

/// How long the end waits for the last state to be written.
const END_LIMIT: Duration = Duration::from_secs(1);
/// Lines that wait to be said; more are not worth it.
const LINES_MAX: usize = 4;

/// The thread.
#[derive(Debug)]
pub(super) struct Keeper {
    found: SyncSender<(Prior, Instant)>,
    lines: Receiver<String>,
    thread: JoinHandle<()>,
}

impl Keeper {
    pub(super) fn new(path: PathBuf, sensors: u64) -> Result<Self, UpError> {
        let (found, states) = mpsc::sync_channel::<(Prior, Instant)>(1);
        let (say, lines) = mpsc::sync_channel(LINES_MAX);
        let work = move || {
            let mut trouble = None;
            for (prior, at) in states {
                let prior = prior.aged(at.elapsed().as_secs_f64(), false);
                let text = record::text(prior, sensors, Moment::now()).map_err(Into::into);
                let written = text.and_then(|text| file::write(&path, &text)).map_err(|error| error.to_string());
                let name = path.display();
                let line = match (&trouble, written.as_ref().err()) {
                    (before, Some(now)) if before.as_ref() != Some(now) => {
                        format!(
                            "state file {name}: it cannot be written: {now}; it is tried again, and the next start may be a cold one"
                        )
                    }
                    (Some(_), None) => format!("state file {name}: it is written again"),
                    _ => continue,
                };
                trouble = written.err();
                // Whoever does not listen knows enough already.
                let _ = say.try_send(line);
            }
        };
        let thread = thread::Builder::new()
            .name("keeper".into())
            .spawn(work)
            .map_err(|cause| UpError::System { doing: "starting the keeper of the state file".into(), cause })?;
        Ok(Self { found, lines, thread })
    }

    /// Hands over what is to be kept. While the one before is being written the newest but this one waits; it is as good.
    pub(super) fn keep(&self, prior: Prior) {
        let _ = self.found.try_send((prior, Instant::now()));
    }

    /// What has happened to the file.
    pub(super) fn said(&self) -> impl Iterator<Item = String> {
        self.lines.try_iter()
    }

    /// Waits until the last of it is written, as long as that is allowed to take.
    pub(super) fn end(self) -> Vec<String> {
        let Self { found, lines, thread } = self;
        drop(found);
        let deadline = Instant::now() + END_LIMIT;
        while !thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        lines.try_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn trouble_with_the_disk_is_said_once_and_its_end_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("folder/imu.state");
        // A file where the folder should be.
        fs::write(folder.path().join("folder"), "").unwrap();
        let keeper = Keeper::new(path.clone(), 1).unwrap();
        let keep = || {
            keeper
                .found
                .send((Prior { bias_rad_s: None, hard_iron_ut: None, gyro_scale: None }, Instant::now()))
                .unwrap()
        };
        (0..3).for_each(|_| keep());
        assert!(keeper.lines.recv().unwrap().contains("it cannot be written: "));
        // Taken up only when the one before is done with.
        (0..2).for_each(|_| keep());
        fs::remove_file(folder.path().join("folder")).unwrap();
        (0..2).for_each(|_| keep());
        let lines = keeper.end();
        assert_eq!(lines, [format!("state file {}: it is written again", path.display())]);
        assert!(fs::read_to_string(&path).unwrap().starts_with("plumbline state 2 "));
    }
}
