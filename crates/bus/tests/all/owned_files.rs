//! Files of a system are private to its user. Files of other users are reported and left unchanged.
use std::{
    fs,
    os::unix::{
        fs::{MetadataExt, PermissionsExt, chown, lchown, symlink},
        net::UnixListener,
    },
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicU32, Ordering},
};

use bus::{Bus, BusError, Observer, StaleResources, SystemName};
use messages::ImuSample;

/// User that owns no file of a system.
const NOBODY_UID: u32 = 65534;
const CONTENTS: &str = "contents of another program";

/// System name that no other test uses, and a folder outside shared memory.
struct Name {
    system_name: SystemName,
    outside: tempfile::TempDir,
}

impl Name {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-own-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        Self { system_name: SystemName::new(&name).unwrap(), outside: tempfile::tempdir().unwrap() }
    }

    /// Returns the path of the system file with the suffix `end`. An empty `end` selects the
    /// folder.
    fn path(&self, end: &str) -> PathBuf {
        PathBuf::from(format!("/dev/shm/plumbline.{}{end}", self.system_name.name()))
    }

    /// Creates a file outside shared memory that is longer than the shared state.
    fn outside_file(&self) -> PathBuf {
        let path = self.outside.path().join("outside_file");
        fs::write(&path, CONTENTS.repeat(1000)).unwrap();
        path
    }

    fn create_file(&self, end: &str, mode: u32) -> PathBuf {
        let path = self.path(end);
        fs::write(&path, CONTENTS).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        path
    }

    /// Asserts that starting a system and removing stale files both reject `path` and leave it
    /// unchanged.
    fn assert_rejected(&self, path: &Path, why: &str) {
        let before = state(path);
        let errors = [
            self.system_name.claim().map(drop).unwrap_err(),
            StaleResources::for_system(&self.system_name).and_then(|stale| stale.remove()).unwrap_err(),
        ];
        for error in errors {
            let message = error.to_string();
            assert!(matches!(&error, BusError::ForeignFile { path: named, .. } if named == path), "{message}");
            assert!(message.contains(why) && message.contains(&format!("rm -r {path:?}")), "{message}");
        }
        assert_eq!(state(path), before);
        if fs::remove_file(path).is_err() {
            fs::remove_dir_all(path).unwrap();
        }
        drop(self.system_name.claim().unwrap());
        assert_eq!(StaleResources::for_system(&self.system_name).unwrap().files, Vec::<PathBuf>::new());
    }
}

/// Returns the mode, owner, size and link target of a path.
fn state(path: &Path) -> (u32, u32, u64, Option<PathBuf>) {
    let found = fs::symlink_metadata(path).unwrap();
    (found.mode(), found.uid(), found.len(), fs::read_link(path).ok())
}

fn is_root() -> bool {
    let root = fs::metadata("/proc/self").unwrap().uid() == 0;
    if !root {
        eprintln!("skipped: only root can make files of another user");
    }
    root
}

#[test]
fn symbolic_links_are_rejected() {
    for end in [".wake", ".members"] {
        let name = Name::new();
        let target = name.outside_file();
        symlink(&target, name.path(end)).unwrap();
        name.assert_rejected(&name.path(end), "it is a symbolic link, not a file");
        assert_eq!(fs::read_to_string(&target).unwrap(), CONTENTS.repeat(1000), "{end}");
    }
    let name = Name::new();
    symlink(name.path(".nothing"), name.path(".wake")).unwrap();
    name.assert_rejected(&name.path(".wake"), "it is a symbolic link, not a file");
}

#[test]
fn non_regular_files_are_rejected_without_blocking() {
    let name = Name::new();
    let page = name.path(".wake");
    fs::create_dir(&page).unwrap();
    name.assert_rejected(&page, "it is a folder, not a file");
    assert!(Command::new("mkfifo").args(["-m", "600"]).arg(&page).status().unwrap().success());
    name.assert_rejected(&page, "it is a named pipe, not a file");
    drop(UnixListener::bind(&page).unwrap());
    name.assert_rejected(&page, "it is a socket, not a file");
}

#[test]
fn accessible_or_hard_linked_files_are_rejected() {
    let name = Name::new();
    for (mode, message) in [(0o666, "(mode 666)"), (0o640, "(mode 640)"), (0o604, "(mode 604)")] {
        name.assert_rejected(&name.create_file(".wake", mode), message);
    }
    let page = name.create_file(".wake", 0o600);
    let second = PathBuf::from(format!("/dev/shm/test-own-second-name-{}", std::process::id()));
    fs::hard_link(&page, &second).unwrap();
    name.assert_rejected(&page, "a hard link");
    assert_eq!(fs::read_to_string(&second).unwrap(), CONTENTS);
    fs::remove_file(&second).unwrap();
}

#[test]
fn files_of_other_users_are_rejected_and_kept() {
    if !is_root() {
        return;
    }
    for end in [".wake", ".members", ".observer.3", ".0123.dynamic", ".0123.global_mgmt"] {
        let name = Name::new();
        let path = name.create_file(end, 0o600);
        chown(&path, Some(NOBODY_UID), Some(NOBODY_UID)).unwrap();
        name.assert_rejected(&path, "it belongs to user 65534, not to user 0");
    }
    let name = Name::new();
    let folder = name.path("");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("control"), CONTENTS).unwrap();
    chown(&folder, Some(NOBODY_UID), Some(NOBODY_UID)).unwrap();
    let message = name.system_name.control_socket_path().unwrap_err().to_string();
    assert!(message.contains("sudo -u '#65534' plumb"), "{message}");
    name.assert_rejected(&folder, "it belongs to user 65534, not to user 0");
    symlink(name.outside.path(), &folder).unwrap();
    lchown(&folder, Some(NOBODY_UID), Some(NOBODY_UID)).unwrap();
    name.assert_rejected(&folder, "it belongs to user 65534, not to user 0");
}

#[test]
fn unused_files_of_other_users_do_no_harm_and_are_kept() {
    if !is_root() {
        return;
    }
    let name = Name::new();
    // The segment is empty. If it belonged to this user, its creator would be assumed to be killed.
    let [segment, folder, link] = [".0123.data", ".folder", ".0123.connection"].map(|end| name.path(end));
    fs::write(&segment, "").unwrap();
    fs::create_dir(&folder).unwrap();
    symlink(name.outside.path(), &link).unwrap();
    let planted = [&segment, &folder, &link];
    planted.iter().for_each(|path| lchown(path, Some(NOBODY_UID), Some(NOBODY_UID)).unwrap());
    let before = planted.map(|path| state(path));
    let claim = name.system_name.claim().unwrap();
    let bus = Bus::join(&name.system_name, "service").unwrap();
    let publisher = bus.publisher::<ImuSample>(64).unwrap();
    drop(Observer::attach(&name.system_name, "test").unwrap());
    drop((publisher, bus));
    let claim = claim.renew().unwrap();
    drop(Bus::join(&name.system_name, "service").unwrap());
    drop(claim);
    assert_eq!(StaleResources::for_system(&name.system_name).unwrap().files, Vec::<PathBuf>::new());
    assert_eq!(planted.map(|path| state(path)), before);
    fs::remove_dir(&folder).unwrap();
    [segment, link].iter().for_each(|path| fs::remove_file(path).unwrap());
}

#[test]
fn linked_folder_is_rejected_and_replaced() {
    let name = Name::new();
    symlink(name.outside.path(), name.path("")).unwrap();
    assert!(matches!(name.system_name.control_socket_path().unwrap_err(), BusError::ForeignFile { .. }));
    // A link that belongs to the same user is removed with the files of a previous run, but its
    // target is kept.
    let kept = name.outside_file();
    let claim = name.system_name.claim().unwrap();
    assert_eq!(state(&name.path("")).0, 0o040_700);
    drop(claim);
    assert!(kept.exists());
}

#[test]
fn observer_rejects_linked_lock_file() {
    let name = Name::new();
    let claim = name.system_name.claim().unwrap();
    let bus = Bus::join(&name.system_name, "service").unwrap();
    let target = name.outside_file();
    symlink(&target, name.path(".observer.0")).unwrap();
    let refused = Observer::attach(&name.system_name, "test").unwrap_err();
    assert!(matches!(refused, BusError::ForeignFile { .. }), "{refused}");
    drop((bus, claim));
    assert!(target.exists());
}

#[test]
fn created_files_are_private() {
    let name = Name::new();
    let claim = name.system_name.claim().unwrap();
    let bus = Bus::join(&name.system_name, "service").unwrap();
    let publisher = bus.publisher::<ImuSample>(64).unwrap();
    let reader = bus.subscriber::<ImuSample>(64).unwrap();
    publisher.deliver_history().unwrap();
    let observer = Observer::attach(&name.system_name, "test").unwrap();
    let files = StaleResources::for_system(&name.system_name).unwrap().files;
    let segments = files.iter().filter(|path| path.to_string_lossy().ends_with(".global_mgmt")).count();
    assert_eq!(segments, 1, "iceoryx2 counts nodes in another segment: {files:?}");
    for path in &files {
        assert_eq!(state(path).0 & 0o077, 0, "{} is accessible to others", path.display());
    }
    drop((observer, reader, publisher, bus, claim));
    assert_eq!(StaleResources::for_system(&name.system_name).unwrap().files, Vec::<PathBuf>::new());
}
