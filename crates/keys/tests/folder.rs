//! Keys as files.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use keys::{Host, Keys, KeysError, Party, certificate::AUTHORITY_DAYS};

fn init(folder: &Path) -> Keys {
    Keys::init(folder, &hosts(), 30, false).unwrap().0
}

fn hosts() -> [Host; 1] {
    ["router.example.net".parse().unwrap()]
}

fn party(text: &str) -> Party {
    text.parse().unwrap()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        if entry.path().is_dir() { files.extend(self::files(&entry.path())) } else { files.push(entry.path()) }
    }
    files.sort();
    files
}

#[test]
fn private_keys_are_for_their_owner_only_and_nothing_is_left_beside() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    for name in ["vehicle.alpha", "operator.ann", "viewer.wall"] {
        keys.issue(&party(name), &[], &[], 30, false).unwrap();
    }
    let files = files(folder.path());
    assert_eq!(files.len(), 2 + 4 * 4, "{files:?}");
    for path in files {
        let mode = fs::metadata(&path).unwrap().permissions().mode() & 0o777;
        let private = fs::read_to_string(&path).unwrap().contains("PRIVATE KEY");
        assert_eq!(mode, if private { 0o600 } else { 0o644 }, "{}", path.display());
    }
    let holds_authority_key = fs::read_to_string(folder.path().join("authority.key")).unwrap();
    assert_ne!(holds_authority_key, fs::read_to_string(folder.path().join("router/key.pem")).unwrap());
}

#[test]
fn nothing_is_replaced_without_force() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    keys.issue(&party("vehicle.alpha"), &[], &[], 30, false).unwrap();
    let contents = || files(folder.path()).iter().map(|path| fs::read(path).unwrap()).collect::<Vec<_>>();
    let before = contents();
    assert!(matches!(Keys::init(folder.path(), &hosts(), 30, false), Err(KeysError::Exists { .. })));
    assert!(matches!(keys.issue(&party("vehicle.alpha"), &[], &[], 30, false), Err(KeysError::Exists { .. })));
    assert!(matches!(keys.router(&hosts(), 30, false), Err(KeysError::Exists { .. })));
    assert_eq!(contents(), before);
    keys.issue(&party("vehicle.alpha"), &[], &[], 30, true).unwrap();
    assert_ne!(contents(), before);
    Keys::init(folder.path(), &hosts(), 30, true).unwrap();
    assert!(!folder.path().join("vehicle.alpha").exists(), "a certificate of an authority that is no more");
}

#[test]
fn the_routers_list_follows_the_parties_and_keeps_what_people_changed() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    let path = folder.path().join("router/router.json5");
    let edited = fs::read_to_string(&path).unwrap().replace("0.0.0.0:7447", "10.0.0.1:7447");
    fs::write(&path, edited).unwrap();
    let names = |name: &str| fs::read_to_string(&path).unwrap().contains(name);
    keys.issue(&party("vehicle.alpha"), &[], &[], 30, false).unwrap();
    assert!(names("vehicle.alpha") && names("10.0.0.1:7447"));
    keys.router(&hosts(), 30, true).unwrap();
    assert!(names("vehicle.alpha") && names("10.0.0.1:7447"));
    keys.revoke(&party("vehicle.alpha")).unwrap();
    assert!(!names("vehicle.alpha") && names("10.0.0.1:7447"));
    fs::write(&path, "{}").unwrap();
    assert!(matches!(keys.issue(&party("vehicle.beta"), &[], &[], 30, false), Err(KeysError::NoPlaceForList { .. })));
}

#[test]
fn the_name_of_a_revoked_party_is_not_given_again() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    let alpha = party("vehicle.alpha");
    assert!(matches!(keys.revoke(&alpha), Err(KeysError::NoParty { .. })));
    keys.issue(&alpha, &[], &[], 30, false).unwrap();
    keys.revoke(&alpha).unwrap();
    for force in [false, true] {
        assert!(matches!(keys.issue(&alpha, &[], &[], 30, force), Err(KeysError::Revoked { .. })));
    }
    let holders = keys.holders().unwrap();
    assert!(holders.iter().any(|holder| holder.name == "vehicle.alpha" && holder.revoked));
}

#[test]
fn the_list_of_holders_tells_until_when() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    keys.issue(&party("viewer.wall"), &[], &[], 5, false).unwrap();
    let reopened = Keys::open(folder.path()).unwrap();
    let days: Vec<_> = reopened.holders().unwrap().into_iter().map(|holder| (holder.name, holder.days_left)).collect();
    let authority_days = i64::from(AUTHORITY_DAYS) - 1;
    let expected = [("plumbline authority", authority_days), ("router", 29), ("viewer.wall", 4)];
    assert_eq!(days, expected.map(|(name, days)| (name.to_owned(), days)));
}

#[test]
fn a_folder_without_an_authority_or_with_a_damaged_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Keys::open(folder.path()), Err(KeysError::NoAuthority { .. })));
    init(folder.path());
    fs::write(folder.path().join("authority.key"), "not a key").unwrap();
    assert!(matches!(Keys::open(folder.path()), Err(KeysError::Damaged { .. })));
}
