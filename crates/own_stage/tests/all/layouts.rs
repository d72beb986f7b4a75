//! What is written for other languages lays the messages out as Rust does.
use std::{
    fs,
    io::ErrorKind,
    path::Path,
    process::{Command, Output},
};

use messages::{Field, Header, Layout};

/// What the program says; `None`, said, where there is no such program.
fn run(command: &mut Command) -> Option<Output> {
    match command.output() {
        Ok(output) => Some(output),
        Err(cause) if cause.kind() == ErrorKind::NotFound => {
            eprintln!("skipped: there is no {}", command.get_program().display());
            None
        }
        Err(cause) => panic!("{}: {cause}", command.get_program().display()),
    }
}

#[test]
fn the_header_and_the_module_are_the_golden_ones() {
    let golden = [
        (
            own_stage::c::header(),
            include_str!("../../golden/plumbline.h"),
            "plumb stage header > crates/own_stage/golden/plumbline.h",
        ),
        (
            own_stage::python::messages(),
            include_str!("../../python/plumbline/messages.py"),
            "plumb stage header --lang python > crates/own_stage/python/plumbline/messages.py",
        ),
    ];
    for (now, golden, remedy) in golden {
        assert!(now == golden, "a message changed: raise the version in its name, then `{remedy}`");
    }
}

#[test]
fn every_file_of_the_package_is_written() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/python/plumbline");
    let there = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut there: Vec<_> = there.filter(|name| name.ends_with(".py")).collect();
    let mut written: Vec<_> = own_stage::python::package().into_iter().map(|(name, _)| name).collect();
    there.sort();
    written.sort_unstable();
    assert_eq!(there, written);
}

const C: &str = r#"#include "plumbline.h"
int main(void) {
    struct plumbline_imu_sample sample = {.header = {.tick = 7, .flags = PLUMBLINE_FLAG_GAP}};
    return sample.header.tick == 7 && sizeof(PLUMBLINE_TOPIC_IMU_SAMPLE) == 4 ? 0 : 1;
}
"#;

#[test]
fn the_header_compiles_and_its_assertions_hold() {
    let folder = tempfile::tempdir().unwrap();
    let [source, header, program] = ["t.c", "plumbline.h", "t"].map(|name| folder.path().join(name));
    fs::write(&source, C).unwrap();
    let compile = |text: &str| {
        fs::write(&header, text).unwrap();
        run(Command::new("cc").args(["-std=c11", "-Wall", "-Werror", "-pedantic", "-o"]).arg(&program).arg(&source))
    };
    let Some(output) = compile(&own_stage::c::header()) else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(run(&mut Command::new(&program)).unwrap().status.success());
    let moved = own_stage::c::header().replace("    double z_rad;", "    double y_rad, z_rad;");
    let said = String::from_utf8(compile(&moved).unwrap().stderr).unwrap();
    assert!(said.contains("size of gyro_step") && said.contains("place of chart"), "{said}");
}

const PRINT: &str = r#"
import ctypes, messages

def fields(structure, base=0):
    for name, kind in structure._fields_:
        place = base + getattr(structure, name).offset
        if issubclass(kind, ctypes.Structure):
            yield from fields(kind, place)
        else:
            element, count = getattr(kind, "_type_", kind), getattr(kind, "_length_", 1)
            element = element if isinstance(element, str) else element._type_
            yield f"{name}:{ctypes.sizeof(kind) // count}x{count}{'f' if element == 'd' else ''}@{place}"

for message in (messages.Header, *messages.MESSAGES):
    of = [message.type_name(), message.TOPIC, message.LAYOUT] if message.__name__ != "Header" else []
    print("|".join([message.__name__, *of, str(ctypes.sizeof(message)), *fields(message)]))
"#;

#[test]
fn what_python_sees_is_what_rust_sees() {
    let module = concat!(env!("CARGO_MANIFEST_DIR"), "/python/plumbline");
    assert!(Path::new(module).is_dir());
    let mut python = Command::new("python3");
    let Some(output) = run(python.args(["-c", PRINT]).env("PYTHONPATH", module).env("PYTHONDONTWRITEBYTECODE", "1"))
    else {
        return;
    };
    let said = String::from_utf8(output.stdout).unwrap();
    let expected: Vec<String> = [vec![Header::layout()], messages::layouts()].concat().iter().map(line).collect();
    assert_eq!(said.lines().collect::<Vec<_>>(), expected, "{}", String::from_utf8_lossy(&output.stderr));
}

/// A layout as the program above prints it.
fn line(layout: &Layout) -> String {
    let class = layout.name.split('.').nth(1).unwrap().to_owned();
    let of = layout.topic.map(|topic| vec![layout.name.to_owned(), topic.to_owned(), layout.to_string()]);
    let fields = layout.fields.iter().map(field);
    let parts: Vec<String> =
        [class].into_iter().chain(of.into_iter().flatten()).chain([layout.size.to_string()]).chain(fields).collect();
    parts.join("|")
}

fn field(Field { name, kind, offset, .. }: &Field) -> String {
    let bytes = |scalar: &str| match scalar {
        "u8" => 1,
        "u32" | "State" => 4,
        _ => 8,
    };
    let (scalar, count) = match kind.strip_prefix('[').map(|rest| rest.trim_end_matches(']').split_once("; ").unwrap())
    {
        Some((scalar, "CHECKPOINT_WORDS")) => (scalar, messages::CHECKPOINT_WORDS),
        Some((scalar, count)) => (scalar, count.parse().unwrap()),
        None => (*kind, 1),
    };
    format!("{name}:{}x{count}{}@{offset}", bytes(scalar), if scalar == "f64" { "f" } else { "" })
}
