//! Options that all commands share: help without a command, colours, `--quiet` and JSON objects.
//! The effective launch file is tested as well.
use std::{fs, process::Output};

use serde_json::Value;

use crate::common::{System, plumb};

const ESCAPE: char = '\u{1b}';

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn doctor(arguments: &[&str], environment: &[(&str, &str)]) -> String {
    let mut command = plumb(&["doctor", "--system", "no-such-system"]);
    command.args(arguments).env_remove("NO_COLOR").envs(environment.iter().copied());
    text(&command.output().unwrap().stdout)
}

#[test]
fn command_line_without_a_command_prints_help() {
    let bare = plumb(&[]).output().unwrap();
    assert_eq!((bare.status.code(), text(&bare.stderr)), (Some(0), String::new()));
    assert_eq!(text(&bare.stdout), text(&plumb(&["--help"]).output().unwrap().stdout));
    assert!(text(&bare.stdout).contains("plumb demo"));
}

#[test]
fn colours_follow_option_and_environment() {
    for (arguments, environment, expected) in [
        (&[][..], &[][..], false),
        (&["--color", "always"], &[], true),
        (&["--color=always"], &[("NO_COLOR", "1")], true),
        (&["--color", "never"], &[("CLICOLOR_FORCE", "1")], false),
        (&[], &[("NO_COLOR", "1"), ("CLICOLOR_FORCE", "1")], false),
        (&[], &[("CLICOLOR_FORCE", "1")], true),
    ] {
        let printed = doctor(arguments, environment);
        assert_eq!(printed.contains(ESCAPE), expected, "{arguments:?} {environment:?}: {printed}");
        assert!(printed.contains("shared-memory"), "{printed}");
    }
}

#[test]
fn quiet_run_prints_only_its_result_and_errors() {
    let system = System::new("");
    let run = |more: &[&str]| -> Output {
        let mut command = plumb(&["up", "--speed", "max", "--for", "200ms", "--launch"]);
        command.arg(system.path("launch.toml")).args(more).env("XDG_STATE_HOME", system.folder.path());
        command.output().unwrap()
    };
    let quiet = run(&["--quiet", "--in-process", "--json"]);
    let report: Value = serde_json::from_slice(&quiet.stdout).unwrap();
    assert_eq!((text(&quiet.stderr), &report["ticks_out"]), (String::new(), &Value::from(200)));
    let failed = run(&["-q", "--in-process", "--out", "/missing/out.csv"]);
    assert_eq!(failed.status.code(), Some(1));
    assert!(text(&failed.stderr).contains("/missing/out.csv"), "{}", text(&failed.stderr));
    let loud = run(&["--in-process"]);
    assert!(text(&loud.stderr).contains("200 in, 200 out, 0 lost"), "{}", text(&loud.stderr));
}

#[test]
fn json_output_is_always_an_object() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    let keys = keys.to_str().unwrap();
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let name = ["--system", &system.name];
    let of_system = |arguments: &[&'static str]| [arguments, &name.map(|word| word)].concat();
    for arguments in [
        vec!["keys", "init", "--dir", keys],
        vec!["keys", "list", "--dir", keys],
        vec!["keys", "check", "--dir", keys],
        vec!["stage", "list"],
        vec!["stage", "test", "projector"],
        of_system(&["ps"]),
        of_system(&["topic", "list", "--for", "100ms"]),
        of_system(&["topic", "info", "imu", "--for", "100ms"]),
        of_system(&["topic", "echo", "attitude", "--count", "1"]),
        of_system(&["topic", "hz", "attitude", "--count", "2"]),
        of_system(&["top", "--count", "1", "--interval", "100ms"]),
        of_system(&["doctor", "--for", "500ms"]),
        of_system(&["swap", "fuser", "vqf"]),
        of_system(&["down"]),
        of_system(&["ps"]),
    ] {
        let output = plumb(&arguments).arg("--json").output().unwrap();
        let printed = text(&output.stdout);
        let last = printed.lines().last().unwrap_or_default();
        let value: Value = serde_json::from_str(last).unwrap_or_else(|_| panic!("{arguments:?}: {printed}"));
        assert!(value.is_object(), "{arguments:?}: {value}");
    }
    running.wait();
}

#[test]
fn effective_launch_file_is_valid_and_has_every_value() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.toml");
    fs::write(&file, "name = \"mine\"\n[ingest]\nsource = \"udp\"\n[ingest.udp]\nlisten = \"127.0.0.1:9\"\n").unwrap();
    let show = |arguments: &[&str]| {
        let output = plumb(&["config", "show"]).args(arguments).current_dir(folder.path()).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let built_in = show(&[]);
    assert!(built_in.contains("name = \"plumbline\"  # default") && built_in.contains("[ingest.sim]"), "{built_in}");
    let shown = show(&["--launch", "mine.toml"]);
    for line in ["name = \"mine\"", "listen = \"127.0.0.1:9\"", "stage = \"multiple-model\"  # default"] {
        assert!(shown.lines().any(|found| found == line), "{line}:\n{shown}");
    }
    let effective = folder.path().join("effective.toml");
    fs::write(&effective, &shown).unwrap();
    assert_eq!(plumb(&["config", "check", "--launch"]).arg(&effective).status().unwrap().code(), Some(0), "{shown}");
    let missing = plumb(&["config", "show", "--launch", "/missing.toml"]).output().unwrap();
    assert_eq!(missing.status.code(), Some(3));
}
