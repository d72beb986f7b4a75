//! `plumb up --replay FLIGHT.mcap`: a flight that is flown again, with the readings and the swaps that it had.

use std::path::Path;

use flight::{FlightError, messages_of};
use launch::Launch;
use messages::{Flags, FusedState, SystemEvent, TakenReading};
use supervisor::{Flight, Report, Request, UpError};

/// Flies it again. Nothing is recorded of that.
pub(crate) fn fly_again(request: &Request, path: &Path, is_recorded: bool) -> Result<Report, Box<UpError>> {
    if is_recorded {
        return Err(UpError::NoBus.into());
    }
    let unread = |error: FlightError| UpError::Flight(error.to_string());
    let launch = match &request.launch {
        Some(file) => Launch::read(file).map_err(UpError::from)?,
        None => {
            let text = flight::launch_file(path).map_err(unread)?;
            Launch::parse("launch.toml", &text).map_err(|error| UpError::Launch(error.into()))?
        }
    };
    let events: Vec<SystemEvent> = messages_of(path).map_err(unread)?.collect::<Result<_, _>>().map_err(unread)?;
    let given_up = given_up(path).map_err(unread)?;
    let mut readings = messages_of::<TakenReading>(path).map_err(unread)?.peekable();
    if readings.peek().is_none() {
        let why =
            "it has no readings; record it by `plumb up --record`, or beside a system that runs with `--readings`";
        return Err(UpError::Flight(format!("replaying {}: {why}", path.display())).into());
    }
    let readings = Box::new(readings.map(|taken| taken.map_err(|error| error.to_string())));
    let mut flight = Flight::new(launch, &events, readings)?;
    if let Some(tick) = given_up {
        flight
            .schedule
            .doubt(tick, "gyro or accelerometer came later than `lateness_s`, and the fuser went on without");
    }
    Ok(supervisor::replay(request, flight)?)
}

/// The first tick that was fused without one of its inputs.
fn given_up(path: &Path) -> Result<Option<u64>, FlightError> {
    let missing = Flags::GYRO_MISSING | Flags::ACCEL_MISSING;
    let is_without = |state: &FusedState| state.header.flags.any(missing);
    let first = messages_of::<FusedState>(path)?.find(|state| state.as_ref().map_or(true, is_without));
    Ok(first.transpose()?.map(|state| state.header.tick))
}
