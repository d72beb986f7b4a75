//! Python environment with the third-party packages used for comparison.

use std::{
    env, fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::{self, Command},
    sync::LazyLock,
};

const PACKAGES: &str = include_str!("../foreign/requirements.txt");
const READERS: &str = include_str!("../foreign/readers.txt");
const FILTERS: &str = include_str!("../../benches/accuracy/requirements.txt");
const INSTALL: [&str; 5] = ["-m", "pip", "--disable-pip-version-check", "install", "--quiet"];

/// One environment for all tests, created once per Python version and package list.
static PYTHON: LazyLock<Result<PathBuf, String>> = LazyLock::new(|| {
    let version = run(Command::new("python3").arg("--version"))?;
    let mut hasher = DefaultHasher::new();
    [PACKAGES, READERS, FILTERS, &version].hash(&mut hasher);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("python-{:016x}", hasher.finish()));
    if !folder.exists() {
        // The folder gets its final name only once the environment is complete.
        let part = folder.with_extension(process::id().to_string());
        run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&part))?;
        for (list, name, dependencies) in [
            (PACKAGES, "requirements.txt", None),
            (FILTERS, "filters.txt", None),
            (READERS, "readers.txt", Some("--no-deps")),
        ] {
            let file = part.join(name);
            fs::write(&file, list).map_err(|cause| cause.to_string())?;
            run(Command::new(part.join("bin/python")).args(INSTALL).args(dependencies).arg("-r").arg(file))?;
        }
        match fs::rename(&part, &folder) {
            // Another process has created the environment in the meantime.
            Err(_) if folder.exists() => _ = fs::remove_dir_all(part),
            renamed => renamed.map_err(|cause| cause.to_string())?,
        }
    }
    Ok(folder.join("bin/python"))
});

/// Returns the Python executable. If it is not available, prints the reason and returns `None`; if
/// `CI` is set, panics instead.
pub(crate) fn python() -> Option<&'static Path> {
    match &*PYTHON {
        Ok(python) => Some(python),
        Err(cause) => {
            let message =
                format!("no Python 3.11 or later with all packages of tests/foreign and benches/accuracy: {cause}");
            assert!(env::var_os("CI").is_none(), "{message}");
            eprintln!("skipped: {message}");
            None
        }
    }
}

/// Runs a command. Returns its standard output, or its standard error as the error.
fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|cause| format!("{command:?}: {cause}"))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
}
