//! A Python with the readers and writers of others.

use std::{ffi::OsStr, path::Path, process::Command};

use crate::python::python;

/// The words of each line that a script says.
pub(crate) fn lines(script: &str, arguments: &[&OsStr]) -> Vec<Vec<String>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all").join(script);
    let output = Command::new(python().unwrap()).arg(script).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.split(' ').map(str::to_owned).collect()).collect()
}
