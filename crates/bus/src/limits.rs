//! Limits of a system and of the machine, with advice for raising them.

use std::fmt;

use rustix::fs::statvfs;

/// Folder that contains the segments and folders of all systems.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// Maximum number of observers of a system at the same time.
pub const MAX_OBSERVERS: usize = 4;
/// Number of files that a process must be allowed to open. In a system of five services a process
/// opens 75 files. The gateway, candidates and leftovers of killed processes need more.
pub const REQUIRED_OPEN_FILES: u64 = 256;

/// Advice for raising the open-file limit.
pub const OPEN_FILES_REMEDY: &str = "allow more: `ulimit -n 4096`, for other users than root `sudo prlimit --pid $$ --nofile=4096`; LimitNOFILE=4096 in the unit; in a container --ulimit nofile=4096";

/// Advice for freeing or adding shared memory.
pub const SHARED_MEMORY_REMEDY: &str = "make room with `plumb doctor --fix`, or make it larger as root with `mount -o remount,size=1G /dev/shm`; in a container --shm-size=1g";

/// Shared memory of this machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SharedMemory {
    /// Free shared memory, bytes.
    pub free_bytes: u64,
    /// Total size of the shared memory, bytes.
    pub size_bytes: u64,
}

impl SharedMemory {
    /// Returns the current amounts, or `None` if they cannot be determined.
    pub fn query() -> Option<Self> {
        let stat = statvfs(SHARED_MEMORY).ok()?;
        Some(Self { free_bytes: stat.f_bavail * stat.f_frsize, size_bytes: stat.f_blocks * stat.f_frsize })
    }
}

impl fmt::Display for SharedMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} are free in {SHARED_MEMORY}", Mib(self.free_bytes), Mib(self.size_bytes))
    }
}

/// Number of bytes, displayed in MiB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mib(pub u64);

impl fmt::Display for Mib {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} MiB", self.0 as f64 / f64::from(1 << 20))
    }
}
