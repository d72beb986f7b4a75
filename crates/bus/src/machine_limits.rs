//! What a system needs of the machine: shared memory, and files that a process may have open.
//!
//! Input: the machine's limits. Output: that they suffice, or what is short and the remedy. Time: none. Failure: where a limit cannot be
//! read nothing is short.

use std::{fmt, fs, io};

use rustix::{
    fs::statvfs,
    process::{Resource, Rlimit, getrlimit, setrlimit},
};

use signal_hook::{
    consts::SIGBUS,
    low_level::{emulate_default_handler, register},
};

use crate::{BusError, system_name::SHARED_MEMORY};

/// Files that a process of a system may have to have open: 75 with five services, more with a gateway, stages beside, and what the killed leave.
pub const FILES: u64 = 256;
/// How to have more of them.
pub const MORE_FILES: &str =
    "allow more: ulimit -n 4096, or LimitNOFILE=4096 in the unit; in a container --ulimit nofile=4096";
/// How to have more shared memory.
pub const MORE_MEMORY: &str =
    "make room (plumb doctor --fix) or make it larger: mount -o remount,size=1G /dev/shm; in a container --shm-size=1g";
/// So few files, or so little memory, are as good as none: what failed has given back what it had taken.
const FILES_SPARE: u64 = 16;
const MEMORY_SPARE: u64 = 256 << 10;

/// The shared memory of this machine, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SharedMemory {
    /// What is free.
    pub free: u64,
    /// All there is.
    pub size: u64,
}

impl SharedMemory {
    /// What there is now; `None` where it cannot be known.
    pub fn now() -> Option<Self> {
        let stat = statvfs(SHARED_MEMORY).ok()?;
        Some(Self { free: stat.f_bavail * stat.f_frsize, size: stat.f_blocks * stat.f_frsize })
    }

    /// Fails where less than `needed` bytes are free for the system `name`.
    pub fn suffices(name: &str, needed: u64) -> Result<(), BusError> {
        match Self::now().filter(|memory| memory.free < needed) {
            Some(memory) => Err(BusError::Memory { name: name.into(), needed: Mib(needed), memory }),
            None => Ok(()),
        }
    }
}

impl fmt::Display for SharedMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} are free in {SHARED_MEMORY}", Mib(self.free), Mib(self.size))
    }
}

/// Bytes, as people read them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mib(pub u64);

impl fmt::Display for Mib {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} MiB", self.0 as f64 / f64::from(1 << 20))
    }
}

/// Lets this process, and those that it starts, have as many files open as they may.
pub(crate) fn allow_files() -> Result<(), BusError> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        // Where it cannot be raised it stays, and is looked at below.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current.filter(|allowed| *allowed < FILES) {
        Some(allowed) => Err(BusError::Files { allowed }),
        None => Ok(()),
    }
}

/// Whoever touches shared memory of which none is left is ended by SIGBUS; from now on this process says why before that.
pub fn say_when_memory_runs_out() {
    let say = || {
        for part in ["there is no shared memory left for a part of the bus (df /dev/shm); ", MORE_MEMORY, "\n"] {
            // Where nobody reads it the signal says it alone.
            let _ = rustix::io::write(io::stderr(), part.as_bytes());
        }
        let _ = emulate_default_handler(SIGBUS);
    };
    #[allow(unsafe_code)]
    // SAFETY: it writes to a file and takes the signal's default, both of which a handler may do; it takes no lock and no memory.
    let registered = unsafe { register(SIGBUS, say) };
    // Without it the signal ends the process all the same.
    drop(registered);
}

/// What iceoryx2 answered, and why, where the machine is short of something.
pub(crate) fn why(answer: &dyn fmt::Debug) -> String {
    let open = fs::read_dir("/proc/self/fd").map_or(0, |entries| entries.count() as u64);
    let allowed = getrlimit(Resource::Nofile).current.filter(|allowed| open + FILES_SPARE > *allowed);
    let memory = SharedMemory::now().filter(|memory| memory.free < MEMORY_SPARE);
    match (allowed, memory) {
        (Some(allowed), _) => format!("{open} files are open, {allowed} may be; {MORE_FILES} (iceoryx2: {answer:?})"),
        (_, Some(memory)) => format!("{memory}; {MORE_MEMORY} (iceoryx2: {answer:?})"),
        _ => format!("{answer:?}"),
    }
}
