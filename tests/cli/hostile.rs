//! Text from untrusted sources cannot control the terminal or forge a line of output, whichever
//! command prints the text.
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use crate::common::{System, plumb};

/// Hostile text for a file name. It sets the window title, clears the screen, reorders text and
/// forges a line.
const HOSTILE: &str = "\x1b]0;owned\x07\x1b[2J\u{9b}2J\u{202e}\nFORGED: all is well";
/// Hostile text without a line break, for a column name or a value in a CSV file.
const HOSTILE_FIELD: &str = "\x1b]0;owned\x07\x1b[2J\u{9b}2J\u{202e}\rFORGED";
const RECORDING: &str = "t_s,gx,gy,gz,ax,ay,az\n";

/// Runs a command and checks its output.
fn assert_harmless(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert_output_harmless(&output, command);
    output
}

/// Checks that the output of a command has no effect on a terminal.
fn assert_output_harmless(output: &Output, command: &Command) {
    let text = String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned();
    let is_effective = |letter: char| letter.is_control() && letter != '\n' || letter == '\u{202e}';
    assert!(!text.contains(is_effective), "{command:?}: {text:?}");
    assert!(!text.lines().any(|line| line.starts_with("FORGED")), "{command:?}: {text}");
}

fn row(number: u32) -> String {
    format!("{},0,0,0,0,0,9.8\n", f64::from(number) * 0.01)
}

/// Writes a file to a folder. The names of both are hostile.
fn write_file(folder: &Path, extension: &str, content: &[u8]) -> PathBuf {
    let folder = folder.join(format!("folder{HOSTILE}"));
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join(format!("file{HOSTILE}.{extension}"));
    fs::write(&file, content).unwrap();
    file
}

#[test]
fn names_and_contents_of_files_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let rows: String = (0..200).map(row).collect();
    let contents = [
        ("csv", format!("{RECORDING}{rows}")),
        ("csv", format!("{RECORDING}{rows}2.1,{HOSTILE_FIELD},0,0,0,0,9.8\n{}", row(211))),
        ("csv", format!("t_s,gx,gy,gz,ax,ay,az,{HOSTILE_FIELD}\n{}", rows.replace('\n', ",1\n"))),
        ("csv", format!("gyro_x (deg/s){HOSTILE_FIELD},gx,gx,ax\n{rows}")),
        ("csv", format!("{HOSTILE_FIELD};wx;wy\n1;2;3\n")),
        ("csv", String::new()),
        ("mcap", format!("\u{89}MCAP0\r\n{HOSTILE}")),
        ("ulg", format!("ULog{HOSTILE}")),
        ("db3", format!("SQLite format 3\0{HOSTILE}")),
        ("toml", format!("name = \"{HOSTILE}\"\n[{HOSTILE}]\n")),
    ];
    for (number, (extension, content)) in contents.iter().enumerate() {
        let file = write_file(&folder.path().join(number.to_string()), extension, content.as_bytes());
        let file = file.to_str().unwrap();
        let out = folder.path().join(format!("out{HOSTILE}{number}.csv"));
        for arguments in [
            &["info", file][..],
            &["import", file, "-o", out.to_str().unwrap()],
            &["import", file, "-o", "/nowhere/x.csv"],
            &["score", file, "--fuser", "vqf"],
            &["score", "sim:s1?duration_s=1", "--fuser", "vqf", "--launch", file],
            &["up", "--in-process", "--speed", "max", "--replay", file],
            &["up", "--in-process", "--speed", "max", "--out", file, "--replay", file],
            &["up", "--launch", file, "--for", "1s"],
            &["config", "check", "--launch", file],
            &["stage", "list", "--launch", file],
            &["calibrate", "gyro", file],
            &["detect", file],
        ] {
            assert_harmless(&mut plumb(arguments));
        }
    }
}

#[test]
fn values_of_launch_file_are_escaped() {
    let hostile = HOSTILE.escape_default().to_string().replace("\\u{9b}", "\\u009b").replace("\\u{202e}", "\\u202e");
    let hostile = hostile.replace("\\u{1b}", "\\u001b").replace("\\u{7}", "\\u0007");
    let system = System::new(&format!(
        "[ingest]\nsource = \"replay\"\n[ingest.replay]\nfile = \"{hostile}\"\n\
         [cockpit.tls]\ncert = \"{hostile}\"\nkey = \"{hostile}\"\n\
         [stages.evil]\nslot = \"fuser\"\ncommand = [\"{hostile}\", \"{hostile}\"]\n"
    ));
    let launch = system.path("launch.toml");
    let launch = launch.to_str().unwrap();
    for arguments in [
        &["up", "--launch", launch, "--for", "1s"][..],
        &["up", "--launch", launch, "--source", "sim", "--for", "1s", "--record", HOSTILE_FIELD],
        &["config", "check", "--launch", launch],
        &["stage", "test", "evil", "--launch", launch],
        &["score", "sim:s1?duration_s=1", "--fuser", "evil", "--launch", launch],
    ] {
        assert_harmless(plumb(arguments).current_dir(system.folder.path()));
    }
}

/// Stage program that prints hostile text at every request and describes its parameter with hostile
/// text. It exits at its first step, or at the first request if it has an argument.
const PROGRAM: &str = r#"
import os, socket, struct, sys
HOSTILE = "\x1b]0;owned\x07\x1b[2J\u009b2J\u202e"
requests = socket.socket(fileno=0)
while request := requests.recv(16384):
    version, kind, _, number = struct.unpack_from("<HHIQ", request)
    for stream in (1, 2):
        os.write(stream, (HOSTILE + "\nFORGED: all is well\n").encode())
    if kind == 3 or sys.argv[1:]:
        os._exit(3)
    description = f"slot\tfuser\nparameter\tp{HOSTILE}\t{HOSTILE}\t1.0\t0.0\t2.0\t{HOSTILE}"
    response = description.encode() if kind == 1 else b""
    requests.send(struct.pack("<HHIQ", version, kind, 0, number) + response)
"#;

#[test]
fn output_of_stage_program_is_escaped() {
    let stage = |name: &str, arguments: &str| {
        format!("[stages.{name}]\nslot = \"fuser\"\ncommand = [\"python3\", \"program.py\"{arguments}]\n")
    };
    let stages = stage("steps", "") + &stage("exits", ", \"now\"");
    let system = System::new(&format!("[fuser]\nstage = \"exits\"\n[restart]\nlimit = 1\n{stages}"));
    fs::write(system.path("program.py"), PROGRAM).unwrap();
    let launch = system.path("launch.toml");
    let launch = launch.to_str().unwrap();
    let simulation = "sim:s1?duration_s=1";
    for arguments in [
        &["stage", "test", "exits", "--launch", launch][..],
        &["score", simulation, "--fuser", "steps", "--launch", launch],
        &["score", simulation, "--fuser", "steps", "--launch", launch, "--set", "q=1"],
        &["up", "--launch", launch, "--for", "1s"],
    ] {
        let output = assert_harmless(plumb(arguments).env("XDG_STATE_HOME", system.folder.path()));
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains("  | FORGED: all is well"), "{arguments:?}: {text}");
    }
}

#[test]
fn lines_of_source_are_escaped() {
    let system = System::new("");
    let mut command =
        plumb(&["up", "--launch", system.path("launch.toml").to_str().unwrap(), "--source", "stdin?rate_hz=100"]);
    command.env("XDG_STATE_HOME", system.folder.path()).stdin(Stdio::piped());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let header = format!("t,gx (deg/s),gy (rad/s),gz,ax,ay,az,{HOSTILE_FIELD}\n");
    let lines = [header, format!("{HOSTILE}\n").repeat(50)].concat();
    child.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_output_harmless(&output, &command);
}
