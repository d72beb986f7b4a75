//! A Python with the packages of others that tests compare with, in an environment of its own.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::Command,
    sync::LazyLock,
};

const PACKAGES: &str = include_str!("../foreign/requirements.txt");
const READERS: &str = include_str!("../foreign/readers.txt");
const INSTALL: [&str; 5] = ["-m", "pip", "--disable-pip-version-check", "install", "--quiet"];

/// One environment for all tests, made once for what the lists say.
static PYTHON: LazyLock<Result<PathBuf, String>> = LazyLock::new(|| {
    let mut lists = DefaultHasher::new();
    [PACKAGES, READERS].hash(&mut lists);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("python-{:016x}", lists.finish()));
    if !folder.exists() {
        // Under its name there is a whole one only.
        let part = folder.with_extension("part");
        run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&part))?;
        for (list, name, dependencies) in
            [(PACKAGES, "requirements.txt", None), (READERS, "readers.txt", Some("--no-deps"))]
        {
            let file = part.join(name);
            fs::write(&file, list).map_err(|cause| cause.to_string())?;
            run(Command::new(part.join("bin/python")).args(INSTALL).args(dependencies).arg("-r").arg(file))?;
        }
        fs::rename(&part, &folder).map_err(|cause| cause.to_string())?;
    }
    Ok(folder.join("bin/python"))
});

/// Says why where there is none, which under `CI` is a failure.
pub(crate) fn python() -> Option<&'static Path> {
    match &*PYTHON {
        Ok(python) => Some(python),
        Err(cause) => {
            assert!(env::var_os("CI").is_none(), "no Python with the packages of tests/foreign: {cause}");
            eprintln!("skipped: no Python with the packages of tests/foreign: {cause}");
            None
        }
    }
}

fn run(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|cause| cause.to_string())?;
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}
