//! The pipeline as it is: `plumb up` on S1's scenario, with its own report.

use std::{
    ffi::OsStr,
    fs,
    time::{Duration, Instant},
};

use crate::{Cost, Failure, process::Process};

/// What `plumb` may take beside the run itself.
const LIMIT: Duration = Duration::from_secs(20);

/// The executable of this build.
pub(crate) const PLUMB: &str = env!("CARGO_BIN_EXE_plumb");

/// Measures the variant.
pub(crate) fn run(plumb: &OsStr, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let folder = tempfile::tempdir()?;
    let launch = folder.path().join("launch.toml");
    let name = format!("bench-real-{}", std::process::id());
    fs::write(
        &launch,
        format!("name = \"{name}\"\n[ingest.sim]\nscenario = \"s1\"\nrate_hz = {rate_hz}\n[fuser]\nstage = \"wz\"\n"),
    )?;
    let launch = launch.to_str().ok_or("the name of the folder for temporary files is not text")?;
    let deadline = Instant::now() + Duration::from_secs_f64(seconds) + LIMIT;
    let mut plumb = Process::start(plumb, ["up", launch, "--for", &format!("{seconds}s"), "--json"])?;
    Ok(serde_json::from_str(&plumb.line(deadline)?)?)
}
