//! Finds and removes files that systems have left on this machine.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use iceoryx2::{
    node::{Node, NodeState},
    prelude::{CallbackProgression, LogLevel, ipc, set_log_level},
};

use crate::{
    BusError, MAX_OBSERVERS, Port, SystemName,
    limits::SHARED_MEMORY,
    owned_files,
    removed_files::DELETED_SUFFIX,
    session::list_processes,
    system_name::{NAME_PREFIX, OWNER_START_TIMEOUT, POLL_INTERVAL},
};

/// Extensions of the segments with predictable names: the state of a topic, and the number of
/// nodes.
const RESERVED_KINDS: [&str; 2] = ["dynamic", "global_mgmt"];

/// Longest time between the creation of a segment and the setting of its size. A creator can lose
/// the processor in between.
const CREATION_TIMEOUT: Duration = Duration::from_secs(2);

/// Files of one system and their state.
#[derive(Debug)]
pub struct StaleResources {
    /// System name.
    pub system_name: SystemName,
    /// Liveness of the system.
    pub liveness: SystemLiveness,
    /// All files and folders of the system.
    pub files: Vec<PathBuf>,
    /// Killed processes that are still registered on the system's bus.
    pub dead: Vec<Port>,
    /// Segment without a size. Opening the segment's topic would block until it has one.
    pub incomplete_segment: Option<PathBuf>,
}

/// Liveness of a system.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SystemLiveness {
    /// The system runs under a supervisor.
    Running {
        /// Process ID of the supervisor; 0 if not recorded yet.
        pid: u32,
    },
    /// The system is running, but its files were removed, so no process can join.
    Unreachable {
        /// Process IDs of the system.
        pids: Vec<u32>,
    },
    /// The supervisor has ended, but other processes of the system have not.
    Lingering {
        /// Process IDs of the remaining processes.
        pids: Vec<u32>,
    },
    /// No process is left.
    Dead,
}

impl StaleResources {
    /// Returns every system with files on this machine. A system of another user yields an error.
    pub fn all() -> Vec<Result<Self, BusError>> {
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let file_names = entries.map(|entry| entry.file_name());
        let named = file_names.filter_map(|file| {
            let file = file.to_str()?.strip_prefix(NAME_PREFIX)?;
            Some(file.split_once('.').map_or(file, |(name, _)| name).to_owned())
        });
        let names: BTreeSet<String> = named.collect();
        names.iter().filter_map(|name| Some(Self::for_system(&SystemName::new(name).ok()?))).collect()
    }

    /// Returns the files of one system.
    ///
    /// # Errors
    ///
    /// Fails if a file belongs to another user.
    pub fn for_system(system_name: &SystemName) -> Result<Self, BusError> {
        system_name.check_reserved_files()?;
        let files = system_name.files();
        let liveness = match system_name.owner_pid()? {
            Some(pid) => SystemLiveness::Running { pid },
            None => match (system_name.processes_without_files(), pids_with_open(&system_name.members_path())) {
                (pids, _) if !pids.is_empty() => SystemLiveness::Unreachable { pids },
                (_, pids) if !pids.is_empty() => SystemLiveness::Lingering { pids },
                _ => SystemLiveness::Dead,
            },
        };
        set_log_level(LogLevel::Fatal);
        let mut dead = if files.is_empty() { Vec::new() } else { list_processes(system_name, &system_name.config())? };
        dead.retain(|(_, port)| !port.alive);
        let dead = dead.into_iter().map(|(_, port)| port).collect();
        Ok(Self {
            system_name: system_name.clone(),
            liveness,
            files,
            dead,
            incomplete_segment: system_name.incomplete_segment(),
        })
    }

    /// Removes all files of a dead system, or the leftovers of killed processes of a running one.
    ///
    /// # Errors
    ///
    /// Fails if the system is unreachable or processes without a supervisor are still running.
    pub fn remove(&self) -> Result<(), BusError> {
        match self.liveness {
            // Claiming the name and releasing it again removes all files of the system.
            SystemLiveness::Dead => self.system_name.claim_within(Duration::ZERO).map(drop),
            SystemLiveness::Running { .. } => {
                let _lock = self.system_name.lock_running()?;
                self.system_name.remove_dead_nodes()
            }
            SystemLiveness::Unreachable { .. } => Err(self.system_name.absence_error()),
            SystemLiveness::Lingering { .. } => Err(BusError::Lingering { name: self.system_name.name().into() }),
        }
    }
}

impl SystemName {
    /// Removes the resources that killed processes have left on the bus of a running system.
    ///
    /// # Errors
    ///
    /// Fails if the bus cannot be listed or a resource cannot be removed.
    pub fn remove_dead_nodes(&self) -> Result<(), BusError> {
        let failed = |cause| BusError::Node { name: self.name().into(), cause };
        let mut left = None;
        Node::<ipc::Service>::list(&self.config(), |node| {
            if let NodeState::Dead(view) = node {
                left = view.try_remove_stale_resources().err().or(left);
            }
            CallbackProgression::Continue
        })
        .map_err(|cause| failed(format!("listing processes: {cause:?}")))?;
        left.map_or(Ok(()), |cause| Err(failed(format!("cleaning up after a killed process: {cause:?}"))))
    }

    /// Returns the error that explains why no process can join.
    pub(crate) fn absence_error(&self) -> BusError {
        let name = self.name().into();
        match self.processes_without_files() {
            pids if pids.is_empty() => BusError::NotRunning { name },
            pids => BusError::FilesRemoved { name, pids },
        }
    }

    /// Returns the IDs of the processes that still run although the files of their system were
    /// removed.
    fn processes_without_files(&self) -> Vec<u32> {
        let mut removed = self.members_path().into_os_string();
        removed.push(DELETED_SUFFIX);
        pids_with_open(Path::new(&removed))
    }

    /// Returns the process IDs of the observers.
    pub(crate) fn observer_pids(&self) -> Vec<u32> {
        (0..MAX_OBSERVERS).flat_map(|number| pids_with_open(&self.observer_lock_path(number))).collect()
    }

    /// Returns all files and folders of the system, without those that other users have created
    /// under its name.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        self.entries().into_iter().filter(|path| owned_files::check_owner(path).is_ok()).collect()
    }

    /// Checks that no other user has created a file under a fixed name that the system uses.
    ///
    /// All other files of the system have random names and are only created if they do not exist.
    pub(crate) fn check_reserved_files(&self) -> Result<(), BusError> {
        let locks = [self.shared_state_path(), self.members_path(), self.root()];
        let observers: Vec<_> = (0..MAX_OBSERVERS).map(|number| self.observer_lock_path(number)).collect();
        let is_reserved = |path: &PathBuf| {
            locks.contains(path)
                || observers.contains(path)
                || path.extension().is_some_and(|kind| RESERVED_KINDS.iter().any(|reserved| kind == *reserved))
        };
        self.entries().iter().filter(|path| is_reserved(path)).try_for_each(|path| owned_files::check_owner(path))
    }

    /// Returns the files and folders of all users that carry the name of the system.
    pub(crate) fn entries(&self) -> Vec<PathBuf> {
        let prefix = self.prefix();
        let segments = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let named = segments.filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix));
        let folder = Some(self.root()).filter(|root| fs::symlink_metadata(root).is_ok());
        named.map(|entry| entry.path()).chain(folder).collect()
    }

    /// Removes the empty connections of killed processes. No other port uses them.
    ///
    /// A process that creates a connection keeps it open until the connection has a size.
    pub(crate) fn remove_incomplete_connections(&self) {
        let is_empty = |path: &&PathBuf| {
            path.extension().is_some_and(|kind| kind == "connection")
                && fs::symlink_metadata(path).is_ok_and(|connection| connection.len() == 0)
        };
        for path in self.files().iter().filter(is_empty) {
            // The creator may have set the size and closed the file in the meantime.
            if pids_with_open(path).is_empty() && is_empty(&path) {
                // An error is ignored: the file is then reported as an incomplete segment.
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Returns a segment without a size, if there is one.
    ///
    /// The creator of the segment was killed before it set the size, or has not done so for
    /// [`CREATION_TIMEOUT`]. Opening such a segment would block until the size is set.
    pub(crate) fn incomplete_segment(&self) -> Option<PathBuf> {
        let is_empty = |path: &PathBuf| {
            let made = path.extension().is_some_and(|kind| kind == "dynamic" || kind == "connection" || kind == "data");
            made && fs::symlink_metadata(path).is_ok_and(|segment| segment.len() == 0)
        };
        // The creator keeps the segment open until it has set the size.
        let is_abandoned = |path: &PathBuf| pids_with_open(path).is_empty() && is_empty(path);
        let mut suspects: Vec<_> = self.files().into_iter().filter(is_empty).collect();
        let start = Instant::now();
        // A segment that is still being created has a size at one of the next checks.
        while !suspects.is_empty() && start.elapsed() < CREATION_TIMEOUT {
            std::thread::sleep(POLL_INTERVAL);
            suspects.retain(is_empty);
            if start.elapsed() >= OWNER_START_TIMEOUT
                && let Some(index) = suspects.iter().position(is_abandoned)
            {
                return Some(suspects.swap_remove(index));
            }
        }
        suspects.pop()
    }
}

/// Returns the IDs of this user's processes that have `file` open.
fn pids_with_open(file: &Path) -> Vec<u32> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let holds = |pid: &u32| {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        *pid != std::process::id()
            && open.filter_map(|entry| fs::read_link(entry.path()).ok()).any(|target| target == file)
    };
    pids.filter(holds).collect()
}
