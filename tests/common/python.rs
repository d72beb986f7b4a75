//! A Python with packages of others, in an environment of its own.

use std::{
    env,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// A Python that imports `modules`, from the environment `name`, which is made with `packages` where it is not there; says why where it
/// cannot be, which under `CI` is a failure.
pub(crate) fn python(name: &str, modules: &str, packages: &[&str]) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let python = folder.join("bin/python");
    let check = Command::new(&python).args(["-c", &format!("import {modules}")]).stderr(Stdio::null()).status();
    if check.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    let run = |command: &mut Command| {
        let output = command.output().map_err(|cause| cause.to_string())?;
        if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
    };
    let made = run(Command::new("python3").args(["-m", "venv"]).arg(&folder))
        .and_then(|()| run(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(packages)));
    match made {
        Ok(()) => Some(python),
        Err(cause) => {
            assert!(env::var_os("CI").is_none(), "no Python with {}: {cause}", packages.join(" and "));
            eprintln!("skipped: no Python with {}: {cause}", packages.join(" and "));
            None
        }
    }
}
