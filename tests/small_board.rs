//! Commands and launch-file entries of a build without optional features.
#![cfg(not(any(feature = "cockpit", feature = "network", feature = "tui")))]
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{fs, process::Command};

/// Runs `plumb` in an empty folder. Returns the exit code and standard error.
fn plumb(arguments: &[&str], folder: &std::path::Path) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_plumb")).args(arguments).current_dir(folder).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn command_of_missing_feature_fails_and_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let remote = ["--remote", "alpha", "--connect", "quic/127.0.0.1:7447", "--keys", "keys/viewer.wall"];
    let with_remote = |command: &[&'static str]| [command, &remote].concat();
    let commands: [(Vec<&str>, &str); 12] = [
        (vec!["top", "--lines"], "tui"),
        (vec!["view", "flight.mcap", "--viewer"], "cockpit"),
        (vec!["station", "--csv", "tables"], "network"),
        (vec!["keys", "vehicle", "alpha"], "network"),
        (vec!["bridge", "ros", "--domain", "7"], "network"),
        (vec!["bridge", "ros-sensor"], "network"),
        (with_remote(&["ps"]), "network"),
        (with_remote(&["swap", "fuser", "vqf"]), "network"),
        (with_remote(&["topic", "list"]), "network"),
        (with_remote(&["topic", "echo", "attitude"]), "network"),
        (with_remote(&["topic", "hz", "imu"]), "network"),
        (with_remote(&["topic", "info", "fused"]), "network"),
    ];
    for (arguments, feature) in commands {
        let (code, error) = plumb(&arguments, folder.path());
        assert_eq!(code, Some(2), "{arguments:?}: {error}");
        assert!(error.contains(&format!("--features {feature}")), "{arguments:?}: {error}");
    }
}

#[test]
fn service_of_missing_feature_in_launch_file_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    for (service, feature) in [("gateway", "network"), ("cockpit", "cockpit")] {
        let text = format!("services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"{service}\"]\n");
        fs::write(folder.path().join("launch.toml"), text).unwrap();
        for arguments in [&["up"][..], &["config", "check"], &["up", "--in-process"]] {
            let (code, error) = plumb(arguments, folder.path());
            assert_eq!(code, Some(3), "{arguments:?}: {error}");
            assert!(error.contains(service) && error.contains(&format!("--features {feature}")), "{error}");
        }
        let (code, error) = plumb(&["service", service], folder.path());
        assert!(code == Some(1) && error.contains(&format!("--features {feature}")), "{error}");
    }
}

#[test]
fn built_in_launch_file_runs_without_missing_services() {
    let folder = tempfile::tempdir().unwrap();
    let (code, error) =
        plumb(&["up", "--source", "sim:s1", "--for", "1s", "--speed", "max", "--in-process"], folder.path());
    assert_eq!(code, Some(0), "{error}");
}
