//! Python scripts that run the reference readers and writers.

use std::{ffi::OsStr, path::Path, process::Command};

use crate::python::python;

/// Runs a script and returns the words of each line of its output.
pub(crate) fn run_script(script: &str, arguments: &[&OsStr]) -> Vec<Vec<String>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all").join(script);
    let output = Command::new(python().unwrap()).arg(script).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.split(' ').map(str::to_owned).collect()).collect()
}
