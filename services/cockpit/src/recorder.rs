//! Recording of the running system to a file, started and stopped by an operator.
//!
//! Input: messages of the system's bus, and the commands of operators.
//! Output: a flight, in the folder that the launch file names. The file name contains the system
//! name and the time.
//! Time: a recording ends after [`MAX_DURATION`] at the latest.
//! Failure: a recording ends if it reaches its size limit or cannot be written. Its result contains
//! the reason.

use std::{
    fs::{self, DirBuilder},
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc::sync_channel,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use flight::FlightError;
use graph::Topic;
use observe::system_recording::{POLL_INTERVAL, SystemRecording, SystemRecordingError};
use runtime::ServiceConfig;
use wire::v1::Recording;

use crate::locked::lock;

/// Maximum duration of a recording.
const MAX_DURATION: Duration = Duration::from_secs(24 * 3600);
/// Interval between two checks of the limits.
const CHECK_INTERVAL: Duration = Duration::from_millis(500);

/// Error when starting or stopping a recording.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecorderError {
    /// The launch file names no folder.
    #[error(
        "no folder for recordings; set `recordings` in the section [cockpit] of the launch file and restart the system"
    )]
    NoFolder,
    /// A recording is in progress.
    #[error("{file} is being recorded already; stop it first")]
    Running { file: String },
    /// No recording is in progress.
    #[error("nothing is being recorded")]
    NotRunning,
    /// The recording could not be started.
    #[error(transparent)]
    Start(#[from] SystemRecordingError),
}

impl From<FlightError> for RecorderError {
    fn from(error: FlightError) -> Self {
        Self::Start(error.into())
    }
}

/// Recorder of a system. It records one file at a time.
#[derive(Debug, Default)]
pub(crate) struct FlightRecorder {
    running: Mutex<Option<Running>>,
    /// Progress of the recording, or the result of the last one.
    progress: Arc<Mutex<Recording>>,
}

#[derive(Debug)]
struct Running {
    should_stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl FlightRecorder {
    /// Starts a recording of all topics.
    ///
    /// # Errors
    ///
    /// Returns an error if the launch file names no folder, a recording is in progress, or the file
    /// cannot be created.
    pub(crate) fn start(&self, config: &ServiceConfig) -> Result<(), RecorderError> {
        let cockpit = &config.launch.cockpit;
        let folder = cockpit.recordings.as_deref().ok_or(RecorderError::NoFolder)?;
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|running| !running.thread.is_finished()) {
            return Err(RecorderError::Running { file: lock(&self.progress).file.clone() });
        }
        let folder = system_folder(config.supervisor_pid).join(folder);
        let created = DirBuilder::new().recursive(true).mode(0o700).create(&folder);
        created.map_err(|cause| FlightError::Create { path: folder.clone(), cause })?;
        let path = flight::unused_path(&folder, &config.launch.name)?;
        let file = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
        let (system, max_bytes) = (config.launch.name.clone(), cockpit.recording_max_mib << 20);
        let (should_stop, progress) = (Arc::new(AtomicBool::new(false)), self.progress.clone());
        let (sender, started) = sync_channel(1);
        // The observer's topics must stay on the thread that has opened them.
        let thread = thread::spawn({
            let should_stop = should_stop.clone();
            move || match SystemRecording::start(&system, Topic::ALL, &path, env!("CARGO_PKG_VERSION")) {
                Ok(recording) => {
                    *lock(&progress) = Recording { active: true, file, ..Recording::default() };
                    // The caller waits for this message.
                    let _ = sender.send(Ok(()));
                    record(recording, &path, max_bytes, &should_stop, &progress);
                }
                Err(error) => drop(sender.send(Err(error))),
            }
        });
        // If no message arrives, the thread has panicked.
        started.recv().map_err(|_| RecorderError::NotRunning)??;
        *running = Some(Running { should_stop, thread });
        Ok(())
    }

    /// Stops the recording and waits until its file is complete.
    ///
    /// # Errors
    ///
    /// Returns an error if no recording is in progress.
    pub(crate) fn stop(&self) -> Result<(), RecorderError> {
        let running = lock(&self.running).take().filter(|running| !running.thread.is_finished());
        let Running { should_stop, thread } = running.ok_or(RecorderError::NotRunning)?;
        should_stop.store(true, Ordering::SeqCst);
        // A thread that has panicked has ended, too.
        let _ = thread.join();
        Ok(())
    }

    /// Returns the progress of the recording, or the result of the last one; `None` if nothing was
    /// recorded yet.
    pub(crate) fn progress(&self) -> Option<Recording> {
        Some(lock(&self.progress).clone()).filter(|progress| !progress.file.is_empty())
    }
}

/// Records until the recording is stopped, reaches a limit or cannot continue.
fn record(
    mut recording: SystemRecording,
    path: &Path,
    max_bytes: u64,
    should_stop: &AtomicBool,
    progress: &Mutex<Recording>,
) {
    let started = Instant::now();
    let mut checked_at = None::<Instant>;
    let end_reason = loop {
        if let Some(reason) = recording.poll() {
            break reason;
        }
        if should_stop.load(Ordering::SeqCst) {
            break "stopped by an operator";
        }
        if checked_at.is_none_or(|checked_at| checked_at.elapsed() >= CHECK_INTERVAL) {
            checked_at = Some(Instant::now());
            let bytes = fs::metadata(path).map_or(0, |file| file.len());
            {
                let mut progress = lock(progress);
                (progress.bytes, progress.seconds) = (bytes, started.elapsed().as_secs_f64());
            }
            if bytes >= max_bytes {
                break "the size limit was reached";
            }
            if started.elapsed() >= MAX_DURATION {
                break "the time limit was reached";
            }
        }
        thread::sleep(POLL_INTERVAL);
    };
    let summary = recording.finish(end_reason);
    let result = summary.error.unwrap_or_else(|| end_reason.into());
    let mut progress = lock(progress);
    let Recording { file, .. } = std::mem::take(&mut *progress);
    *progress = Recording { active: false, file, bytes: summary.bytes, seconds: summary.seconds, result };
}

/// Returns the folder in which the supervisor of a system runs. Relative paths in the launch file
/// refer to this folder.
fn system_folder(supervisor_pid: u32) -> PathBuf {
    fs::read_link(format!("/proc/{supervisor_pid}/cwd")).unwrap_or_default()
}
