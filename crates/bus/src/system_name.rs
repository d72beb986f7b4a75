//! System names. Each running system has a unique name, which is part of the names of all its
//! files. The files are removed when the system ends.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use iceoryx2::prelude::{Config, FileName, Path as IoxPath, SemanticString};
use rustix::fs::{FlockOperation, flock};

use crate::{
    BusError,
    limits::SHARED_MEMORY,
    owned_files,
    port::MAX_SERVICE_PORTS,
    shared_state::{SHARED_STATE_BYTES, SharedState},
};

/// Start of the names of a system's segments and folder. The system name follows it.
pub(crate) const NAME_PREFIX: &str = "plumbline.";
/// Timeout for the services of a previous owner to exit.
const MEMBERS_EXIT_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout for the locks of a killed owner to be released.
const OWNER_EXIT_TIMEOUT: Duration = Duration::from_millis(500);
/// Timeout for an owner to record its process identifier, and for a new segment to receive a size.
pub(crate) const OWNER_START_TIMEOUT: Duration = Duration::from_millis(100);
/// Timeout for observers to finish attaching or detaching when the owner ends.
const OBSERVERS_TIMEOUT: Duration = Duration::from_millis(200);
/// Interval between two attempts to acquire a lock.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Name of a system, which determines the names of its shared memory and folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemName {
    name: String,
}

impl SystemName {
    /// Creates a system name.
    ///
    /// # Errors
    ///
    /// Fails unless `name` has 1 to 32 characters of a-z, 0-9, - and _.
    pub fn new(name: &str) -> Result<Self, BusError> {
        let is_allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if name.is_empty() || name.len() > 32 || !name.chars().all(is_allowed) {
            return Err(BusError::InvalidName { name: name.into() });
        }
        Ok(Self { name: name.into() })
    }

    /// Returns the name as text.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Makes this process the owner of the name and removes the files of a previous owner.
    ///
    /// # Errors
    ///
    /// Fails if the name is in use, services of an earlier run are still running, or a file belongs
    /// to another user.
    pub fn claim(&self) -> Result<Claim, BusError> {
        let (claim, members_lock) = self.acquire(MEMBERS_EXIT_TIMEOUT, true)?;
        self.create_bus()?;
        drop(members_lock);
        Ok(claim)
    }

    /// Claims the name only to remove the files of a previous owner. The services of that owner
    /// have `members_limit` to exit.
    pub(crate) fn claim_within(&self, members_limit: Duration) -> Result<Claim, BusError> {
        self.acquire(members_limit, true).map(|(claim, _)| claim)
    }

    /// Claims the name like [`claim_within`](Self::claim_within), but only if a previous owner has
    /// left its shared state. If another process has removed that state, the call fails instead of
    /// creating a new shared state.
    pub(crate) fn claim_orphaned(&self, members_limit: Duration) -> Result<Claim, BusError> {
        self.acquire(members_limit, false).map(|(claim, _)| claim)
    }

    /// Acquires the name, and a lock that prevents other processes from joining.
    fn acquire(&self, members_limit: Duration, create: bool) -> Result<(Claim, File), BusError> {
        self.check_reserved_files()?;
        let deadline = Instant::now() + OWNER_EXIT_TIMEOUT;
        // An owner removes the shared-state file when it ends. If that happened before the file was
        // locked here, the locked file is stale, and the next iteration opens the new one.
        for _ in 0..1000 {
            let file = self.open_shared_state(create)?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < deadline => {
                    std::thread::sleep(POLL_INTERVAL);
                    continue;
                }
                Err(rustix::io::Errno::WOULDBLOCK) => {
                    return Err(BusError::NameInUse { name: self.name.clone(), hint: owner_hint(&file) });
                }
                Err(cause) => return Err(self.shared_state_error("locking", cause.into())),
            }
            if !is_same_file(&file, &self.shared_state_path()) {
                continue;
            }
            let is_new = file.metadata().is_ok_and(|metadata| metadata.len() == 0);
            let result = self.take_over(&file, members_limit);
            if result.is_err() && is_new {
                // The file was created just now, so it does not belong to an earlier run and can be
                // removed.
                let _ = fs::remove_file(self.shared_state_path());
            }
            return result.map(|members_lock| (Claim { system_name: self.clone(), lock: file }, members_lock));
        }
        Err(self.shared_state_error("locking", io::Error::other("it kept disappearing")))
    }

    /// Takes ownership: records a new run of the system in the locked file. Returns a lock that
    /// prevents other processes from joining.
    fn take_over(&self, file: &File, members_limit: Duration) -> Result<File, BusError> {
        file.set_len(SHARED_STATE_BYTES as u64).map_err(|cause| self.shared_state_error("sizing", cause))?;
        let state = SharedState::map(file).map_err(|cause| self.shared_state_error("mapping", cause))?;
        state.set_owner_pid(std::process::id());
        let members_lock = self.wait_for_members(members_limit)?;
        state.start_run();
        self.remove_files();
        Ok(members_lock)
    }

    /// Returns the process ID of the name's owner, or `None` if the name has no owner.
    ///
    /// The result is 0 if the owner has not recorded its process ID yet.
    pub fn owner_pid(&self) -> Result<Option<u32>, BusError> {
        let file = match self.open_shared_state(false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other?,
        };
        match flock(&file, FlockOperation::NonBlockingLockShared) {
            Ok(()) => Ok(None),
            Err(rustix::io::Errno::WOULDBLOCK) => {
                Ok(Some(SharedState::map(&file).map_or(0, |state| state.owner_pid())))
            }
            Err(cause) => Err(self.shared_state_error("locking", cause.into())),
        }
    }

    pub(crate) fn shared_state(&self) -> Result<SharedState, BusError> {
        let file = match self.open_shared_state(false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => {
                return Err(self.absence_error());
            }
            other => other?,
        };
        SharedState::map(&file).map_err(|cause| self.shared_state_error("mapping", cause))
    }

    /// Registers as a member of the system. While the returned file is held, no later owner can
    /// remove the system's files.
    pub(crate) fn lock_members(&self) -> Result<File, BusError> {
        let file = owned_files::open_file(&self.members_path(), true)?;
        match flock(&file, FlockOperation::LockShared) {
            Ok(()) => Ok(file),
            Err(cause) => Err(BusError::File { doing: "locking", path: self.members_path(), cause: cause.into() }),
        }
    }

    /// Registers briefly as a member of the system, provided that the system is running.
    ///
    /// While the returned file is held, no later owner can remove the system's files.
    pub(crate) fn lock_running(&self) -> Result<File, BusError> {
        let file = match owned_files::open_file(&self.members_path(), false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => {
                return Err(self.absence_error());
            }
            other => other?,
        };
        let deadline = Instant::now() + OBSERVERS_TIMEOUT;
        while flock(&file, FlockOperation::NonBlockingLockShared).is_err() {
            if Instant::now() > deadline {
                return Err(self.absence_error());
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        Some(file).filter(|file| is_same_file(file, &self.members_path())).ok_or_else(|| self.absence_error())
    }

    /// Waits until the services of a previous owner have exited. Without this wait, they could
    /// remove files that the new owner has created under the same names.
    fn wait_for_members(&self, timeout: Duration) -> Result<File, BusError> {
        let file = owned_files::open_file(&self.members_path(), true)?;
        let deadline = Instant::now() + timeout;
        while flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            if Instant::now() > deadline {
                return Err(BusError::Lingering { name: self.name.clone() });
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(file)
    }

    pub(crate) fn config(&self) -> Config {
        let mut config = Config::default();
        // The name was checked in `new`, so neither conversion fails.
        if let Ok(prefix) = FileName::new(self.prefix().as_bytes()) {
            config.global.prefix = prefix;
        }
        if let Ok(root) = IoxPath::new(self.root().as_os_str().as_encoded_bytes()) {
            config.global.set_root_path(&root);
        }
        // The supervisor cleans up after killed processes. A cleanup would delay any other process.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        // iceoryx2 scans this buffer for each message that it receives. The default capacity of 128
        // is more than needed.
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = MAX_SERVICE_PORTS;
        config
    }

    pub(crate) fn prefix(&self) -> String {
        format!("{NAME_PREFIX}{}.", self.name)
    }

    /// Returns the root folder for iceoryx2. It is in memory, because iceoryx2 syncs each new file,
    /// which would delay every start by tens of milliseconds on a disk.
    pub(crate) fn root(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{NAME_PREFIX}{}", self.name))
    }

    /// Returns the path of the control socket of the system.
    ///
    /// # Errors
    ///
    /// Fails if the system's folder does not exist, belongs to another user or is accessible to
    /// others.
    pub fn control_socket_path(&self) -> Result<PathBuf, BusError> {
        owned_files::check_folder(&self.root())?;
        Ok(self.root().join("control"))
    }

    /// Returns the path of the file with the shared state of the system.
    pub fn shared_state_path(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(self.prefix() + "wake")
    }

    pub(crate) fn members_path(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(self.prefix() + "members")
    }

    fn shared_state_error(&self, doing: &'static str, cause: io::Error) -> BusError {
        BusError::File { doing, path: self.shared_state_path(), cause }
    }

    fn open_shared_state(&self, create: bool) -> Result<File, BusError> {
        owned_files::open_file(&self.shared_state_path(), create)
    }

    /// Opens the lock file of the observer with this number, which is less than `MAX_OBSERVERS`.
    pub(crate) fn open_observer_lock(&self, number: usize) -> Result<File, BusError> {
        owned_files::open_file(&self.observer_lock_path(number), true)
    }

    pub(crate) fn observer_lock_path(&self, number: usize) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{}observer.{number}", self.prefix()))
    }

    /// Removes every file of the system except its locks. The caller must own the name, and no
    /// service may be running.
    fn remove_files(&self) {
        let kept = [self.shared_state_path(), self.members_path(), self.root()];
        for path in self.files().iter().filter(|path| !kept.contains(path)) {
            // If a file cannot be removed, the error is reported when the file is created again.
            let _ = fs::remove_file(path);
        }
        let _ = fs::remove_dir_all(self.root());
    }
}

/// Ownership of a system name. Dropping it removes all files with that name, so drop it only after
/// the last service has exited.
#[derive(Debug)]
pub struct Claim {
    system_name: SystemName,
    lock: File,
}

impl Claim {
    /// Returns the owned name.
    pub fn system_name(&self) -> &SystemName {
        &self.system_name
    }

    /// Returns the process ID in the shared state, or `None` if the file was truncated.
    pub(crate) fn owner_pid(&self) -> Option<u32> {
        SharedState::map(&self.lock).ok().map(|state| state.owner_pid())
    }

    /// Releases the name and claims it again after the files were removed or damaged.
    ///
    /// The next tick of each topic is kept; the rest of the shared state is reset. The caller must
    /// ensure that no process has a bus resource open.
    ///
    /// # Errors
    ///
    /// Fails like [`SystemName::claim`].
    pub fn renew(self) -> Result<Self, BusError> {
        let system_name = self.system_name.clone();
        let map =
            |file: &File| SharedState::map(file).map_err(|cause| system_name.shared_state_error("mapping", cause));
        let previous = map(&self.lock)?;
        drop(self);
        let claim = system_name.claim()?;
        map(&claim.lock)?.copy_ticks_from(&previous);
        Ok(claim)
    }

    /// Returns `true` if the files were removed and another process has since claimed the name.
    fn is_superseded(&self) -> bool {
        let page_path = self.system_name.shared_state_path();
        page_path.exists() && !is_same_file(&self.lock, &page_path)
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if self.is_superseded() {
            return;
        }
        let _members_lock = self.system_name.wait_for_members(OBSERVERS_TIMEOUT);
        self.system_name.remove_files();
        let _ = fs::remove_file(self.system_name.members_path());
        let _ = fs::remove_file(self.system_name.shared_state_path());
    }
}

/// Returns `true` if the open file is the one that now exists at `path`.
fn is_same_file(file: &File, path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|at_path| file.metadata().is_ok_and(|held| held.ino() == at_path.ino()))
}

/// Returns the identity of the process that holds the file, if recorded, and how to stop it.
fn owner_hint(file: &File) -> String {
    let deadline = Instant::now() + OWNER_START_TIMEOUT;
    loop {
        match SharedState::map(file).map(|state| state.owner_pid()) {
            Ok(pid) if pid != 0 => return format!(" (process {pid}); stop it (kill {pid})"),
            _ if Instant::now() > deadline => return "; stop it".into(),
            _ => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}
