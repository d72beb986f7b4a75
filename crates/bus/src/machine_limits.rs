//! Resource requirements of a system: shared memory and open files.
//!
//! Input: the limits of the machine.
//!
//! Output: confirmation, or an error that names the insufficient resource and the remedy.
//!
//! Failure: a limit that cannot be read is assumed to be sufficient.

use std::{fmt, fs, io};

use rustix::{
    io::fcntl_dupfd_cloexec,
    process::{Resource, Rlimit, getrlimit, setrlimit},
};

use signal_hook::{
    consts::SIGBUS,
    low_level::{emulate_default_handler, register},
};

use crate::{
    error::BusError,
    limits::{Mib, OPEN_FILES_REMEDY, REQUIRED_OPEN_FILES, SHARED_MEMORY_REMEDY, SharedMemory},
};

/// Minimum number of files that can still be opened. If there are fewer, the open-file limit is
/// considered the cause of a failure.
///
/// The threshold is above zero because the failed operation has closed the files that it had
/// opened.
const MIN_SPARE_FILES: u64 = 16;
/// Minimum free shared memory, bytes. If there is less, a lack of memory is considered the cause of
/// a failure.
const MIN_SPARE_MEMORY_BYTES: u64 = 256 << 10;

impl SharedMemory {
    /// Checks that `needed_bytes` are free for the system `name`.
    ///
    /// # Errors
    ///
    /// Fails if fewer bytes are free.
    pub fn check(name: &str, needed_bytes: u64) -> Result<(), BusError> {
        match Self::query().filter(|memory| memory.free_bytes < needed_bytes) {
            Some(memory) => Err(BusError::SharedMemory { name: name.into(), needed: Mib(needed_bytes), memory }),
            None => Ok(()),
        }
    }
}

/// Raises the open-file limit of this process and its children to the maximum.
pub(crate) fn raise_open_file_limit() -> Result<(), BusError> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        // If the limit cannot be raised, the check below reports it.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
    match getrlimit(Resource::Nofile).current.filter(|allowed| *allowed < REQUIRED_OPEN_FILES) {
        Some(allowed) => Err(BusError::OpenFileLimit { allowed }),
        None => Ok(()),
    }
}

/// Makes the table of this process's open files large enough for [`REQUIRED_OPEN_FILES`].
///
/// In a process with several threads, a table that grows waits for the whole kernel. On a loaded
/// machine, this delayed a service that connected to a restarted publisher by half a second and
/// more. Therefore the table grows here, before the threads of a service start.
pub(crate) fn grow_file_table() {
    // The copy of the descriptor is closed immediately. Without the copy, the table grows later.
    drop(fcntl_dupfd_cloexec(io::stderr(), REQUIRED_OPEN_FILES as i32 - 1));
}

/// Installs a handler that explains SIGBUS, which the kernel sends when shared memory is exhausted.
pub fn report_memory_exhaustion() {
    let report = || {
        for part in ["out of shared memory for the bus (df /dev/shm); ", SHARED_MEMORY_REMEDY, "\n"] {
            // If stderr is closed, the signal alone has to indicate the cause.
            let _ = rustix::io::write(io::stderr(), part.as_bytes());
        }
        let _ = emulate_default_handler(SIGBUS);
    };
    #[allow(unsafe_code)]
    // SAFETY: the handler only writes to a file and restores the default action, both of which are
    // async-signal-safe. It takes no lock and allocates no memory.
    let registered = unsafe { register(SIGBUS, report) };
    // Without the handler the signal still ends the process.
    drop(registered);
}

/// Describes an iceoryx2 error. If open files or shared memory are running out, the description
/// names that as the likely cause.
pub(crate) fn describe_cause(cause: &dyn fmt::Debug) -> String {
    let open = fs::read_dir("/proc/self/fd").map_or(0, |entries| entries.count() as u64);
    let allowed = getrlimit(Resource::Nofile).current.filter(|allowed| open + MIN_SPARE_FILES > *allowed);
    let memory = SharedMemory::query().filter(|memory| memory.free_bytes < MIN_SPARE_MEMORY_BYTES);
    match (allowed, memory) {
        (Some(allowed), _) => {
            format!("{open} of {allowed} allowed files are open; {OPEN_FILES_REMEDY} (iceoryx2: {cause:?})")
        }
        (_, Some(memory)) => format!("{memory}; {SHARED_MEMORY_REMEDY} (iceoryx2: {cause:?})"),
        _ => format!("{cause:?}"),
    }
}
