//! Files and folders of this user alone, where everybody may put some.
//!
//! Input: a path. Output: what is there, opened. Time: none; nothing waits for another program. Failure: a symbolic link is not
//! followed; what is of another kind, of another user or open to others is named, and left as it is.

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

/// What group and others may do.
const OTHERS: u32 = 0o077;

/// Opens a file to read and write; with `create` makes one where there is none.
pub(crate) fn file(path: &Path, create: bool) -> Result<File, BusError> {
    let create = if create { OFlags::CREATE } else { OFlags::empty() };
    // Without a wait, should it be a pipe.
    let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC | create;
    match open(path, flags, Mode::RUSR | Mode::WUSR) {
        Ok(opened) => {
            let file = File::from(opened);
            let found = file.metadata().map_err(|cause| failed("looking at", path, cause))?;
            sound(path, &found, "file", found.is_file()).map(|()| file)
        }
        Err(Errno::NOENT) => Err(failed("opening", path, Errno::NOENT.into())),
        Err(cause) => {
            // What is there says more than that it cannot be opened.
            let found = fs::symlink_metadata(path).map_err(|cause| failed("looking at", path, cause))?;
            sound(path, &found, "file", found.is_file())?;
            Err(failed("opening", path, cause.into()))
        }
    }
}

/// Makes a folder where there is none. Nobody else can put another in its place: `/dev/shm` is sticky.
pub(crate) fn make_folder(path: &Path) -> Result<(), BusError> {
    match mkdir(path, Mode::RWXU) {
        Ok(()) | Err(Errno::EXIST) => folder(path),
        Err(cause) => Err(failed("making", path, cause.into())),
    }
}

/// Looks at a folder.
pub(crate) fn folder(path: &Path) -> Result<(), BusError> {
    let found = fs::symlink_metadata(path).map_err(|cause| failed("looking at", path, cause))?;
    sound(path, &found, "folder", found.is_dir())
}

/// Whose it is, whatever it is; where nothing is any more it is nobody's.
pub(crate) fn owner(path: &Path) -> Result<(), BusError> {
    match fs::symlink_metadata(path) {
        Ok(found) => mine(path, &found),
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(cause) => Err(failed("looking at", path, cause)),
    }
}

fn sound(path: &Path, found: &fs::Metadata, kind: &str, is_kind: bool) -> Result<(), BusError> {
    if !is_kind {
        return Err(refused(path, format!("it is {}, not a {kind}", kind_of(found)), found));
    }
    mine(path, found)?;
    if found.mode() & OTHERS != 0 {
        return Err(refused(path, format!("other users may use it (mode {:o})", found.mode() & 0o7777), found));
    }
    if found.is_file() && found.nlink() > 1 {
        return Err(refused(path, "it is another file too (a hard link)".into(), found));
    }
    Ok(())
}

fn mine(path: &Path, found: &fs::Metadata) -> Result<(), BusError> {
    let me = geteuid().as_raw();
    if found.uid() == me {
        return Ok(());
    }
    Err(refused(path, format!("it belongs to user {}, and this is user {me}", found.uid()), found))
}

fn refused(path: &Path, why: String, found: &fs::Metadata) -> BusError {
    let their_own = match found.uid() {
        uid if uid == geteuid().as_raw() => String::new(),
        uid => format!("where that user's system runs, be that user (sudo -u '#{uid}' plumb …); else "),
    };
    BusError::NotOurs { path: path.into(), why, their_own }
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
