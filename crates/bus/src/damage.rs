//! Whether the files of a running system are still at their places: who starts finds the others by them.

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use crate::{SystemName, system_name::LOOK};

/// As the kernel marks the name of an open file that was removed.
pub(crate) const REMOVED: &str = " (deleted)";
const WRITABLE: u32 = 0o200;

impl SystemName {
    /// A file that one of these processes of a running system has open and somebody has removed.
    pub fn removed(&self, pids: &[u32]) -> Option<PathBuf> {
        let look = |pid: &u32| {
            let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
            open.filter_map(|fd| self.removed_at(&fd.path())).next()
        };
        // What is just being cleaned up is closed at the next look.
        pids.iter().find_map(look)?;
        std::thread::sleep(LOOK);
        pids.iter().find_map(look)
    }

    fn removed_at(&self, fd: &Path) -> Option<PathBuf> {
        let target = fs::read_link(fd).ok()?;
        let path = PathBuf::from(target.to_str()?.strip_suffix(REMOVED)?);
        let carries_name = path.starts_with(self.root())
            || path.to_str()?.strip_prefix(self.root().to_str()?).is_some_and(|rest| rest.starts_with('.'));
        let lasts = match path.extension()?.to_str()? {
            // It goes with either of its ends.
            "connection" => false,
            // That of a publisher goes with it, and its readers have it open for a while.
            "data" => fs::symlink_metadata(fd).ok()?.permissions().mode() & WRITABLE != 0,
            _ => !path.starts_with(self.root().join("nodes")),
        };
        Some(path).filter(|_| carries_name && lasts)
    }
}
