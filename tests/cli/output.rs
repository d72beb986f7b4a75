//! Standard output: a closed pipe is not an error, but an unwritable file is.
use std::{
    fs::File,
    io::{BufRead, BufReader, Read},
    process::{Command, Stdio},
};

use crate::common::{Running, System, plumb};

/// Runs a command, closes its output after `lines` lines and checks that the exit code is 0.
///
/// Returns its standard error.
fn read(mut command: Command, lines: usize) -> String {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    for _ in 0..lines {
        assert!(reader.read_line(&mut String::new()).unwrap() > 0, "{command:?}");
    }
    drop(reader);
    let mut stderr = String::new();
    child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{command:?}: {stderr}");
    stderr
}

fn start_system(system: &System) -> Running {
    let running = system.start(&[]);
    system.wait_until_running();
    running
}

#[test]
fn closed_reader_is_not_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("keys").to_str().unwrap().to_owned();
    for arguments in [
        &["stage", "list"][..],
        &["stage", "list", "--json"],
        &["stage", "test", "projector"],
        &["keys", "init", "--force", "--dir", &dir],
        &["keys", "list", "--dir", &dir],
        &["score", "sim:s1?duration_s=7"],
        &["--help"],
    ] {
        for lines in [0, 1] {
            assert_eq!(read(plumb(arguments), lines), "", "{arguments:?}");
        }
    }

    let system = System::new("");
    let running = start_system(&system);
    let name = ["--system", &system.name];
    for (arguments, lines) in [
        (&["topic", "echo", "attitude"][..], 3),
        (&["topic", "echo", "imu", "--json"], 1),
        (&["topic", "hz", "attitude"], 1),
        (&["topic", "list"], 1),
        (&["topic", "info", "fused"], 1),
        (&["top", "--interval", "0.1"], 1),
        (&["top", "--interval", "0.1", "--json"], 1),
        (&["shadow", "fuser", "vqf"], 1),
        (&["ps"], 0),
    ] {
        assert_eq!(read(plumb(&[arguments, &name].concat()), lines), "", "{arguments:?}");
    }
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());

    let report = read(system.command(&["--for", "100ms", "--speed", "max"]), 0);
    assert!(report.contains("ticks    100 in, 100 out, 0 lost"), "{report}");
}

#[test]
fn unwritable_stdout_is_an_error() {
    let system = System::new("");
    let run = system.command(&["--for", "100ms", "--speed", "max"]);
    for mut command in [plumb(&["stage", "list"]), run] {
        let output = command.stdout(File::options().write(true).open("/dev/full").unwrap()).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains("cannot write to standard output: No space left on device"), "{stderr}");
    }
}
