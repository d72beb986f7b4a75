//! `plumb up --replay FLIGHT.mcap`: replays a flight with its readings and swaps.

use std::path::Path;

use flight::{FlightError, read_messages};
use launch::Launch;
use messages::{Flags, FusedState, SystemEvent, TakenReading};
use supervisor::{Flight, Report, Request, UpError};

/// Replays a flight. A replay has no bus, so it cannot be recorded.
///
/// The flight's own launch file may name any program as a stage. Such programs are started only if
/// `trust_programs` is `true`, in the current folder.
pub(crate) fn replay_flight(request: &Request, path: &Path, trust_programs: bool) -> Result<Report, Box<UpError>> {
    if request.record.is_some() {
        return Err(UpError::NoBus.into());
    }
    let flight_error = |error: FlightError| UpError::Flight(error.to_string());
    let launch = match &request.launch {
        Some(file) => Launch::read(file).map_err(UpError::from)?,
        None => {
            let text = flight::read_launch_file(path).map_err(flight_error)?;
            Launch::parse("launch.toml", &text).map_err(|error| UpError::Launch(error.into()))?
        }
    };
    let events: Vec<SystemEvent> =
        read_messages(path).map_err(flight_error)?.collect::<Result<_, _>>().map_err(flight_error)?;
    let first_incomplete_tick = first_incomplete_tick(path).map_err(flight_error)?;
    let mut readings = read_messages::<TakenReading>(path).map_err(flight_error)?.peekable();
    if readings.peek().is_none() {
        let reason =
            "it contains no readings; record it with `plumb up --record`, or from a system started with `--readings`";
        return Err(UpError::Flight(format!("replaying {}: {reason}", foreign::path(path))).into());
    }
    let readings = Box::new(readings.map(|taken| taken.map_err(|error| error.to_string())));
    let mut flight = Flight::new(launch, &events, readings)?;
    if request.launch.is_none() {
        match flight.external_stage() {
            Some((name, stage)) if !trust_programs => {
                let (stage, command) = (name.into(), stage.command.join(" ").into());
                return Err(UpError::UntrustedProgram { stage, command }.into());
            }
            _ => flight.launch.stages.values_mut().for_each(|stage| stage.folder = ".".into()),
        }
    }
    if let Some(tick) = first_incomplete_tick {
        flight
            .schedule
            .add_warning(tick, "gyro or accelerometer exceeded `lateness_s`, so the fuser continued without it");
    }
    Ok(supervisor::replay(request, flight)?)
}

/// Returns the first tick that was fused without one of its inputs.
fn first_incomplete_tick(path: &Path) -> Result<Option<u64>, FlightError> {
    let missing = Flags::GYRO_MISSING | Flags::ACCEL_MISSING;
    let is_incomplete = |state: &FusedState| state.header.flags.any(missing);
    let first = read_messages::<FusedState>(path)?.find(|state| state.as_ref().map_or(true, is_incomplete));
    Ok(first.transpose()?.map(|state| state.header.tick))
}
