//! A Python with the readers and writers of others.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    process::Command,
    sync::LazyLock,
};

use crate::python::python;

const PACKAGES: [&str; 5] =
    ["mcap==1.6.0", "mcap-protobuf-support==0.6.0", "pymavlink==2.4.50", "pyulog==1.3.0", "rosbags==0.11.9"];

/// Made once; says why where there is none.
pub(crate) static PYTHON: LazyLock<Option<PathBuf>> =
    LazyLock::new(|| python("formats-venv", "mcap, mcap_protobuf, pymavlink, pyulog, rosbags", &PACKAGES));

/// The words of each line that a script says.
pub(crate) fn lines(script: &str, arguments: &[&OsStr]) -> Vec<Vec<String>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all").join(script);
    let output = Command::new(PYTHON.as_ref().unwrap()).arg(script).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.split(' ').map(str::to_owned).collect()).collect()
}
