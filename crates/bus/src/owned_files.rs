//! Files and folders that only this user can access, in a folder that is world-writable.
//!
//! Input: a path.
//!
//! Output: the opened file, or the result of the check.
//!
//! Failure: symbolic links are not followed. A file of an unexpected type, one that belongs to
//! another user, or one that is accessible to others is reported and left unchanged.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::Path,
};

use rustix::{
    fs::{Mode, OFlags, mkdir, open},
    io::Errno,
    process::geteuid,
};

use crate::BusError;

/// Permission bits for the group and for others.
const GROUP_AND_OTHERS: u32 = 0o077;

/// Opens a file for reading and writing. With `create` it is created if missing.
pub(crate) fn open_file(path: &Path, create: bool) -> Result<File, BusError> {
    let create = if create { OFlags::CREATE } else { OFlags::empty() };
    // `NONBLOCK` prevents `open` from blocking if the path is a named pipe.
    let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC | create;
    match open(path, flags, Mode::RUSR | Mode::WUSR) {
        Ok(opened) => {
            let file = File::from(opened);
            let found = file.metadata().map_err(|cause| failed("inspecting", path, cause))?;
            check_access(path, &found, "file", found.is_file()).map(|()| file)
        }
        Err(Errno::NOENT) => Err(failed("opening", path, Errno::NOENT.into())),
        Err(cause) => {
            // The type and owner of the existing file explain the failure better than the error
            // from `open`.
            let found = fs::symlink_metadata(path).map_err(|cause| failed("inspecting", path, cause))?;
            check_access(path, &found, "file", found.is_file())?;
            Err(failed("opening", path, cause.into()))
        }
    }
}

/// Creates a folder if it is missing. Other users cannot replace it, because `/dev/shm` is sticky.
pub(crate) fn create_folder(path: &Path) -> Result<(), BusError> {
    match mkdir(path, Mode::RWXU) {
        Ok(()) | Err(Errno::EXIST) => check_folder(path),
        Err(cause) => Err(failed("creating", path, cause.into())),
    }
}

/// Checks that the path is a folder that only this user can access.
pub(crate) fn check_folder(path: &Path) -> Result<(), BusError> {
    let found = fs::symlink_metadata(path).map_err(|cause| failed("inspecting", path, cause))?;
    check_access(path, &found, "folder", found.is_dir())
}

/// Checks that a file of any type belongs to this user. A missing file is accepted.
pub(crate) fn check_owner(path: &Path) -> Result<(), BusError> {
    match fs::symlink_metadata(path) {
        Ok(found) => check_uid(path, &found),
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(cause) => Err(failed("inspecting", path, cause)),
    }
}

fn check_access(path: &Path, found: &fs::Metadata, kind: &str, is_kind: bool) -> Result<(), BusError> {
    if !is_kind {
        return Err(foreign_file(path, format!("it is {}, not a {kind}", kind_of(found)), found));
    }
    check_uid(path, found)?;
    if found.mode() & GROUP_AND_OTHERS != 0 {
        return Err(foreign_file(
            path,
            format!("it is accessible to other users (mode {:o})", found.mode() & 0o7777),
            found,
        ));
    }
    if found.is_file() && found.nlink() > 1 {
        return Err(foreign_file(path, "it has a second name (a hard link)".into(), found));
    }
    Ok(())
}

fn check_uid(path: &Path, found: &fs::Metadata) -> Result<(), BusError> {
    let own_uid = geteuid().as_raw();
    if found.uid() == own_uid {
        return Ok(());
    }
    Err(foreign_file(path, format!("it belongs to user {}, not to user {own_uid}", found.uid()), found))
}

fn foreign_file(path: &Path, why: String, found: &fs::Metadata) -> BusError {
    let hint = match found.uid() {
        uid if uid == geteuid().as_raw() => String::new(),
        uid => {
            format!("if that user's system is running, run plumb as that user (sudo -u '#{uid}' plumb …); otherwise ")
        }
    };
    BusError::ForeignFile { path: path.into(), why, hint }
}

fn kind_of(found: &fs::Metadata) -> &'static str {
    let kind = found.file_type();
    match () {
        () if kind.is_symlink() => "a symbolic link",
        () if kind.is_dir() => "a folder",
        () if kind.is_fifo() => "a named pipe",
        () if kind.is_socket() => "a socket",
        () if kind.is_file() => "a file",
        () => "a device",
    }
}

fn failed(doing: &'static str, path: &Path, cause: io::Error) -> BusError {
    BusError::File { doing, path: path.into(), cause }
}
