//! What carries a system's name is one user's alone; what somebody else has put there is named and left as it is.
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

/// A user who owns nothing of a system.
const NOBODY: u32 = 65534;
const CONTENTS: &str = "what somebody needs";

/// A name that no other test has, and what it is to be cleared of.
struct Name {
    system_name: SystemName,
    aside: tempfile::TempDir,
}

impl Name {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-own-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        Self { system_name: SystemName::new(&name).unwrap(), aside: tempfile::tempdir().unwrap() }
    }

    /// The path of a file of the name; of its folder with no `end`.
    fn path(&self, end: &str) -> PathBuf {
        PathBuf::from(format!("/dev/shm/plumbline.{}{end}", self.system_name.name()))
    }

    /// A file elsewhere, of more than a page.
    fn elsewhere(&self) -> PathBuf {
        let path = self.aside.path().join("elsewhere");
        fs::write(&path, CONTENTS.repeat(1000)).unwrap();
        path
    }

    fn own_file(&self, end: &str, mode: u32) -> PathBuf {
        let path = self.path(end);
        fs::write(&path, CONTENTS).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        path
    }

    /// Neither whoever starts a system of the name nor whoever clears away after one touches `path`; both say what is wrong with it.
    fn assert_refused(&self, path: &Path, why: &str) {
        let before = state(path);
        let refusals = [
            self.system_name.claim().map(drop).unwrap_err(),
            StaleResources::of(&self.system_name).and_then(|remains| remains.clear()).unwrap_err(),
        ];
        for refusal in refusals {
            let said = refusal.to_string();
            assert!(matches!(&refusal, BusError::NotOurs { path: named, .. } if named == path), "{said}");
            assert!(said.contains(why) && said.contains(&format!("rm -r {}", path.display())), "{said}");
        }
        assert_eq!(state(path), before);
        if fs::remove_file(path).is_err() {
            fs::remove_dir_all(path).unwrap();
        }
        drop(self.system_name.claim().unwrap());
        assert_eq!(StaleResources::of(&self.system_name).unwrap().files, Vec::<PathBuf>::new());
    }
}

/// What is at a path, and what it points to.
fn state(path: &Path) -> (u32, u32, u64, Option<PathBuf>) {
    let found = fs::symlink_metadata(path).unwrap();
    (found.mode(), found.uid(), found.len(), fs::read_link(path).ok())
}

fn am_root() -> bool {
    let root = fs::metadata("/proc/self").unwrap().uid() == 0;
    if !root {
        eprintln!("skipped: only root can make files of another user");
    }
    root
}

#[test]
fn a_symbolic_link_is_not_followed() {
    for end in [".wake", ".members"] {
        let name = Name::new();
        let target = name.elsewhere();
        symlink(&target, name.path(end)).unwrap();
        name.assert_refused(&name.path(end), "it is a symbolic link, not a file");
        assert_eq!(fs::read_to_string(&target).unwrap(), CONTENTS.repeat(1000), "{end}");
    }
    let name = Name::new();
    symlink(name.path(".nothing"), name.path(".wake")).unwrap();
    name.assert_refused(&name.path(".wake"), "it is a symbolic link, not a file");
}

#[test]
fn what_is_no_file_is_not_waited_for_and_not_used() {
    let name = Name::new();
    let page = name.path(".wake");
    fs::create_dir(&page).unwrap();
    name.assert_refused(&page, "it is a folder, not a file");
    assert!(Command::new("mkfifo").args(["-m", "600"]).arg(&page).status().unwrap().success());
    name.assert_refused(&page, "it is a named pipe, not a file");
    drop(UnixListener::bind(&page).unwrap());
    name.assert_refused(&page, "it is a socket, not a file");
}

#[test]
fn what_others_may_use_or_have_under_another_name_is_not_used() {
    let name = Name::new();
    for (mode, said) in [(0o666, "(mode 666)"), (0o640, "(mode 640)"), (0o604, "(mode 604)")] {
        name.assert_refused(&name.own_file(".wake", mode), said);
    }
    let page = name.own_file(".wake", 0o600);
    let second = PathBuf::from(format!("/dev/shm/test-own-second-name-{}", std::process::id()));
    fs::hard_link(&page, &second).unwrap();
    name.assert_refused(&page, "a hard link");
    assert_eq!(fs::read_to_string(&second).unwrap(), CONTENTS);
    fs::remove_file(&second).unwrap();
}

#[test]
fn nothing_of_another_user_is_used_or_removed() {
    if !am_root() {
        return;
    }
    for end in [".wake", ".members", ".0123.data"] {
        let name = Name::new();
        let path = name.own_file(end, 0o600);
        chown(&path, Some(NOBODY), Some(NOBODY)).unwrap();
        name.assert_refused(&path, "it belongs to user 65534, and this is user 0");
    }
    let name = Name::new();
    let folder = name.path("");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("door"), CONTENTS).unwrap();
    chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
    let said = name.system_name.door().unwrap_err().to_string();
    assert!(said.contains("sudo -u '#65534' plumb"), "{said}");
    name.assert_refused(&folder, "it belongs to user 65534, and this is user 0");
    symlink(name.aside.path(), &folder).unwrap();
    lchown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
    name.assert_refused(&folder, "it belongs to user 65534, and this is user 0");
}

#[test]
fn the_folder_is_no_link_to_another() {
    let name = Name::new();
    symlink(name.aside.path(), name.path("")).unwrap();
    assert!(matches!(name.system_name.door().unwrap_err(), BusError::NotOurs { .. }));
    // One's own link goes with what an earlier system left behind; what it leads to stays.
    let kept = name.elsewhere();
    let claim = name.system_name.claim().unwrap();
    assert_eq!(state(&name.path("")).0, 0o040_700);
    drop(claim);
    assert!(kept.exists());
}

#[test]
fn an_observer_takes_no_seat_that_is_a_link() {
    let name = Name::new();
    let claim = name.system_name.claim().unwrap();
    let bus = Bus::join(&name.system_name, "service").unwrap();
    let target = name.elsewhere();
    symlink(&target, name.path(".seat.0")).unwrap();
    let refused = Observer::sit(&name.system_name, "test").unwrap_err();
    assert!(matches!(refused, BusError::NotOurs { .. }), "{refused}");
    drop((bus, claim));
    assert!(target.exists());
}

#[test]
fn everything_that_is_made_is_this_users_alone() {
    let name = Name::new();
    let claim = name.system_name.claim().unwrap();
    let bus = Bus::join(&name.system_name, "service").unwrap();
    let publisher = bus.publisher::<ImuSample>(64).unwrap();
    let reader = bus.subscriber::<ImuSample>(64).unwrap();
    publisher.deliver_history().unwrap();
    let observer = Observer::sit(&name.system_name, "test").unwrap();
    let files = StaleResources::of(&name.system_name).unwrap().files;
    let segments = files.iter().filter(|path| path.to_string_lossy().ends_with(".global_mgmt")).count();
    assert_eq!(segments, 1, "iceoryx2 counts nodes from another segment: {files:?}");
    for path in &files {
        assert_eq!(state(path).0 & 0o077, 0, "{} is open to others", path.display());
    }
    drop((observer, reader, publisher, bus, claim));
    assert_eq!(StaleResources::of(&name.system_name).unwrap().files, Vec::<PathBuf>::new());
}
