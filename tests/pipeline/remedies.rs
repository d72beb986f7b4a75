//! Remedies that `import`, `info` and `score` print for files that they cannot read.
//!
//! Each command in a remedy is run in a shell, and the file that it writes is read.
use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use crate::common::{System, commands, data, plumb, python};

/// Commands that are not run. ROS 2 and `blackbox_decode` are in no registry of packages, no free
/// program writes RAR archives, and the installation of PyTables takes too long.
const NOT_RUN: [&str; 4] = ["ros2 bag reindex", "blackbox_decode", "unrar x", "pandas.read_hdf"];
/// Start of a Python program that reads the rows into a table `rows` of pandas.
macro_rules! with_pandas {
    ($rest:literal) => {
        concat!("python3 -c \"import pandas, sys; rows = pandas.read_csv('a.csv'); ", $rest, "\"")
    };
}
const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";

fn rows() -> String {
    (0..100).map(|n| format!("{}.{:02},0,0,0.{n:02},0,0,9.8\n", n / 100, n % 100)).collect()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs a line in a shell, in the folder of a system. The folders of `plumb` and of the tests'
/// Python come first in `PATH`.
fn shell(system: &System, line: &str) -> Output {
    let plumb = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().map(Path::to_owned);
    let python = python::python().and_then(Path::parent).map(Path::to_owned);
    let path = env::var_os("PATH").unwrap_or_default();
    let folders = python.into_iter().chain(plumb).chain(env::split_paths(&path));
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(system.folder.path()).env("PATH", env::join_paths(folders).unwrap());
    command.env("XDG_STATE_HOME", system.folder.path()).output().unwrap()
}

/// Returns `true` if the first program of a command is installed. If `CI` is set, the program must
/// be installed.
fn has_program(command: &str) -> bool {
    let name = command.split(' ').next().unwrap();
    let found = Command::new("sh").args(["-c", &format!("command -v {name}")]).output().unwrap().status.success();
    assert!(found || env::var_os("CI").is_none(), "install {name}");
    if !found {
        eprintln!("skipped: no program for {command}");
    }
    found
}

/// Returns the message about a file that all commands refuse to read.
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

/// Asserts that a file of 100 rows is read.
fn assert_read(file: &Path, arguments: &[&str]) {
    let output = plumb(&["info"]).arg(file).args(arguments).output().unwrap();
    let stdout = text(&output.stdout);
    assert!(stdout.contains("100 samples at 100.0 Hz"), "{}: {stdout}{}", file.display(), text(&output.stderr));
}

/// Name of a file, its origin, and the name of the file that the remedy creates. The origin is the
/// contents of the file or the command that packs `a.csv` into it.
type Case = (&'static str, Result<Vec<u8>, &'static str>, &'static str);

#[test]
fn conversions_of_refused_formats_yield_readable_files() {
    let system = System::new("");
    let csv = HEADER.to_owned() + &rows();
    let wide = |bytes: fn(u16) -> [u8; 2]| csv.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
    let utf_32: Vec<u8> = "\u{feff}".chars().chain(csv.chars()).flat_map(|c| u32::from(c).to_le_bytes()).collect();
    let cases: [Case; 16] = [
        ("my little.csv", Ok(wide(u16::to_le_bytes)), "my little.csv.csv"),
        ("my marked.csv", Ok([b"\xff\xfe".to_vec(), wide(u16::to_le_bytes)].concat()), "my marked.csv.csv"),
        ("my big.csv", Ok(wide(u16::to_be_bytes)), "my big.csv.csv"),
        ("my wide.csv", Ok(utf_32), "my wide.csv.csv"),
        ("my a.tar", Err("tar cf"), "a.csv"),
        ("my a.zip", Err("zip -q"), "a.csv"),
        ("my a.csv.zst", Err("zstd -q my\\ big.csv -o"), "my a.csv"),
        ("my b.csv.xz", Err("xz -c a.csv >"), "my b.csv"),
        ("my c.csv.bz2", Err("bzip2 -c a.csv >"), "my c.csv"),
        ("my e.csv.gz", Err("gzip -c my\\ big.csv >"), "my e.csv"),
        (
            "my f.npy",
            Err("python3 -c \"import numpy, sys; numpy.save(sys.argv[1], numpy.loadtxt('rows.csv', delimiter=','))\""),
            "my f.npy.csv",
        ),
        ("my g.csv.lz4", Err("lz4 -q a.csv"), "my g.csv"),
        ("my a.7z", Err("7z a -bd"), "a.csv"),
        ("my h.parquet", Err(with_pandas!("rows.to_parquet(sys.argv[1])")), "my h.parquet.csv"),
        ("my j.json", Err(with_pandas!("rows.to_json(sys.argv[1], orient='records')")), "my j.json.csv"),
        ("my k.xlsx", Err(with_pandas!("rows.to_excel(sys.argv[1], index=False)")), "my k.xlsx.csv"),
    ];
    fs::write(system.path("rows.csv"), rows()).unwrap();
    for (name, contents, result) in cases {
        let file = system.path(name);
        fs::write(system.path("a.csv"), &csv).unwrap();
        match contents {
            Ok(contents) => fs::write(&file, contents).unwrap(),
            Err(pack) if !has_program(pack) => continue,
            Err(pack) => {
                let file = format!(
                    "'{name}'{}",
                    if ["tar", "zip", "7z"].iter().any(|name| pack.starts_with(name)) { " a.csv" } else { "" }
                );
                let output = shell(&system, &format!("{pack} {file}"));
                assert!(output.status.success(), "{pack}: {}", text(&output.stderr));
            }
        }
        fs::remove_file(system.path("a.csv")).unwrap();
        let message = refusal(&file);
        let command = commands(&message)[0];
        if !has_program(command) {
            continue;
        }
        let output = shell(&system, command);
        assert!(output.status.success(), "{command}: {}", text(&output.stderr));
        if name.ends_with(".gz") || name.ends_with(".zst") {
            // The packed file is in UTF-16, so its remedy follows.
            assert!(refusal(&system.path(result)).contains("UTF-16BE"));
        } else {
            assert_read(&system.path(result), &[]);
        }
    }
}

/// Asserts that the first command of the remedy for a file reads all 100 readings of the file.
fn assert_remedy_reads(system: &System, file: &Path) {
    let message = refusal(file);
    let line = commands(&message)[0].replacen("plumb up", "plumb up --launch launch.toml --speed max --json", 1);
    let output = shell(system, &line);
    let stdout = text(&output.stdout);
    assert!(stdout.contains("\"ticks_in\":100,"), "{line}: {stdout}{}", text(&output.stderr));
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
        assert_remedy_reads(&system, &file);
    }
}

#[test]
fn dates_of_unknown_order_are_read_after_their_remedy() {
    let system = System::new("");
    let file = system.path("dates.csv");
    let date = |order: &str| -> String {
        let rows = rows();
        let lines = rows.lines().map(|row| row.split_once(',').unwrap());
        lines.map(|(t, row)| format!("{order} 10:00:0{t} AM,{row}\n")).collect()
    };
    for order in ["11/27/2026", "27/11/2026", "11/11/2026"] {
        fs::write(&file, HEADER.replace("t_s", "time") + &date(order)).unwrap();
        assert_read(&file, &[]);
    }
    fs::write(&file, HEADER.replace("t_s", "time") + &date("11/05/2026")).unwrap();
    let message = refusal(&file);
    let command = commands(&message)[0].replace("FILE", "dates.csv").replace("NEW", "new.csv");
    let output = shell(&system, &command);
    assert!(output.status.success(), "{command}: {}", text(&output.stderr));
    assert_read(&system.path("new.csv"), &[]);
    assert!(fs::read_to_string(system.path("new.csv")).unwrap().contains("\n2026-11-05 10:00:00.00 AM,"));
}

#[test]
fn live_dates_of_unknown_order_are_read_after_remedy() {
    let system = System::new("");
    let rows = rows();
    let lines = rows.lines().map(|row| row.split_once(',').unwrap());
    let dated: String = lines.map(|(t, row)| format!("11/05/2026 10:00:0{t} AM,{row}\n")).collect();
    let file = system.path("dates.csv");
    fs::write(&file, HEADER.replace("t_s", "t") + &dated).unwrap();
    let source = "stdin?rate_hz=100&columns=t,gx,gy,gz,ax,ay,az";
    let up = |source: &str| {
        let up = "plumb up --launch launch.toml --speed max --json";
        format!("{up} --source '{source}&map=t=t,gx=gx,gy=gy,gz=gz,ax=ax,ay=ay,az=az'")
    };
    let rejected = shell(&system, &format!("{} < dates.csv", up(source)));
    let message = text(&rejected.stderr);
    assert_eq!(rejected.status.code(), Some(1), "{message}");
    let remedy = "standard input: the first number of the date is the month or the day in ";
    let (_, message) = message.split_once(remedy).unwrap_or_else(|| panic!("{message}"));
    let filter = commands(message)[0];
    let without_time = up(source).replace("map=t=t,", "map=");
    for line in [format!("{filter} dates.csv | {}", up(source)), format!("{without_time} < dates.csv")] {
        let output = shell(&system, &line);
        let stdout = text(&output.stdout);
        assert!(output.status.success() && stdout.contains("\"ticks_in\":100,"), "{line}: {}", text(&output.stderr));
    }
}

#[test]
fn text_with_constant_times_is_read_by_its_remedy() {
    let system = System::new("");
    let file = system.path("a b.csv");
    let constant: String = rows().lines().map(|row| format!("5.0,{}\n", row.split_once(',').unwrap().1)).collect();
    fs::write(&file, HEADER.replace("t_s", "time (s)") + &constant).unwrap();
    assert_remedy_reads(&system, &file);
}

/// Each command in the table of formats must be run by a test above or be listed in [`NOT_RUN`].
#[test]
fn every_conversion_is_in_a_list() {
    let table = include_str!("../../tools/import/src/format.rs");
    let run = [
        "iconv",
        "unzip",
        "tar xf",
        "gunzip",
        "zstd -d",
        "unxz",
        "bunzip2",
        "numpy.savetxt",
        "unlz4 -m",
        "7z x",
        "pandas.read_parquet",
        "pandas.read_json",
        "pandas.read_excel",
        "mavlogdump.py",
        "rosbags-convert",
        "plumb up",
        "plumb record",
        "--map",
        "lines=True",
        "writematrix",
        "csvwrite",
    ];
    let strings: String = table.lines().filter(|line| !line.trim_start().starts_with("///")).collect();
    for command in commands(&strings) {
        let is_listed = run.iter().chain(&NOT_RUN).any(|listed| command.contains(listed));
        assert!(is_listed, "{command} is neither run nor named as not run");
    }
}

#[test]
fn json_lines_are_read_after_their_conversion() {
    let system = System::new("");
    if python::python().is_none() {
        return;
    }
    fs::write(system.path("a.csv"), HEADER.to_owned() + &rows()).unwrap();
    let pack = with_pandas!("rows.to_json(sys.argv[1], orient='records', lines=True)");
    let output = shell(&system, &format!("{pack} l.json"));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let message = refusal(&system.path("l.json"));
    let [command, lines] = commands(&message).try_into().unwrap();
    let command = command.replace("(sys.argv[1])", &format!("(sys.argv[1], {lines})"));
    let output = shell(&system, &command);
    assert!(output.status.success(), "{command}: {}", text(&output.stderr));
    assert_read(&system.path("l.json.csv"), &[]);
}

#[recorded::test]
fn ardupilot_text_is_read_after_its_conversion() {
    let (Some(folder), Some(python)) = (data(), python::python()) else { return };
    let system = System::new("");
    let file = system.path("my log.log");
    fs::copy(folder.join("reports/dataflash.log"), &file).unwrap();
    let message = refusal(&file);
    let [command, mapping] = commands(&message).try_into().unwrap();
    // If the virtual environment was moved, its scripts name a Python that does not exist.
    let script = format!("python3 {}", python.with_file_name("mavlogdump.py").display());
    let output = shell(&system, &command.replace("mavlogdump.py", &script));
    assert!(output.status.success(), "{command}: {}", text(&output.stderr));
    let output = shell(&system, &format!("plumb info 'my log.log.csv' {mapping}"));
    let stdout = text(&output.stdout);
    assert!(output.status.success() && stdout.contains(" samples at 50.0 Hz"), "{stdout}{}", text(&output.stderr));
}

#[test]
fn ros_1_bag_is_read_after_its_conversion() {
    let Some(python) = python::python() else { return };
    let system = System::new("");
    let file: PathBuf = system.path("my walk.bag");
    let script = "import sys, numpy
from pathlib import Path
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS1_NOETIC); types = store.types
vector = types['geometry_msgs/msg/Vector3']
with Writer(Path(sys.argv[1])) as writer:
    topic = writer.add_connection('/imu', 'sensor_msgs/msg/Imu', typestore=store)
    for n in range(100):
        stamp = types['builtin_interfaces/msg/Time'](sec=10, nanosec=n * 10000000)
        message = types['sensor_msgs/msg/Imu'](
            types['std_msgs/msg/Header'](seq=n, stamp=stamp, frame_id='imu'),
            types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0), numpy.zeros(9),
            vector(0.0, 0.0, 0.01 * n), numpy.zeros(9), vector(0.0, 0.0, 9.8), numpy.zeros(9))
        writer.write(topic, 10**10 + n * 10**7, store.serialize_ros1(message, 'sensor_msgs/msg/Imu'))
";
    let output = Command::new(python).args(["-c", script]).arg(&file).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let message = refusal(&file);
    // If the virtual environment was moved, its path lacks the script of the package, so the module
    // is run instead.
    let command = commands(&message)[0].replace("rosbags-convert", "python3 -m rosbags.convert");
    let output = shell(&system, &command);
    assert!(output.status.success(), "{message}: {}", text(&output.stderr));
    assert_read(&system.path("my walk"), &[]);
}
