//! Reads and writes a small file at a path that other users may have tampered with.

use std::{
    fs::{self, DirBuilder, File, OpenOptions},
    io::{self, ErrorKind, Read, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt},
    path::Path,
};

use rustix::process::geteuid;

/// Maximum number of bytes read, many times the size of a state file.
const MAX_FILE_BYTES: u64 = 16 << 10;
/// Write permissions of group and others.
const GROUP_OTHER_WRITE: u32 = 0o022;

/// Reason why a file is not read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileError {
    #[error("it is a symbolic link; links are not followed")]
    SymbolicLink,
    #[error("it is not a regular file")]
    NotRegular,
    #[error("it belongs to user {0}, but this process runs as user {1}")]
    OtherOwner(u32, u32),
    #[error("it is writable by other users; if it is yours: chmod 600")]
    WritableByOthers,
    #[error("cannot read it: {0}")]
    Io(#[from] io::Error),
}

/// Returns the text of a file that only this user may write, or `None` if the file does not exist.
///
/// # Errors
///
/// Returns an error if the file is a link, not a regular file, or writable by another user.
pub(crate) fn read(path: &Path) -> Result<Option<String>, FileError> {
    // Opening a pipe must not block.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) if error.raw_os_error() == Some(libc::ELOOP) => return Err(FileError::SymbolicLink),
        opened => opened?,
    };
    let (metadata, own) = (file.metadata()?, geteuid().as_raw());
    if !metadata.is_file() {
        return Err(FileError::NotRegular);
    }
    if metadata.uid() != own {
        return Err(FileError::OtherOwner(metadata.uid(), own));
    }
    if metadata.mode() & GROUP_OTHER_WRITE != 0 {
        return Err(FileError::WritableByOthers);
    }
    let mut bytes = Vec::new();
    file.take(MAX_FILE_BYTES).read_to_end(&mut bytes)?;
    Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
}

/// Writes a file that only this user may read.
///
/// The file is replaced atomically. Even after a power failure, a reader finds either the old or
/// the new text.
pub(crate) fn write(path: &Path, text: &str) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    // A killed process may have left the temporary file.
    match fs::remove_file(&temporary) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&temporary)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&temporary, path)?;
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    use super::*;

    #[test]
    fn written_file_is_readable_by_owner_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper/imu.state");
        assert!(matches!(read(&path), Ok(None)));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(folder.path().join("deeper/imu.state.new"), "left by a killed process").unwrap();
        for text in ["one", "another, longer", ""] {
            write(&path, text).unwrap();
            assert_eq!(read(&path).unwrap().unwrap(), text);
        }
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o600);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn foreign_or_irregular_file_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("imu.state");
        let own = folder.path().join("own");
        write(&own, "mine").unwrap();
        symlink(&own, &path).unwrap();
        assert!(matches!(read(&path), Err(FileError::SymbolicLink)));
        assert!(matches!(read(folder.path()), Err(FileError::NotRegular)));
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(matches!(read(&pipe), Err(FileError::NotRegular)));
        fs::set_permissions(&own, fs::Permissions::from_mode(0o620)).unwrap();
        assert!(matches!(read(&own), Err(FileError::WritableByOthers)));
        // Only root can change the owner of a file. If the test does not run as root, it uses a
        // file that root owns.
        let theirs = if geteuid().is_root() {
            fs::set_permissions(&own, fs::Permissions::from_mode(0o600)).unwrap();
            chown(&own, Some(12_345), None).unwrap();
            own
        } else {
            "/etc/passwd".into()
        };
        assert!(matches!(read(&theirs), Err(FileError::OtherOwner(..))));
    }

    #[test]
    fn link_at_temporary_path_is_replaced_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, target) = (folder.path().join("imu.state"), folder.path().join("target"));
        fs::write(&target, "theirs").unwrap();
        symlink(&target, folder.path().join("imu.state.new")).unwrap();
        write(&path, "mine").unwrap();
        assert_eq!(fs::read_to_string(&target).unwrap(), "theirs");
        assert_eq!(read(&path).unwrap().unwrap(), "mine");
    }
}
