//! A small file in a place where anybody may have put something else.

use std::{
    fs::{self, DirBuilder, File, OpenOptions},
    io::{self, ErrorKind, Read, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt},
    path::Path,
};

use rustix::process::geteuid;

/// Most that is read: many times what a state has.
const BYTES_MAX: u64 = 16 << 10;
/// Write permission of the group and of all others.
const OTHERS_WRITE: u32 = 0o022;

/// Why a file is not read.
#[derive(Debug, thiserror::Error)]
pub(super) enum FileError {
    #[error("it is a symbolic link, which is not followed")]
    Link,
    #[error("it is no regular file")]
    Kind,
    #[error("it belongs to the user {0}, and this is {1}")]
    Owner(u32, u32),
    #[error("others may write to it; if it is yours: chmod 600")]
    Writable,
    #[error("it cannot be read: {0}")]
    Io(#[from] io::Error),
}

/// The text of a file that is this user's alone to write; nothing where there is none.
pub(super) fn read(path: &Path) -> Result<Option<String>, FileError> {
    // One that is a pipe must not be waited for.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) if error.raw_os_error() == Some(libc::ELOOP) => return Err(FileError::Link),
        opened => opened?,
    };
    let (found, own) = (file.metadata()?, geteuid().as_raw());
    if !found.is_file() {
        return Err(FileError::Kind);
    }
    if found.uid() != own {
        return Err(FileError::Owner(found.uid(), own));
    }
    if found.mode() & OTHERS_WRITE != 0 {
        return Err(FileError::Writable);
    }
    let mut bytes = Vec::new();
    file.take(BYTES_MAX).read_to_end(&mut bytes)?;
    Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
}

/// Writes a file that only this user may read. Whoever reads it, and whenever the power fails, finds the old text or the new one.
pub(super) fn write(path: &Path, text: &str) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    // What an incarnation that was killed has left there.
    match fs::remove_file(&beside) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&beside)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&beside, path)?;
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    use super::*;

    #[test]
    fn what_is_written_is_read_and_is_the_owners_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper/imu.state");
        assert!(matches!(read(&path), Ok(None)));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(folder.path().join("deeper/imu.state.new"), "left by an incarnation that was killed").unwrap();
        for text in ["one", "another, longer", ""] {
            write(&path, text).unwrap();
            assert_eq!(read(&path).unwrap().unwrap(), text);
        }
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o600);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_not_this_users_own_regular_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("imu.state");
        let own = folder.path().join("own");
        write(&own, "mine").unwrap();
        symlink(&own, &path).unwrap();
        assert!(matches!(read(&path), Err(FileError::Link)));
        assert!(matches!(read(folder.path()), Err(FileError::Kind)));
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(matches!(read(&pipe), Err(FileError::Kind)));
        fs::set_permissions(&own, fs::Permissions::from_mode(0o620)).unwrap();
        assert!(matches!(read(&own), Err(FileError::Writable)));
        // Only root can give a file away; everybody else finds one that is root's.
        let theirs = if geteuid().is_root() {
            fs::set_permissions(&own, fs::Permissions::from_mode(0o600)).unwrap();
            chown(&own, Some(12_345), None).unwrap();
            own
        } else {
            "/etc/passwd".into()
        };
        assert!(matches!(read(&theirs), Err(FileError::Owner(..))));
    }

    #[test]
    fn a_link_in_the_way_of_what_is_written_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, target) = (folder.path().join("imu.state"), folder.path().join("target"));
        fs::write(&target, "theirs").unwrap();
        symlink(&target, folder.path().join("imu.state.new")).unwrap();
        write(&path, "mine").unwrap();
        assert_eq!(fs::read_to_string(&target).unwrap(), "theirs");
        assert_eq!(read(&path).unwrap().unwrap(), "mine");
    }
}
