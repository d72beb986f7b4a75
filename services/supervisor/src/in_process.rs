//! All slots in this process, without the bus: the same slots, the same join, the same bytes.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use ingest::{
    conditioner::{Conditioner, Sample},
    retaken::Retaken,
    source::{Readings, Truth},
};
use launch::Service;
use messages::{FusedState, Reference};
use pipeline::{Collector, OutFile, Path};
use runtime::{
    Pace,
    clock::{monotonic_ns, sleep_until_ns},
};

use crate::{
    Plan, Report, UpError, announce,
    flight::{Flight, TakenReadings},
    input::InputJudge,
    processes::own_cpu_s,
    report::{Account, ServiceReport},
    view::View,
};

/// Longest sleep before looking for a signal.
const SLEEP_LIMIT: Duration = Duration::from_millis(50);
/// How often people see something new, ns.
const VIEW_INTERVAL_NS: u64 = 100_000_000;

/// Runs the plan in this process.
pub fn run(plan: &Plan, ends: &AtomicBool) -> Result<Report, UpError> {
    let samples = Samples::Source {
        readings: Box::new(Readings::open(&plan.config.launch)?),
        conditioner: Box::new(ingest::conditioner(&plan.config)?),
    };
    flow(plan, ends, samples, Path::new(&plan.config)?)
}

/// Flies a flight again in this process: the readings that were taken, and the swaps at their ticks.
pub fn replay(plan: &Plan, flight: Flight, ends: &AtomicBool) -> Result<Report, UpError> {
    let path = Path::with_swaps(&plan.config, &flight.schedule)?;
    flight.schedule.doubts().iter().for_each(announce);
    let samples = Samples::Flight { readings: flight.readings, retaken: Box::new(Retaken::new(&plan.config)?) };
    flow(plan, ends, samples, path)
}

/// Samples, and how many there were.
enum Samples {
    Source { readings: Box<Readings>, conditioner: Box<Conditioner> },
    Flight { readings: TakenReadings, retaken: Box<Retaken> },
}

impl Samples {
    /// The next sample; `None` at the end.
    fn next(&mut self) -> Result<Option<Sample>, UpError> {
        match self {
            Self::Source { readings, conditioner } => {
                for reading in readings {
                    let reading = reading?;
                    if let Some(sample) = conditioner.condition(&reading) {
                        return Ok(Some(sample));
                    }
                }
            }
            Self::Flight { readings, retaken } => {
                for taken in readings {
                    if let Some(sample) = retaken.sample(&taken.map_err(UpError::Flight)?)? {
                        return Ok(Some(sample));
                    }
                }
            }
        }
        Ok(None)
    }

    fn ticks(&self) -> u64 {
        match self {
            Self::Source { conditioner, .. } => conditioner.ticks(),
            Self::Flight { retaken, .. } => retaken.ticks(),
        }
    }

    fn refused(&self) -> u64 {
        match self {
            Self::Source { conditioner, .. } => conditioner.refused(),
            Self::Flight { retaken, .. } => retaken.refused(),
        }
    }
}

/// Lets the samples flow to their end.
fn flow(plan: &Plan, ends: &AtomicBool, mut samples: Samples, mut path: Path) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_ref())?;
    let mut view = View::new(plan)?;
    let (start_ns, cpu_start_s) = (monotonic_ns(), own_cpu_s());
    let mut judge = InputJudge::default();
    let flowed = pump(plan, ends, &mut samples, &mut path, &mut judge, (&mut collector, &mut view));
    view.announce(judge.finish());
    view.end();
    let account = Account {
        warnings: judge.into_warnings(),
        ticks_in: samples.ticks(),
        ticks_out: None,
        refused: samples.refused(),
        cpu_s_per_s: (own_cpu_s() - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9).max(1e-9),
        services: Service::PATH
            .map(|service| ServiceReport { name: service.name(), pid: Some(std::process::id()), restarts: 0 })
            .into(),
    };
    Ok(Report::new(collector, account, flowed.err()))
}

fn pump(
    plan: &Plan,
    ends: &AtomicBool,
    samples: &mut Samples,
    path: &mut Path,
    judge: &mut InputJudge,
    (collector, view): (&mut Collector, &mut View),
) -> Result<(), UpError> {
    let start_ns = monotonic_ns();
    let (mut first_ns, mut seen_ns) = (None, 0);
    let needs_fused = plan.out.as_ref().is_some_and(OutFile::needs_fused);
    let mut fused = Vec::new();
    runtime::clock::wake_on_time();
    while !ends.load(Ordering::SeqCst) && plan.config.ticks_max.is_none_or(|max| samples.ticks() < max) {
        let Some(mut sample) = samples.next()? else { break };
        let since_first_ns = sample.imu.header.t_end_ns - *first_ns.get_or_insert(sample.imu.header.t_end_ns);
        if let Pace::Speed(speed) = plan.config.pace {
            let due_ns = start_ns + (since_first_ns as f64 / speed) as u64;
            while monotonic_ns() < due_ns && !ends.load(Ordering::SeqCst) {
                sleep_until_ns(due_ns, SLEEP_LIMIT);
            }
        }
        sample.imu.header.t_born_ns = monotonic_ns();
        sample.imu.header.epoch = runtime::service_config::FIRST_EPOCH;
        if let Some(Truth { quaternion, scored }) = sample.reference {
            collector.reference(Reference { tick: sample.imu.header.tick, scored: scored.into(), quaternion });
        }
        view.announce(judge.take(&sample.imu, sample.mag.as_ref()));
        let mut see = |state: &FusedState| {
            if needs_fused {
                fused.push(*state);
            }
        };
        path.offer_seen(sample, &mut see, &mut |mut output| {
            output.header.t_sent_ns = monotonic_ns();
            collector.attitude(&output);
        })?;
        fused.drain(..).for_each(|state| collector.fused(&state));
        if sample.imu.header.t_born_ns - seen_ns > VIEW_INTERVAL_NS {
            seen_ns = sample.imu.header.t_born_ns;
            view.show(collector, None, Duration::ZERO);
        }
    }
    Ok(())
}
