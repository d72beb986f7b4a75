//! Record of a run in a file. If the supervisor dies, other commands report the end of the run from
//! this file.
//!
//! - Input: start, progress and failure of a run.
//! - Output: the file `NAME.run` in the state folder. It exists during a run and after a run that
//!   failed or was killed. A run that ends normally removes it.
//! - Time: wall-clock time, for display only. The modification time of the file is refreshed every
//!   [`REFRESH_INTERVAL`], which limits the uncertainty of the time of death.
//! - Failure: without a writable state folder there is no record. A run does not depend on it.

use std::{
    fmt,
    fs::{self, File, OpenOptions},
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use runtime::machine::{boot_id, state_folder};
use serde::{Deserialize, Serialize};
use time::UtcDateTime;

use crate::warm::file;

/// Interval between two refreshes: a compromise between the uncertainty of the time of death and
/// the wear of a memory card.
const REFRESH_INTERVAL: Duration = Duration::from_secs(10);
/// State folder of plumbline.service, which other users may inspect.
const SERVICE_FOLDER: &str = "/var/lib/plumbline";

/// Record of the run of this process.
#[derive(Debug)]
pub(crate) struct RunRecord {
    path: PathBuf,
    content: Content,
    refreshed: Instant,
}

/// Content of the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    pid: u32,
    boot: String,
    started_unix_s: u64,
    /// Failure that ended the run; `None` while the run is in progress or if it was killed.
    failure: Option<Failure>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Failure {
    unix_s: u64,
    cause: String,
}

/// End of the last run of a system that is not running.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LastRun {
    /// Start of the run, s since 1970.
    pub started_unix_s: u64,
    /// End of the run, s since 1970. For a run that was killed, the last time at which the
    /// supervisor was known to be alive.
    pub ended_unix_s: u64,
    /// Reason why the run ended.
    pub reason: EndReason,
}

/// Reason why a run has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The run failed with this error.
    Failed(String),
    /// The supervisor with this process ID was killed or crashed.
    Killed(u32),
    /// The machine stopped while the system ran.
    MachineStopped,
}

impl RunRecord {
    /// Creates the record of a run that has just started. Returns `None` if there is no writable
    /// state folder.
    pub(crate) fn create(system: &str) -> Option<Self> {
        let path = state_folder()?.join(file_name(system));
        let content = Content {
            pid: std::process::id(),
            boot: boot_id(),
            started_unix_s: unix_s(SystemTime::now()),
            failure: None,
        };
        let record = Self { path, content, refreshed: Instant::now() };
        record.write().then_some(record)
    }

    /// Marks the run as alive.
    pub(crate) fn refresh(&mut self) {
        if self.refreshed.elapsed() >= REFRESH_INTERVAL {
            self.refreshed = Instant::now();
            // A failed refresh only makes the time of death less accurate.
            let file = OpenOptions::new().append(true).open(&self.path);
            let _ = file.and_then(|file: File| file.set_modified(SystemTime::now()));
        }
    }

    /// Records the end of the run.
    pub(crate) fn finish(mut self, failure: Option<String>) {
        match failure {
            Some(cause) => {
                self.content.failure = Some(Failure { unix_s: unix_s(SystemTime::now()), cause });
                self.write();
            }
            // If the file remained, the run would be reported as killed.
            None => drop(fs::remove_file(&self.path)),
        }
    }

    fn write(&self) -> bool {
        let text = serde_json::to_string(&self.content).unwrap_or_default();
        file::write(&self.path, &text).is_ok()
    }
}

impl LastRun {
    /// Returns the end of the last run of a system that is not running. Returns `None` if the run
    /// ended normally or is unknown.
    pub fn read(system: &str) -> Option<Self> {
        let folders = state_folder().into_iter().chain([SERVICE_FOLDER.into()]);
        let records = folders.filter_map(|folder| Self::read_file(&folder.join(file_name(system)), &boot_id()));
        records.max_by_key(|run| run.ended_unix_s)
    }

    fn read_file(path: &Path, boot: &str) -> Option<Self> {
        let content: Content = serde_json::from_str(&file::read(path).ok()??).ok()?;
        let alive_unix_s = unix_s(fs::metadata(path).ok()?.modified().ok()?);
        let Content { pid, boot: boot_of_run, started_unix_s, failure } = content;
        let (ended_unix_s, reason) = match failure {
            Some(Failure { unix_s, cause }) => (unix_s, EndReason::Failed(cause)),
            None if boot_of_run != boot => (alive_unix_s, EndReason::MachineStopped),
            None => (alive_unix_s, EndReason::Killed(pid)),
        };
        Some(Self { started_unix_s, ended_unix_s, reason })
    }
}

impl fmt::Display for LastRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { started_unix_s, ended_unix_s, reason } = self;
        let (started, ended) = (DisplayTime(*started_unix_s), DisplayTime(*ended_unix_s));
        write!(f, "the last run, started {started}, ")?;
        let interval_s = REFRESH_INTERVAL.as_secs();
        match reason {
            EndReason::Failed(cause) => write!(f, "failed {ended}: {}", foreign::ForeignText::from(&**cause)),
            EndReason::Killed(pid) => {
                write!(
                    f,
                    "ended within {interval_s} s after {ended}: its supervisor, process {pid}, was killed or crashed"
                )
            }
            EndReason::MachineStopped => {
                write!(f, "ended within {interval_s} s after {ended}: the machine was stopped or lost power")
            }
        }
    }
}

/// Time in UTC, to the second.
struct DisplayTime(u64);

impl fmt::Display for DisplayTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time = UtcDateTime::from_unix_timestamp(self.0.cast_signed()).unwrap_or(UtcDateTime::UNIX_EPOCH);
        write!(f, "{} {:02}:{:02}:{:02} UTC", time.date(), time.hour(), time.minute(), time.second())
    }
}

fn file_name(system: &str) -> String {
    format!("{system}.run")
}

fn unix_s(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(folder: &Path) -> RunRecord {
        let content = Content { pid: 7, boot: "now".into(), started_unix_s: 1_764_236_401, failure: None };
        let record = RunRecord { path: folder.join("a.run"), content, refreshed: Instant::now() };
        assert!(record.write());
        record
    }

    #[test]
    fn reason_of_the_end_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.run");
        drop(record(folder.path()));
        File::options()
            .append(true)
            .open(&path)
            .unwrap()
            .set_modified(UNIX_EPOCH + Duration::from_secs(1_764_236_410))
            .unwrap();
        let killed = LastRun::read_file(&path, "now").unwrap();
        assert_eq!((killed.reason.clone(), killed.ended_unix_s), (EndReason::Killed(7), 1_764_236_410));
        assert_eq!(
            killed.to_string(),
            "the last run, started 2025-11-27 09:40:01 UTC, ended within 10 s after 2025-11-27 09:40:10 UTC: its supervisor, process 7, was killed or crashed"
        );
        assert_eq!(LastRun::read_file(&path, "later").unwrap().reason, EndReason::MachineStopped);
        record(folder.path()).finish(Some("gyro\nfailed".into()));
        let failed = LastRun::read_file(&path, "later").unwrap();
        assert_eq!(failed.reason, EndReason::Failed("gyro\nfailed".into()));
        assert!(failed.to_string().ends_with("UTC: gyro\\nfailed"), "{failed}");
    }

    #[test]
    fn normal_end_and_damaged_record_report_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.run");
        record(folder.path()).finish(None);
        assert_eq!(LastRun::read_file(&path, "now"), None);
        fs::write(&path, "{").unwrap();
        assert_eq!(LastRun::read_file(&path, "now"), None);
    }
}
