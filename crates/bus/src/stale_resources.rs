//! What systems leave behind on this machine, and what may be removed of it.

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
    BusError, OBSERVERS, Port, SystemName,
    damage::REMOVED,
    owned_files,
    system_name::{FAMILY, LOOK, OWNER_LIMIT, SHARED_MEMORY},
    visit::members,
};

/// The files of one system.
#[derive(Debug)]
pub struct StaleResources {
    /// The system.
    pub system_name: SystemName,
    /// Whether it lives.
    pub liveness: SystemLiveness,
    /// Every file and folder that carries its name.
    pub files: Vec<PathBuf>,
    /// Who has been killed and is still noted on its bus.
    pub dead: Vec<Port>,
    /// A segment whose maker was killed: whoever opens its topic waits for ever.
    pub half_made: Option<PathBuf>,
}

/// Whether a system lives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SystemLiveness {
    /// It runs under this supervisor.
    Runs {
        /// The supervisor's process; 0 while it has not said who it is.
        pid: u32,
    },
    /// It runs, and somebody has removed its files: nobody can join it.
    Unreachable {
        /// Its processes.
        pids: Vec<u32>,
    },
    /// Its supervisor has ended, these processes of it have not.
    Lingers {
        /// The processes.
        pids: Vec<u32>,
    },
    /// Nobody is left.
    Dead,
}

impl StaleResources {
    /// Every system of which there is anything on this machine; an error for each whose files are another user's.
    pub fn all() -> Vec<Result<Self, BusError>> {
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let file_names = entries.map(|entry| entry.file_name());
        let named = file_names.filter_map(|file| {
            let file = file.to_str()?.strip_prefix(FAMILY)?;
            Some(file.split_once('.').map_or(file, |(name, _)| name).to_owned())
        });
        let names: BTreeSet<String> = named.collect();
        names.iter().filter_map(|name| Some(Self::of(&SystemName::new(name).ok()?))).collect()
    }

    /// What there is of one system. Fails where its files are another user's.
    pub fn of(system_name: &SystemName) -> Result<Self, BusError> {
        let files = system_name.files();
        files.iter().try_for_each(|path| owned_files::owner(path))?;
        let liveness = match system_name.owner_pid()? {
            Some(pid) => SystemLiveness::Runs { pid },
            None => match (system_name.unreachable(), holders(&system_name.members_path())) {
                (pids, _) if !pids.is_empty() => SystemLiveness::Unreachable { pids },
                (_, pids) if !pids.is_empty() => SystemLiveness::Lingers { pids },
                _ => SystemLiveness::Dead,
            },
        };
        set_log_level(LogLevel::Fatal);
        let mut dead = if files.is_empty() { Vec::new() } else { members(system_name, &system_name.config())? };
        dead.retain(|(_, port)| !port.alive);
        let dead = dead.into_iter().map(|(_, port)| port).collect();
        Ok(Self { system_name: system_name.clone(), liveness, files, dead, half_made: system_name.half_made() })
    }

    /// Removes what nobody needs: of a dead system everything, of a living one what the killed left on its bus.
    pub fn clear(&self) -> Result<(), BusError> {
        match self.liveness {
            // Who owns the name for a moment removes everything of it at the end.
            SystemLiveness::Dead => self.system_name.claim_within(Duration::ZERO).map(drop),
            SystemLiveness::Runs { .. } => {
                let _inside = self.system_name.step_in()?;
                self.system_name.clean()
            }
            SystemLiveness::Unreachable { .. } => Err(self.system_name.absent()),
            SystemLiveness::Lingers { .. } => Err(BusError::Lingering { name: self.system_name.name().into() }),
        }
    }
}

impl SystemName {
    /// Removes what the killed have left on the bus of a system that runs.
    pub fn clean(&self) -> Result<(), BusError> {
        let failed = |cause| BusError::Node { name: self.name().into(), cause };
        let mut left = None;
        Node::<ipc::Service>::list(&self.config(), |node| {
            if let NodeState::Dead(view) = node {
                left = view.try_remove_stale_resources().err().or(left);
            }
            CallbackProgression::Continue
        })
        .map_err(|cause| failed(format!("listing who is there: {cause:?}")))?;
        left.map_or(Ok(()), |cause| Err(failed(format!("cleaning up after a killed process: {cause:?}"))))
    }

    /// Why nobody can join.
    pub(crate) fn absent(&self) -> BusError {
        let name = self.name().into();
        match self.unreachable() {
            pids if pids.is_empty() => BusError::NotRunning { name },
            pids => BusError::FilesRemoved { name, pids },
        }
    }

    /// The processes of a system whose files somebody has removed.
    fn unreachable(&self) -> Vec<u32> {
        let mut removed = self.members_path().into_os_string();
        removed.push(REMOVED);
        holders(Path::new(&removed))
    }

    /// The observers.
    pub(crate) fn seated(&self) -> Vec<u32> {
        (0..OBSERVERS).flat_map(|number| holders(&self.seat_path(number))).collect()
    }

    /// Every file and folder that carries the name.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        let prefix = self.prefix();
        let segments = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let own = segments.filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix));
        let folder = Some(self.root()).filter(|root| fs::symlink_metadata(root).is_ok());
        own.map(|entry| entry.path()).chain(folder).collect()
    }

    /// A segment whose maker was killed before it had a size: whoever opens it waits for ever.
    pub(crate) fn half_made(&self) -> Option<PathBuf> {
        let empty = |path: &PathBuf| {
            let made = path.extension().is_some_and(|kind| kind == "dynamic" || kind == "connection" || kind == "data");
            made && fs::symlink_metadata(path).is_ok_and(|segment| segment.len() == 0)
        };
        let mut suspects: Vec<_> = self.files().into_iter().filter(empty).collect();
        let deadline = Instant::now() + OWNER_LIMIT;
        // One that is just being made has a size at the next look.
        while !suspects.is_empty() && Instant::now() < deadline {
            std::thread::sleep(LOOK);
            suspects.retain(empty);
        }
        suspects.pop()
    }
}

/// The processes of this user that have a file open.
fn holders(file: &Path) -> Vec<u32> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let holds = |pid: &u32| {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        *pid != std::process::id()
            && open.filter_map(|entry| fs::read_link(entry.path()).ok()).any(|target| target == file)
    };
    pids.filter(holds).collect()
}
