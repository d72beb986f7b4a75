//! A system's name and everything that carries it: one running system per name, nothing left when it ends.

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
    BusError, owned_files,
    page::{PAGE_BYTES, Page},
};

/// Where the segments and the folders of every system are.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// How the names of all of them begin; a system's own name and a point follow.
pub(crate) const FAMILY: &str = "plumbline.";
/// How long the services of an earlier owner may take to end.
const MEMBERS_LIMIT: Duration = Duration::from_secs(5);
/// How long an owner that was killed may take until it holds nothing any more.
const DEATH_LIMIT: Duration = Duration::from_millis(500);
/// How long an owner may take to write down who it is, and whoever looks for one may hold its lock.
pub(crate) const OWNER_LIMIT: Duration = Duration::from_millis(100);
/// How long an owner that ends waits for observers who are just coming or going.
const OBSERVERS_LIMIT: Duration = Duration::from_millis(200);
/// Between two looks at a lock.
pub(crate) const LOOK: Duration = Duration::from_millis(2);

/// The name of a system: prefix of its shared memory, name of its folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemName {
    name: String,
}

impl SystemName {
    /// The name of a system: 1 to 32 of a-z, 0-9, - and _.
    pub fn new(name: &str) -> Result<Self, BusError> {
        let legal = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if name.is_empty() || name.len() > 32 || !name.chars().all(legal) {
            return Err(BusError::Name { name: name.into() });
        }
        Ok(Self { name: name.into() })
    }

    /// The system's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Makes this process the owner of the name; what an earlier owner left behind is removed.
    pub fn claim(&self) -> Result<Claim, BusError> {
        let (claim, alone) = self.own(MEMBERS_LIMIT, true)?;
        self.found()?;
        drop(alone);
        Ok(claim)
    }

    /// Only to remove what an earlier owner left behind, whose services may take so long to end.
    pub(crate) fn claim_within(&self, members_limit: Duration) -> Result<Claim, BusError> {
        self.own(members_limit, true).map(|(claim, _)| claim)
    }

    /// The same, where an earlier owner has left its page; who comes after another that has removed it makes none.
    pub(crate) fn claim_left(&self, members_limit: Duration) -> Result<Claim, BusError> {
        self.own(members_limit, false).map(|(claim, _)| claim)
    }

    /// The name, and a lock that keeps everybody from joining.
    fn own(&self, members_limit: Duration, create: bool) -> Result<(Claim, File), BusError> {
        self.files().iter().try_for_each(|path| owned_files::owner(path))?;
        let deadline = Instant::now() + DEATH_LIMIT;
        // The last owner removes the page when it ends; a page locked after that is nobody's, so look again.
        for _ in 0..1000 {
            let file = self.open_page(create)?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < deadline => {
                    std::thread::sleep(LOOK);
                    continue;
                }
                Err(rustix::io::Errno::WOULDBLOCK) => {
                    return Err(BusError::Taken { name: self.name.clone(), owner: owner(&file) });
                }
                Err(cause) => return Err(self.page_error("locking", cause.into())),
            }
            if !is_at(&file, &self.page_path()) {
                continue;
            }
            let is_new = file.metadata().is_ok_and(|page| page.len() == 0);
            let taken = self.take_over(&file, members_limit);
            if taken.is_err() && is_new {
                // No earlier run has left it, so nothing is found by it.
                let _ = fs::remove_file(self.page_path());
            }
            return taken.map(|alone| (Claim { system_name: self.clone(), lock: file }, alone));
        }
        Err(self.page_error("locking", io::Error::other("it kept disappearing")))
    }

    /// Begins a run under the page that is locked, with a lock that keeps everybody from joining.
    fn take_over(&self, page: &File, members_limit: Duration) -> Result<File, BusError> {
        page.set_len(PAGE_BYTES as u64).map_err(|cause| self.page_error("sizing", cause))?;
        let page = Page::map(page).map_err(|cause| self.page_error("mapping", cause))?;
        page.set_owner_pid(std::process::id());
        let alone = self.await_members(members_limit)?;
        page.begin_run();
        self.remove_remains();
        Ok(alone)
    }

    /// The process that owns the name, if one does; 0 while it has not said who it is.
    pub fn owner_pid(&self) -> Result<Option<u32>, BusError> {
        let file = match self.open_page(false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other?,
        };
        match flock(&file, FlockOperation::NonBlockingLockShared) {
            Ok(()) => Ok(None),
            Err(rustix::io::Errno::WOULDBLOCK) => Ok(Some(Page::map(&file).map_or(0, |page| page.owner_pid()))),
            Err(cause) => Err(self.page_error("locking", cause.into())),
        }
    }

    pub(crate) fn page(&self) -> Result<Page, BusError> {
        let file = match self.open_page(false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => {
                return Err(self.absent());
            }
            other => other?,
        };
        Page::map(&file).map_err(|cause| self.page_error("mapping", cause))
    }

    /// Takes part in the system: while the file is held, no later owner of the name clears it.
    pub(crate) fn take_part(&self) -> Result<File, BusError> {
        let file = owned_files::file(&self.members_path(), true)?;
        match flock(&file, FlockOperation::LockShared) {
            Ok(()) => Ok(file),
            Err(cause) => Err(BusError::File { doing: "locking", path: self.members_path(), cause: cause.into() }),
        }
    }

    /// As a service does, but only while the system runs: nothing of its name is removed while the file is held.
    pub(crate) fn step_in(&self) -> Result<File, BusError> {
        let file = match owned_files::file(&self.members_path(), false) {
            Err(BusError::File { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => return Err(self.absent()),
            other => other?,
        };
        let deadline = Instant::now() + OBSERVERS_LIMIT;
        while flock(&file, FlockOperation::NonBlockingLockShared).is_err() {
            if Instant::now() > deadline {
                return Err(self.absent());
            }
            std::thread::sleep(LOOK);
        }
        Some(file).filter(|file| is_at(file, &self.members_path())).ok_or_else(|| self.absent())
    }

    /// Waits until the services of an earlier owner have ended: they would remove what is made anew under their names.
    fn await_members(&self, limit: Duration) -> Result<File, BusError> {
        let file = owned_files::file(&self.members_path(), true)?;
        let deadline = Instant::now() + limit;
        while flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            if Instant::now() > deadline {
                return Err(BusError::Lingering { name: self.name.clone() });
            }
            std::thread::sleep(LOOK);
        }
        Ok(file)
    }

    pub(crate) fn config(&self) -> Config {
        let mut config = Config::default();
        // Names are checked in `new`, so both conversions hold.
        if let Ok(prefix) = FileName::new(self.prefix().as_bytes()) {
            config.global.prefix = prefix;
        }
        if let Ok(root) = IoxPath::new(self.root().as_os_str().as_encoded_bytes()) {
            config.global.set_root_path(&root);
        }
        // The supervisor clears away what the killed leave: nobody else waits for it.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config
    }

    pub(crate) fn prefix(&self) -> String {
        format!("{FAMILY}{}.", self.name)
    }

    /// In memory: iceoryx2 syncs each file that it makes, and a disk would hold up every start for tens of milliseconds.
    pub(crate) fn root(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{FAMILY}{}", self.name))
    }

    /// The socket at which the owner of the name answers questions; it goes with the name. Fails where the folder is not this user's
    /// alone, or not there.
    pub fn door(&self) -> Result<PathBuf, BusError> {
        owned_files::folder(&self.root())?;
        Ok(self.root().join("door"))
    }

    pub(crate) fn page_path(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(self.prefix() + "wake")
    }

    pub(crate) fn members_path(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(self.prefix() + "members")
    }

    fn page_error(&self, doing: &'static str, cause: io::Error) -> BusError {
        BusError::File { doing, path: self.page_path(), cause }
    }

    fn open_page(&self, create: bool) -> Result<File, BusError> {
        owned_files::file(&self.page_path(), create)
    }

    /// The place of an observer, to be locked by whoever sits in it.
    pub(crate) fn open_seat(&self, number: usize) -> Result<File, BusError> {
        owned_files::file(&self.seat_path(number), true)
    }

    pub(crate) fn seat_path(&self, number: usize) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{}seat.{number}", self.prefix()))
    }

    /// Removes every file that carries the name but those of its locks. Only the owner of the name may, when no service of it lives.
    fn remove_remains(&self) {
        let kept = [self.page_path(), self.members_path(), self.root()];
        for path in self.files().iter().filter(|path| !kept.contains(path)) {
            // What cannot be removed is somebody else's; making it anew will say so.
            let _ = fs::remove_file(path);
        }
        let _ = fs::remove_dir_all(self.root());
    }
}

/// Ownership of a system's name. When it is dropped nothing of the name remains; drop it after the last service has ended.
#[derive(Debug)]
pub struct Claim {
    system_name: SystemName,
    lock: File,
}

impl Claim {
    /// The name.
    pub fn system_name(&self) -> &SystemName {
        &self.system_name
    }

    /// Takes the name anew when somebody has removed its files: nothing of before is left but the ticks that the topics have had. No process
    /// may have anything open on the bus by then.
    pub fn renew(self) -> Result<Self, BusError> {
        let system_name = self.system_name.clone();
        let page = |file: &File| Page::map(file).map_err(|cause| system_name.page_error("mapping", cause));
        let earlier = page(&self.lock)?;
        drop(self);
        let claim = system_name.claim()?;
        page(&claim.lock)?.go_on_from(&earlier);
        Ok(claim)
    }

    /// Its files were removed, and another has taken the name since.
    fn is_superseded(&self) -> bool {
        let page_path = self.system_name.page_path();
        page_path.exists() && !is_at(&self.lock, &page_path)
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if self.is_superseded() {
            return;
        }
        let _alone = self.system_name.await_members(OBSERVERS_LIMIT);
        self.system_name.remove_remains();
        let _ = fs::remove_file(self.system_name.members_path());
        let _ = fs::remove_file(self.system_name.page_path());
    }
}

/// The open file is the one that is at the path.
fn is_at(file: &File, path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|at_path| file.metadata().is_ok_and(|held| held.ino() == at_path.ino()))
}

/// Who holds the page, as far as it has said so.
fn owner(page: &File) -> String {
    let deadline = Instant::now() + OWNER_LIMIT;
    loop {
        match Page::map(page).map(|page| page.owner_pid()) {
            Ok(pid) if pid != 0 => return format!(" (process {pid}); stop it (kill {pid})"),
            _ if Instant::now() > deadline => return "; stop it".into(),
            _ => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}
