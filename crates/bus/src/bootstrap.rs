//! What a system begins with: the folder of its bus, and the segment from which iceoryx2 counts the nodes.
//!
//! Input: a name that is claimed and has no members. Output: both, this user's alone. Time: none. Failure: said; a user who changes the
//! segment in the moment in which it is open to everybody keeps a system from starting, and no more.
//!
//! iceoryx2 makes that segment readable and writable for everybody, whatever the umask; whoever finds one uses it as it is. So one is
//! made, and another with the same contents takes its place before anybody else joins.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use crate::{BusError, SystemName, owned_files, topic};

/// More than the segment has, bytes.
const SEGMENT_MAX: u64 = 4096;

impl SystemName {
    /// Makes what members of the system need before the first of them joins.
    pub(crate) fn found(&self) -> Result<(), BusError> {
        owned_files::make_folder(&self.root())?;
        self.join_once()?;
        let suffix = self.config().global.node.global_mgmt_suffix.to_string();
        let open: Vec<PathBuf> =
            self.files().into_iter().filter(|path| path.to_string_lossy().ends_with(&suffix)).collect();
        for path in open {
            replace(&path).map_err(|cause| BusError::File { doing: "closing to other users", path, cause })?;
        }
        // It is what iceoryx2 expects.
        self.join_once()
    }

    fn join_once(&self) -> Result<(), BusError> {
        topic::node(self, "founder").map(drop)
    }
}

/// Puts a file of this user alone in the place of another with the same contents.
fn replace(path: &Path) -> io::Result<()> {
    let mut contents = Vec::new();
    File::open(path)?.take(SEGMENT_MAX).read_to_end(&mut contents)?;
    fs::remove_file(path)?;
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?.write_all(&contents)
}
