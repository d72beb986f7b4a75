//! A Python with the readers and writers of others.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::LazyLock,
};

const PACKAGES: [&str; 5] =
    ["mcap==1.6.0", "mcap-protobuf-support==0.6.0", "pymavlink==2.4.50", "pyulog==1.3.0", "rosbags==0.11.9"];

/// Made once; says why where there is none.
pub(crate) static PYTHON: LazyLock<Option<PathBuf>> = LazyLock::new(|| {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("formats-venv");
    let python = folder.join("bin/python");
    let imports = "import mcap, mcap_protobuf, pymavlink, pyulog, rosbags";
    let check = Command::new(&python).args(["-c", imports]).stderr(Stdio::null()).status();
    if check.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    let run = |command: &mut Command| {
        let output = command.output().map_err(|cause| cause.to_string())?;
        if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
    };
    let made = run(Command::new("python3").args(["-m", "venv"]).arg(&folder))
        .and_then(|()| run(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(PACKAGES)));
    match made {
        Ok(()) => Some(python),
        Err(cause) => {
            eprintln!("skipped: no Python with {}: {cause}", PACKAGES.join(", "));
            None
        }
    }
});

/// The words of each line that a script says.
pub(crate) fn lines(script: &str, arguments: &[&OsStr]) -> Vec<Vec<String>> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all").join(script);
    let output = Command::new(PYTHON.as_ref().unwrap()).arg(script).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.split(' ').map(str::to_owned).collect()).collect()
}
