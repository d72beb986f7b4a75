//! Detects whether files of a running system were removed or damaged. New processes read these
//! files to join.
//!
//! A check for damage reads only a few kilobytes. It compares the size of each file and its first
//! bytes, which contain the format version. A constant file is compared as a whole.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::Read,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use rustix::{
    fs::{Mode, OFlags, open},
    process::geteuid,
};

use crate::{Claim, SystemName, limits::SHARED_MEMORY, removed_files::OWNER_WRITABLE};

/// Size of the format version at the start of a segment, bytes.
const VERSION_BYTES: usize = 8;
/// Maximum number of compared bytes of a constant file.
const MAX_CONSTANT_BYTES: usize = 4096;
/// Upper bound for the resolution of the times of changes that the kernel records. Its clock for
/// files advances in steps, which are longer if a virtual processor is not scheduled.
const CHANGE_TIME_RESOLUTION: Duration = Duration::from_millis(200);

/// State of the permanent files at the previous check.
#[derive(Debug, Default)]
pub struct FileMonitor {
    known: BTreeMap<PathBuf, Fingerprint>,
    /// Times of the newest changes to the system's folders at the previous search for removed
    /// files; `None` if the next check has to search.
    changed_at: Option<[SystemTime; 3]>,
}

/// Properties of a permanent file that stay the same until the file is removed.
#[derive(Debug)]
struct Fingerprint {
    inode: u64,
    bytes: u64,
    /// Format version of a segment, or content of a constant file.
    head: Vec<u8>,
    /// `false` while the file is being created.
    is_complete: bool,
}

impl FileMonitor {
    /// Returns a removed file of the system that one of the processes still has open.
    ///
    /// The open files of the processes are examined only if a folder of the system has changed, or
    /// if `has_exits` is `true`.
    pub fn removed_file(&mut self, system_name: &SystemName, pids: &[u32], has_exits: bool) -> Option<PathBuf> {
        let changed_at = folder_change_times(system_name);
        if !has_exits && changed_at.is_some() && changed_at == self.changed_at {
            return None;
        }
        let removed = system_name.removed_file(pids);
        self.changed_at = changed_at.filter(|_| removed.is_none());
        removed
    }

    /// Returns a permanent file of the system that was truncated or overwritten after an earlier
    /// check.
    pub fn damaged_file(&mut self, system_name: &SystemName) -> Option<PathBuf> {
        let services = fs::read_dir(system_name.root().join("services")).into_iter().flatten().flatten();
        let paths = system_name.entries().into_iter().chain(services.map(|entry| entry.path()));
        let found: BTreeMap<_, _> = paths.filter_map(|path| Fingerprint::read(&path).map(|one| (path, one))).collect();
        let is_damaged = |path: &PathBuf, now: &Fingerprint| {
            self.known
                .get(path)
                .is_some_and(|known| known.inode == now.inode && (known.bytes, &known.head) != (now.bytes, &now.head))
        };
        let damaged = found.iter().find(|(path, now)| is_damaged(path, now)).map(|(path, _)| path.clone());
        if damaged.is_none() {
            self.known = found;
            self.known.retain(|_, file| file.is_complete);
        }
        damaged
    }
}

impl Fingerprint {
    /// Reads a permanent file of this user. Returns `None` for any other file.
    fn read(path: &Path) -> Option<Self> {
        let is_constant = match path.extension()?.to_str()? {
            "dynamic" | "data" | "global_mgmt" => false,
            "service" => true,
            _ => return None,
        };
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let mut file = File::from(open(path, flags, Mode::empty()).ok()?);
        let found = file.metadata().ok().filter(|found| found.is_file() && found.uid() == geteuid().as_raw())?;
        let mut head = vec![0; if is_constant { MAX_CONSTANT_BYTES } else { VERSION_BYTES }];
        let read_bytes = file.read(&mut head).ok()?;
        head.truncate(read_bytes);
        // iceoryx2 writes the version of a segment last, and makes a constant file read-only last.
        let is_complete =
            if is_constant { found.mode() & OWNER_WRITABLE == 0 } else { head.iter().any(|byte| *byte != 0) };
        Some(Self { inode: found.ino(), bytes: found.len(), head, is_complete })
    }
}

/// Returns the times of the newest changes to the folders of a system. A file that is created or
/// removed later changes one of them.
///
/// Returns `None` if a folder is missing or has just changed. A further change might then have the
/// same time.
fn folder_change_times(system_name: &SystemName) -> Option<[SystemTime; 3]> {
    let root = system_name.root();
    let times = [change_time(Path::new(SHARED_MEMORY))?, change_time(&root)?, change_time(&root.join("services"))?];
    let now = SystemTime::now();
    let is_past = |time: &SystemTime| now.duration_since(*time).is_ok_and(|age| age > CHANGE_TIME_RESOLUTION);
    Some(times).filter(|times| times.iter().all(is_past))
}

/// Returns the time of the newest change to a folder. Unlike the time of modification, it cannot be
/// set, as systemd-tmpfiles does after it has removed a file.
fn change_time(folder: &Path) -> Option<SystemTime> {
    let found = fs::symlink_metadata(folder).ok()?;
    let since_epoch = Duration::new(found.ctime().try_into().ok()?, found.ctime_nsec().try_into().ok()?);
    SystemTime::UNIX_EPOCH.checked_add(since_epoch)
}

impl Claim {
    /// Returns `false` if the shared state was truncated or overwritten.
    pub fn has_intact_state(&self) -> bool {
        self.owner_pid().is_some_and(|pid| pid == std::process::id())
    }
}
