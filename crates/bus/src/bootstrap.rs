//! Creates the folder and the node segment that a system needs before its first member joins.
//!
//! Input: a claimed name without members.
//!
//! Output: a folder and the segment in which iceoryx2 counts nodes, accessible to this user only.
//!
//! Failure: every error is returned to the caller. Other users can write to the segment for a short
//! time, before it is replaced as described below. Such a write can prevent the start of the
//! system, but does no other harm.
//!
//! iceoryx2 creates the node segment readable and writable for every user, regardless of the umask,
//! and accepts an existing segment unchanged. Therefore the segment is created once and then
//! replaced by a private copy before any other process joins.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use crate::{BusError, SystemName, owned_files, topic};

/// Upper bound of the segment size, bytes.
const MAX_SEGMENT_BYTES: u64 = 4096;

impl SystemName {
    /// Creates the folder and the node segment of the bus.
    pub(crate) fn create_bus(&self) -> Result<(), BusError> {
        owned_files::create_folder(&self.root())?;
        self.create_first_node()?;
        let suffix = self.config().global.node.global_mgmt_suffix.to_string();
        let segments: Vec<PathBuf> =
            self.files().into_iter().filter(|path| path.to_string_lossy().ends_with(&suffix)).collect();
        for path in segments {
            replace(&path).map_err(|cause| BusError::File { doing: "restricting access to", path, cause })?;
        }
        // Creating a node again checks that iceoryx2 accepts the private copies.
        self.create_first_node()
    }

    fn create_first_node(&self) -> Result<(), BusError> {
        topic::create_node(self, "founder").map(drop)
    }
}

/// Replaces a file with a copy that only this user can access.
fn replace(path: &Path) -> io::Result<()> {
    let mut contents = Vec::new();
    File::open(path)?.take(MAX_SEGMENT_BYTES).read_to_end(&mut contents)?;
    fs::remove_file(path)?;
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?.write_all(&contents)
}
