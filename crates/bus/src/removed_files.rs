//! Detects removed files of a running system. Once a file is missing, new processes cannot join.

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use crate::{SystemName, system_name::POLL_INTERVAL};

/// Suffix with which the kernel marks the path of an open file that was removed.
pub(crate) const DELETED_SUFFIX: &str = " (deleted)";
pub(crate) const OWNER_WRITABLE: u32 = 0o200;

impl SystemName {
    /// Returns a removed file of the system that one of the processes still has open.
    pub fn removed_file(&self, pids: &[u32]) -> Option<PathBuf> {
        let find = |pid: &u32| {
            let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
            open.filter_map(|fd| self.removed_target(&fd.path())).next()
        };
        // The first check may find a file that is being cleaned up and is open only for that
        // purpose. By the second check such a file has been closed.
        pids.iter().find_map(find)?;
        std::thread::sleep(POLL_INTERVAL);
        pids.iter().find_map(find)
    }

    fn removed_target(&self, fd: &Path) -> Option<PathBuf> {
        let target = fs::read_link(fd).ok()?;
        let path = PathBuf::from(target.to_str()?.strip_suffix(DELETED_SUFFIX)?);
        let is_of_system = path.starts_with(self.root())
            || path.to_str()?.strip_prefix(self.root().to_str()?).is_some_and(|rest| rest.starts_with('.'));
        let is_permanent = match path.extension()?.to_str()? {
            // Not a fault: a connection file is removed as soon as one of its two ports is closed.
            "connection" => false,
            // The data file of a publisher is removed with the publisher, but subscribers keep it
            // open for reading for a while. A removed data file is a fault only if it is open for
            // writing.
            "data" => fs::symlink_metadata(fd).ok()?.permissions().mode() & OWNER_WRITABLE != 0,
            _ => !path.starts_with(self.root().join("nodes")),
        };
        Some(path).filter(|_| is_of_system && is_permanent)
    }
}
