//! Tests of C programs that use the installed library.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::{
    env, fs,
    io::{Read, Write},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
};

use flate2::read::GzDecoder;
use plumbline_ahrs::Ahrs;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const STRICT: [&str; 5] = ["-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"];

fn run(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs `make install-files` into `prefix`, with the libraries that this test was built with.
fn install(prefix: &Path) {
    let deps = env::current_exe().unwrap().parent().unwrap().to_owned();
    run(Command::new("make")
        .args(["-C", ROOT, "install-files"])
        .arg(format!("PREFIX={}", prefix.display()))
        .arg(format!("BUILT={}", deps.display())));
}

/// Compiles a program with the compiler flags from pkg-config.
fn compile(prefix: &Path, compiler: &str, source: &Path, is_static: bool) -> PathBuf {
    let flags = run(Command::new("pkg-config")
        .env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig"))
        .args(["--cflags", "--libs", "plumbline_ahrs"])
        .args(is_static.then_some("--static")));
    let (language, standard) = if compiler == "cc" { ("c", "-std=c99") } else { ("c++", "-std=c++11") };
    let program = prefix.join(format!("{compiler}-{is_static}"));
    // Without the shared library, the linker uses the static one.
    let flags =
        flags.replace("-lplumbline_ahrs", if is_static { "-l:libplumbline_ahrs.a" } else { "-lplumbline_ahrs" });
    run(Command::new(compiler)
        .args(STRICT)
        .args([standard, "-x", language])
        .arg(source)
        .args(["-x", "none", "-o"])
        .arg(&program)
        .args(flags.split_whitespace())
        .arg("-lm"));
    program
}

fn recording() -> String {
    let file = fs::File::open(Path::new(ROOT).join("../../samples/broad.csv.gz")).unwrap();
    let mut text = String::new();
    GzDecoder::new(file).read_to_string(&mut text).unwrap();
    text
}

/// Returns the quaternion and heading of each sample, as computed by the Rust crate.
fn expected(recording: &str) -> Vec<[u64; 5]> {
    let mut ahrs = Ahrs::new();
    let lines = recording.lines().skip(1).map(|line| {
        let values: Vec<f64> = line.split(',').take(10).map(|text| text.parse().unwrap()).collect();
        let vector = |first: usize| [values[first], values[first + 1], values[first + 2]];
        let t_ns = (values[0] * 1e9).round() as i64;
        let attitude = ahrs.update_at(vector(1), vector(4), Some(vector(7)), t_ns);
        let [w, x, y, z] = attitude.quaternion();
        [w, x, y, z, attitude.heading_rad()].map(f64::to_bits)
    });
    lines.collect()
}

#[test]
fn example_has_the_bits_of_the_rust_crate() {
    let folder = tempfile::tempdir().unwrap();
    install(folder.path());
    let recording = recording();
    let expected = expected(&recording);
    assert!(expected.len() > 5000);
    let source = Path::new(ROOT).join("examples/ahrs.c");
    for (compiler, is_static) in [("cc", false), ("c++", true)] {
        let program = compile(folder.path(), compiler, &source, is_static);
        let mut child = Command::new(&program)
            .env("LD_LIBRARY_PATH", folder.path().join("lib"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        let text = recording.clone();
        let writer = thread::spawn(move || input.write_all(text.as_bytes()));
        let output = child.wait_with_output().unwrap();
        writer.join().unwrap().unwrap();
        assert!(output.status.success());
        let found: Vec<[u64; 5]> = String::from_utf8(output.stdout)
            .unwrap()
            .lines()
            .map(|line| {
                let mut values = line.split(',').map(|text| text.parse::<f64>().unwrap().to_bits());
                [(); 5].map(|()| values.next().unwrap())
            })
            .collect();
        assert!(found == expected, "{compiler}: the attitudes differ");
    }
}

#[test]
fn interface_reports_errors_and_allocates_nothing() {
    let folder = tempfile::tempdir().unwrap();
    install(folder.path());
    let source = Path::new(ROOT).join("tests/interface.c");
    for compiler in ["cc", "c++"] {
        let program = compile(folder.path(), compiler, &source, false);
        let output = run(Command::new(program).env("LD_LIBRARY_PATH", folder.path().join("lib")));
        assert_eq!(output, "ok\n");
    }
}
