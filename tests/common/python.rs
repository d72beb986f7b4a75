//! A Python with the packages of others that tests compare with, in an environment of its own.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::{self, Command},
    sync::LazyLock,
};

const PACKAGES: &str = include_str!("../foreign/requirements.txt");
const READERS: &str = include_str!("../foreign/readers.txt");
const INSTALL: [&str; 5] = ["-m", "pip", "--disable-pip-version-check", "install", "--quiet"];

/// One environment for all tests, made once for this Python and what the lists say.
static PYTHON: LazyLock<Result<PathBuf, String>> = LazyLock::new(|| {
    let version = run(Command::new("python3").arg("--version"))?;
    let mut of = DefaultHasher::new();
    [PACKAGES, READERS, &version].hash(&mut of);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("python-{:016x}", of.finish()));
    if !folder.exists() {
        // Under its name there is a whole one only.
        let part = folder.with_extension(process::id().to_string());
        run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&part))?;
        for (list, name, dependencies) in
            [(PACKAGES, "requirements.txt", None), (READERS, "readers.txt", Some("--no-deps"))]
        {
            let file = part.join(name);
            fs::write(&file, list).map_err(|cause| cause.to_string())?;
            run(Command::new(part.join("bin/python")).args(INSTALL).args(dependencies).arg("-r").arg(file))?;
        }
        match fs::rename(&part, &folder) {
            // Somebody else made the same meanwhile.
            Err(_) if folder.exists() => _ = fs::remove_dir_all(part),
            renamed => renamed.map_err(|cause| cause.to_string())?,
        }
    }
    Ok(folder.join("bin/python"))
});

/// Says why where there is none, which under `CI` is a failure.
pub(crate) fn python() -> Option<&'static Path> {
    match &*PYTHON {
        Ok(python) => Some(python),
        Err(cause) => {
            let said = format!("no Python 3.11 or later with all packages of tests/foreign: {cause}");
            assert!(env::var_os("CI").is_none(), "{said}");
            eprintln!("skipped: {said}");
            None
        }
    }
}

/// What it said.
fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|cause| format!("{command:?}: {cause}"))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
}
