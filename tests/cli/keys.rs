//! `plumb keys` on the command line and in scripts.
use std::{path::Path, process::Output};

use crate::common::plumb;
use serde_json::Value;

fn keys(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = plumb(&["keys"]);
    command.args(arguments).arg("--dir").arg(folder).output().unwrap()
}

fn json(output: &Output) -> Value {
    serde_json::from_str(std::str::from_utf8(&output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

#[test]
fn keys_prints_written_files_and_destination() {
    let folder = tempfile::tempdir().unwrap();
    let init = keys(folder.path(), &["init", "--router", "10.0.0.1", "--router", "router.example.net"]);
    let text = String::from_utf8(init.stdout).unwrap();
    assert!(init.status.success());
    assert!(text.contains("authority.key stays here") && text.contains("router/router.json5"), "{text}");

    let vehicle = keys(folder.path(), &["vehicle", "alpha", "--days", "40", "--json"]);
    let written = &json(&vehicle)["written"][0];
    assert_eq!((&written["name"], &written["copy_to"]), (&"vehicle.alpha".into(), &"/etc/plumbline/keys".into()));
    for file in written["files"].as_array().unwrap() {
        assert!(Path::new(file.as_str().unwrap()).is_file(), "{file}");
    }
    let configuration = std::fs::read_to_string(folder.path().join("vehicle.alpha/vehicle.json5")).unwrap();
    assert!(configuration.contains(r#"["quic/10.0.0.1:7447", "quic/router.example.net:7447"]"#));

    let listed = json(&keys(folder.path(), &["list", "--json"]))["holders"].clone();
    let names: Vec<_> = listed.as_array().unwrap().iter().map(|holder| holder["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["plumbline authority", "router", "vehicle.alpha"]);
    assert_eq!(listed[2]["days_left"], 39);
}

#[test]
fn keys_lists_imports_and_rejects_unknown_vehicles() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, code) in [
        (&["init"][..], 0),
        (&["vehicle", "base", "--imports", "board"], 1),
        (&["vehicle", "board"], 0),
        (&["vehicle", "base", "--imports", "board/*"], 2),
        (&["vehicle", "base", "--imports", "board"], 0),
    ] {
        let output = keys(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let imports = || json(&keys(folder.path(), &["list", "--json"]))["holders"][2]["imports"].clone();
    assert_eq!(imports(), serde_json::json!(["vehicle.board"]));
    let text = String::from_utf8(keys(folder.path(), &["list"]).stdout).unwrap();
    assert!(text.contains("imports ticks of vehicle.board"), "{text}");
    // The new certificate no longer permits the import of ticks.
    assert!(keys(folder.path(), &["vehicle", "base", "--force"]).status.success());
    assert_eq!(imports(), serde_json::json!([]));
    let router = std::fs::read_to_string(folder.path().join("router/router.json5")).unwrap();
    assert!(!router.contains("@carry"), "{router}");
}

#[test]
fn check_fails_for_expiring_but_not_for_revoked_certificate() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, code) in [
        (&["init"][..], 0),
        (&["viewer", "wall", "--days", "29"], 0),
        (&["check"], 1),
        (&["viewer", "wall", "--days", "60"], 1),
        (&["viewer", "wall", "--days", "60", "--force"], 0),
        (&["check"], 0),
        (&["viewer", "desk", "--days", "3"], 0),
        (&["check"], 1),
        (&["revoke", "viewer.desk"], 0),
        (&["check"], 0),
        (&["viewer", "desk", "--force"], 1),
    ] {
        let output = keys(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
        assert_eq!(text.is_empty(), code == 0, "{arguments:?}: {text}");
    }
}

#[test]
fn invalid_arguments_exit_2_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    assert!(keys(folder.path(), &["init"]).status.success());
    let count = || std::fs::read_dir(folder.path()).unwrap().count();
    let before = count();
    for arguments in [
        &["vehicle", "Alpha"][..],
        &["vehicle", "../alpha"],
        &["operator", "*"],
        &["viewer", "wall", "--days", "0"],
        &["vehicle", "alpha", "--host", "quic/alpha:7447"],
        &["vehicle", "alpha", "--host", "fd00::1"],
        &["router", "--router", "a b", "--force"],
        &["revoke", "alpha"],
    ] {
        let output = keys(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(count(), before);
    for arguments in [&["vehicle", "alpha", "--host", "a b"][..], &["router", "--router", "a b", "--force"]] {
        let text = String::from_utf8(keys(folder.path(), arguments).stderr).unwrap();
        assert!(text.contains("invalid host `a b`"), "{text}");
    }
    for arguments in [&["vehicle", "alpha", "--host", "fd00::1"][..], &["router", "--router", "fd00::1", "--force"]] {
        let text = String::from_utf8(keys(folder.path(), arguments).stderr).unwrap();
        assert!(text.contains("use a DNS name or an IPv4 address"), "{text}");
    }
    let nowhere = keys(&folder.path().join("nowhere"), &["vehicle", "alpha"]);
    assert_eq!(nowhere.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&nowhere.stderr).contains("plumb keys init"));
}
