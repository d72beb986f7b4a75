//! Variants `real` and `other`: `plumb up` with scenario S1. The results are taken from its own
//! report.

use std::{
    ffi::OsStr,
    fs,
    time::{Duration, Instant},
};

use crate::{Cost, Failure, process::Process};

/// Time allowed for `plumb` in addition to the duration of the run.
const MAX_OVERHEAD: Duration = Duration::from_secs(20);

/// Path of this build's executable.
pub(crate) const PLUMB: &str = env!("CARGO_BIN_EXE_plumb");

/// Services of the data path, as the other variants have them.
const SERVICES: &str = "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\"]\n";

/// Measures the variant that runs the `plumb` executable.
pub(crate) fn run(plumb: &OsStr, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let folder = tempfile::tempdir()?;
    let launch = folder.path().join("launch.toml");
    let name = format!("bench-real-{}", std::process::id());
    fs::write(
        &launch,
        format!(
            "name = \"{name}\"\n{SERVICES}[ingest.sim]\nscenario = \"s1\"\nrate_hz = {rate_hz}\n[fuser]\nstage = \"wz\"\n"
        ),
    )?;
    let launch = launch.to_str().ok_or("the path of the temporary folder is not valid UTF-8")?;
    let deadline = Instant::now() + Duration::from_secs_f64(seconds) + MAX_OVERHEAD;
    let mut plumb = Process::start(plumb, ["up", launch, "--for", &format!("{seconds}s"), "--json"])?;
    Ok(serde_json::from_str(&plumb.line(deadline)?)?)
}
