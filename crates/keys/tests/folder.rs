//! Key folder on disk: modes, replacement, access list, revocation.
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
fn private_keys_are_owner_only_and_no_temporary_file_remains() {
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
fn existing_files_are_replaced_only_with_force() {
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
    assert!(!folder.path().join("vehicle.alpha").exists(), "certificate of the replaced authority");
}

#[test]
fn router_list_follows_parties_and_keeps_manual_edits() {
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
    assert!(matches!(
        keys.issue(&party("vehicle.beta"), &[], &[], 30, false),
        Err(KeysError::MissingListMarkers { .. })
    ));
}

#[test]
fn revoked_name_is_not_issued_again() {
    let folder = tempfile::tempdir().unwrap();
    let keys = init(folder.path());
    let alpha = party("vehicle.alpha");
    assert!(matches!(keys.revoke(&alpha), Err(KeysError::UnknownParty { .. })));
    keys.issue(&alpha, &[], &[], 30, false).unwrap();
    keys.revoke(&alpha).unwrap();
    for force in [false, true] {
        assert!(matches!(keys.issue(&alpha, &[], &[], 30, force), Err(KeysError::Revoked { .. })));
    }
    let holders = keys.holders().unwrap();
    assert!(holders.iter().any(|holder| holder.name == "vehicle.alpha" && holder.revoked));
}

#[test]
fn holders_report_days_until_expiry() {
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
fn missing_or_damaged_authority_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Keys::open(folder.path()), Err(KeysError::NoAuthority { .. })));
    init(folder.path());
    fs::write(folder.path().join("authority.key"), "not a key").unwrap();
    assert!(matches!(Keys::open(folder.path()), Err(KeysError::InvalidFile { .. })));
}
