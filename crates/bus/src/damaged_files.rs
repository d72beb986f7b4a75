//! Detects damage to the permanent files of a running system, which new processes read to join.
//!
//! Every check reads only a few kilobytes. It compares the size of each file and its first bytes,
//! which contain the format version. A constant file is compared as a whole.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::Read,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use rustix::{
    fs::{Mode, OFlags, open},
    process::geteuid,
};

use crate::{Claim, SystemName, removed_files::OWNER_WRITABLE};

/// Size of the format version at the start of a segment, bytes.
const VERSION_BYTES: u64 = 8;
/// Maximum number of compared bytes of a constant file.
const MAX_CONSTANT_BYTES: u64 = 4096;

/// State of the permanent files at the previous check.
#[derive(Debug, Default)]
pub struct FileMonitor {
    known: BTreeMap<PathBuf, Fingerprint>,
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
        let mut head = Vec::new();
        let limit = if is_constant { MAX_CONSTANT_BYTES } else { VERSION_BYTES };
        file.by_ref().take(limit).read_to_end(&mut head).ok()?;
        // iceoryx2 writes the version of a segment last, and makes a constant file read-only last.
        let is_complete =
            if is_constant { found.mode() & OWNER_WRITABLE == 0 } else { head.iter().any(|byte| *byte != 0) };
        Some(Self { inode: found.ino(), bytes: found.len(), head, is_complete })
    }
}

impl Claim {
    /// Returns `false` if the shared state was truncated or overwritten.
    pub fn has_intact_state(&self) -> bool {
        self.owner_pid().is_some_and(|pid| pid == std::process::id())
    }
}
