//! Remedies for captures of sensors: each command is pasted into a shell.
use std::{
    env, fs,
    path::Path,
    process::{Command, Output},
};

use crate::common::{System, plumb, python};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Returns the commands in a message, which are between backquotes.
fn commands(message: &str) -> Vec<&str> {
    message.split('`').skip(1).step_by(2).collect()
}

/// Runs a line in a shell, in the folder of a system. `plumb` and the Python of the tests come
/// first.
fn shell(system: &System, line: &str) -> Output {
    let plumb = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().map(Path::to_owned);
    let python = python::python().and_then(Path::parent).map(Path::to_owned);
    let path = env::var_os("PATH").unwrap_or_default();
    let folders = python.into_iter().chain(plumb).chain(env::split_paths(&path));
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(system.folder.path()).env("PATH", env::join_paths(folders).unwrap());
    command.env("XDG_STATE_HOME", system.folder.path()).output().unwrap()
}

/// Returns the message for a file that is not read.
fn refusal(file: &Path) -> String {
    let messages = [&["info"][..], &["score"], &["up", "--in-process", "--replay"]].map(|arguments| {
        let output = plumb(arguments).arg(file).output().unwrap();
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{stderr}");
        stderr
    });
    let found = |message: &String| message.split_once("found ").map(|(_, found)| found.trim().to_owned());
    let [info, score, up] = messages.each_ref().map(found);
    assert!(info.is_some() && info == score && info == up, "{messages:?}");
    info.unwrap()
}

#[test]
fn captured_sensor_streams_are_read_by_their_remedy() {
    let system = System::new("");
    let frame = |kind: u8, numbers: [i16; 4]| -> Vec<u8> {
        let head = [vec![0x55, kind], numbers.iter().flat_map(|number| number.to_le_bytes()).collect()].concat();
        let sum = head.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
        [head, vec![sum]].concat()
    };
    let witmotion: Vec<u8> =
        (0..100).flat_map(|n| [frame(0x51, [0, 0, 2048, 0]), frame(0x52, [n, 0, 0, 0])].concat()).collect();
    let floats = |numbers: [f32; 3]| numbers.iter().flat_map(|number| number.to_be_bytes()).collect::<Vec<u8>>();
    let xsens: Vec<u8> = (0..100u16)
        .flat_map(|n| {
            let rate = [vec![0x80, 0x20, 12], floats([0.01 * f32::from(n), 0.0, 0.0])].concat();
            let items = [rate, vec![0x40, 0x20, 12], floats([0.0, 0.0, 9.8])].concat();
            let body = [vec![0xff, 0x36, u8::try_from(items.len()).unwrap()], items].concat();
            let sum = body.iter().fold(0u8, |sum, byte| sum.wrapping_sub(*byte));
            [vec![0xfa], body, vec![sum]].concat()
        })
        .collect();
    for (name, bytes) in [("witmotion.bin", witmotion), ("xsens.bin", xsens)] {
        let file = system.path(name);
        fs::write(&file, bytes).unwrap();
        let message = refusal(&file);
        let line = commands(&message)[0].replacen("plumb up", "plumb up launch.toml --speed max --json", 1);
        let output = shell(&system, &line);
        let stdout = text(&output.stdout);
        assert!(stdout.contains("\"ticks_in\":100,"), "{line}: {stdout}{}", text(&output.stderr));
    }
}
