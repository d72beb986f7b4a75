//! Runs all slots in this process, bypassing the bus. Joins and results are the same as on the bus,
//! bit for bit.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use drivers::{
    reading_converter::DeviceReading,
    standard_input::{Next, StandardInput},
};
use launch::{Service, Source};
use messages::{FusedState, Header, ReceiverReading, Reference};
use pipeline::{AttitudeFile, Collector, Path};
use readings::{
    conditioner::{Conditioner, Sample},
    flight_replay::FlightReplay,
    source::{Reading, Readings, Truth, receiver_fix},
};
use runtime::{Pace, PacingTimer, clock::monotonic_ns};

use crate::{
    Plan, Report,
    error::UpError,
    input::InputChecker,
    processes::own_cpu_s,
    replayed_flight::{Flight, TakenReadings},
    report::{RunTotals, ServiceReport},
    terminal::announce,
    view::View,
};

/// Longest sleep between two checks for a stop signal.
const MAX_SLEEP: Duration = Duration::from_millis(50);
/// Minimum interval between two updates of the display, ns.
const VIEW_INTERVAL_NS: u64 = 100_000_000;

/// Runs the plan in this process.
///
/// # Errors
///
/// Returns an error if the source, a stage or the output file could not be opened. Later failures
/// are part of the report.
pub fn run(plan: &Plan, stop_requested: &AtomicBool) -> Result<Report, UpError> {
    let ingest = &plan.config.launch.ingest;
    let conditioner = Box::new(readings::conditioner(&plan.config)?);
    let samples = match ingest.source {
        Source::Stdin if ingest.live.receiver.port.is_some() => return Err(UpError::ReceiverWithoutBus),
        Source::Stdin => {
            Samples::StandardInput { input: Box::new(StandardInput::open(ingest)?), fix: None, conditioner }
        }
        _ => Samples::Source { readings: Box::new(Readings::open(&plan.config.launch)?), conditioner },
    };
    run_samples(plan, stop_requested, samples, Path::new(&plan.config)?)
}

/// Replays a recorded flight in this process, from its recorded readings and swaps.
///
/// # Errors
///
/// Returns an error if a stage or the output file could not be opened. Later failures are part of
/// the report.
pub fn replay(plan: &Plan, flight: Flight, stop_requested: &AtomicBool) -> Result<Report, UpError> {
    let path = Path::with_schedule(&plan.config, &flight.schedule)?;
    flight.schedule.warnings().iter().for_each(announce);
    let samples = Samples::Flight { readings: flight.readings, retaken: Box::new(FlightReplay::new(&plan.config)?) };
    run_samples(plan, stop_requested, samples, path)
}

/// Source of samples that counts the ticks and the rejected readings.
enum Samples {
    Source {
        readings: Box<Readings>,
        conditioner: Box<Conditioner>,
    },
    StandardInput {
        input: Box<StandardInput>,
        /// Newest fix, for the next reading.
        fix: Option<ReceiverReading>,
        conditioner: Box<Conditioner>,
    },
    Flight {
        readings: TakenReadings,
        retaken: Box<FlightReplay>,
    },
}

impl Samples {
    /// Returns the next sample, or `None` at the end. Waits for standard input until a stop is
    /// requested.
    fn next(&mut self, stop_requested: &AtomicBool, view: &View) -> Result<Option<Sample>, UpError> {
        match self {
            Self::StandardInput { input, fix, conditioner } => {
                while !stop_requested.load(Ordering::SeqCst) {
                    let next = input.next_reading()?;
                    view.announce(input.problem_changes(matches!(next, Next::End)));
                    match next {
                        Next::Reading(DeviceReading::Sensor(reading)) => {
                            let fix = fix.take().map(receiver_fix);
                            if let Some(sample) = conditioner.condition(&Reading { fix, ..reading.into() }) {
                                return Ok(Some(sample));
                            }
                        }
                        Next::Reading(DeviceReading::Fix(reading)) => *fix = Some(reading),
                        Next::NoData => {}
                        Next::End => break,
                    }
                }
            }
            Self::Source { readings, conditioner } => {
                for reading in readings {
                    let reading = reading?;
                    if let Some(sample) = conditioner.condition(&reading) {
                        return Ok(Some(sample));
                    }
                }
            }
            Self::Flight { readings, retaken } => {
                for reading in readings {
                    if let Some(sample) = retaken.sample(&reading.map_err(UpError::Flight)?)? {
                        return Ok(Some(sample));
                    }
                }
            }
        }
        Ok(None)
    }

    fn ticks(&self) -> u64 {
        match self {
            Self::Source { conditioner, .. } | Self::StandardInput { conditioner, .. } => conditioner.ticks(),
            Self::Flight { retaken, .. } => retaken.ticks(),
        }
    }

    /// Returns `true` if the samples may be delayed, because they are computed or read from a file.
    fn is_paced(&self) -> bool {
        match self {
            Self::Source { .. } | Self::Flight { .. } => true,
            Self::StandardInput { .. } => false,
        }
    }

    fn rejected(&self) -> u64 {
        match self {
            Self::Source { conditioner, .. } | Self::StandardInput { conditioner, .. } => conditioner.rejected(),
            Self::Flight { retaken, .. } => retaken.rejected(),
        }
    }
}

/// Processes all samples and creates the report.
fn run_samples(
    plan: &Plan,
    stop_requested: &AtomicBool,
    mut samples: Samples,
    mut path: Path,
) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_ref())?;
    let mut view = View::new(plan)?;
    let (start_ns, cpu_start_s) = (monotonic_ns(), own_cpu_s());
    let mut checker = InputChecker::default();
    let result = pump(plan, stop_requested, &mut samples, &mut path, &mut checker, (&mut collector, &mut view));
    view.announce(checker.finish());
    view.finish();
    let totals = RunTotals {
        warnings: checker.into_warnings(),
        ticks_in: samples.ticks(),
        ticks_out: None,
        rejected: samples.rejected(),
        lost_readings: 0,
        cpu_s_per_s: (own_cpu_s() - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9).max(1e-9),
        services: Service::PATH
            .map(|service| ServiceReport { name: service.name(), pid: Some(std::process::id()), restarts: 0 })
            .into(),
    };
    let is_empty = matches!(samples, Samples::StandardInput { .. }) && totals.ticks_in == 0;
    let failure = result.err().or_else(|| is_empty.then_some(UpError::NoReadings { source_name: "standard input" }));
    Ok(Report::new(collector, totals, failure))
}

fn pump(
    plan: &Plan,
    stop_requested: &AtomicBool,
    samples: &mut Samples,
    path: &mut Path,
    checker: &mut InputChecker,
    (collector, view): (&mut Collector, &mut View),
) -> Result<(), UpError> {
    let start_ns = monotonic_ns();
    let (mut first_ns, mut shown_ns) = (None, 0);
    let needs_fused = plan.out.as_ref().is_some_and(AttitudeFile::needs_fused);
    let mut fused = Vec::new();
    let mut timer = PacingTimer::for_current_thread();
    while !stop_requested.load(Ordering::SeqCst) && plan.config.max_ticks.is_none_or(|max| samples.ticks() < max) {
        let Some(mut sample) = samples.next(stop_requested, view)? else { break };
        let since_first_ns = sample.imu.header.t_end_ns - *first_ns.get_or_insert(sample.imu.header.t_end_ns);
        if let Pace::Speed(speed) = plan.config.pace
            && samples.is_paced()
        {
            let due_ns = start_ns + (since_first_ns as f64 / speed) as u64;
            while monotonic_ns() < due_ns && !stop_requested.load(Ordering::SeqCst) {
                timer.sleep_until_ns(due_ns, MAX_SLEEP);
            }
        }
        sample.imu.header.t_born_ns = monotonic_ns();
        sample.imu.header.epoch = runtime::service_config::FIRST_EPOCH;
        if let Some(Truth { quaternion, scored }) = sample.reference {
            let Header { tick, t_end_ns, .. } = sample.imu.header;
            collector.record_reference(Reference { tick, t_end_ns, scored: scored.into(), quaternion });
        }
        view.announce(checker.check(&sample.imu, sample.mag.as_ref()));
        let mut collect_fused = |state: &FusedState| {
            if needs_fused {
                fused.push(*state);
            }
        };
        path.offer_observed(sample, &mut collect_fused, &mut |mut output| {
            output.header.t_sent_ns = monotonic_ns();
            collector.record_attitude(&output);
        })?;
        fused.drain(..).for_each(|state| collector.record_fused(&state));
        if sample.imu.header.t_born_ns - shown_ns > VIEW_INTERVAL_NS {
            shown_ns = sample.imu.header.t_born_ns;
            view.show(collector, None, Duration::ZERO);
        }
    }
    Ok(())
}
