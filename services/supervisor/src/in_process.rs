//! All slots in this process, without the bus: the same slots, the same join, the same bytes.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use ingest::{
    conditioner::Conditioner,
    source::{Readings, Truth},
};
use launch::Service;
use messages::Reference;
use pipeline::{Collector, Path};
use runtime::{
    Pace,
    clock::{monotonic_ns, sleep_until_ns},
};

use crate::{
    Plan, Report, UpError,
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
    let mut collector = Collector::new(plan.out.as_deref())?;
    let mut conditioner = ingest::conditioner(&plan.config)?;
    let readings = Readings::open(&plan.config.launch)?;
    let mut path = Path::new(&plan.config)?;
    let mut view = View::new(plan)?;
    let (start_ns, cpu_start_s) = (monotonic_ns(), own_cpu_s());
    let flowed = flow(plan, ends, readings, &mut conditioner, &mut path, &mut collector, &mut view);
    view.end();
    let account = Account {
        ticks_in: conditioner.ticks(),
        ticks_out: None,
        refused: conditioner.refused(),
        cpu_s_per_s: (own_cpu_s() - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9).max(1e-9),
        services: Service::PATH
            .map(|service| ServiceReport { name: service.name(), pid: Some(std::process::id()), restarts: 0 })
            .into(),
    };
    Ok(Report::new(collector, account, flowed.err()))
}

/// Lets the readings flow to their end.
fn flow(
    plan: &Plan,
    ends: &AtomicBool,
    readings: Readings,
    conditioner: &mut Conditioner,
    path: &mut Path,
    collector: &mut Collector,
    view: &mut View,
) -> Result<(), UpError> {
    let start_ns = monotonic_ns();
    let (mut first_ns, mut seen_ns) = (None, 0);
    runtime::clock::wake_on_time();
    for reading in readings {
        let reading = reading?;
        if ends.load(Ordering::SeqCst) || plan.config.ticks_max.is_some_and(|max| conditioner.ticks() >= max) {
            break;
        }
        let Some(mut sample) = conditioner.condition(&reading) else { continue };
        let since_first_ns = sample.imu.header.t_end_ns - *first_ns.get_or_insert(sample.imu.header.t_end_ns);
        if let Pace::Speed(speed) = plan.config.pace {
            let due_ns = start_ns + (since_first_ns as f64 / speed) as u64;
            while monotonic_ns() < due_ns && !ends.load(Ordering::SeqCst) {
                sleep_until_ns(due_ns, SLEEP_LIMIT);
            }
        }
        sample.imu.header.t_born_ns = monotonic_ns();
        sample.imu.header.epoch = runtime::service_config::FIRST_EPOCH;
        if let Some(Truth { quaternion, scored }) = reading.reference {
            collector.reference(Reference { tick: sample.imu.header.tick, scored: scored.into(), quaternion });
        }
        path.offer(sample, &mut |mut output| {
            output.header.t_sent_ns = monotonic_ns();
            collector.attitude(&output);
        })?;
        if sample.imu.header.t_born_ns - seen_ns > VIEW_INTERVAL_NS {
            seen_ns = sample.imu.header.t_born_ns;
            view.show(collector, None, Duration::ZERO);
        }
    }
    Ok(())
}
