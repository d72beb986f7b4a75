//! Standard output: whoever has read enough is no error, whoever cannot be written to is.
use std::{
    fs::File,
    io::{BufRead, BufReader, Read},
    process::{Command, Stdio},
};

use crate::common::{Running, System, plumb};

/// What a command said that was read until so many lines had come; it ended with 0.
fn read(mut command: Command, lines: usize) -> String {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    for _ in 0..lines {
        assert!(reader.read_line(&mut String::new()).unwrap() > 0, "{command:?}");
    }
    drop(reader);
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{command:?}: {said}");
    said
}

fn started(system: &System) -> Running {
    let running = system.start(&[]);
    system.all_run();
    running
}

#[test]
fn a_reader_who_has_read_enough_is_no_error() {
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
    let running = started(&system);
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
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());

    let report = read(system.command(&["--for", "100ms", "--speed", "max"]), 0);
    assert!(report.contains("ticks    100 in, 100 out, 0 lost"), "{report}");
}

#[test]
fn a_result_that_cannot_be_written_is_an_error() {
    let system = System::new("");
    let run = system.command(&["--for", "100ms", "--speed", "max"]);
    for mut command in [plumb(&["stage", "list"]), run] {
        let output = command.stdout(File::options().write(true).open("/dev/full").unwrap()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("cannot write to standard output: No space left on device"), "{said}");
    }
}
