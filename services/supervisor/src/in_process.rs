//! All slots in this process, without the bus: the same slots, the same join, the same bytes.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use ingest::{
    conditioner::{Conditioner, Sample},
    source::{Readings, Truth},
};
use launch::Service;
use messages::{AttitudeOutput, FusedState, Reference};
use runtime::{
    Pace, RuntimeError, Slot,
    clock::{monotonic_ns, sleep_until_ns},
};

use crate::{
    Plan, Report, UpError,
    collector::Collector,
    crew::own_cpu_s,
    report::{Account, ServiceReport},
    view::View,
};

/// Longest sleep before looking for a signal.
const SLEEP_LIMIT: Duration = Duration::from_millis(50);
/// How often people see something new, ns.
const VIEW_INTERVAL_NS: u64 = 100_000_000;

/// The path from a sample to an attitude.
pub struct Path {
    gyro: runtime::EachTick<gyro::GyroWork>,
    accel: runtime::EachTick<accel::AccelWork>,
    fuser: fuser::FuserSlot,
    course: course::CourseSlot,
}

impl Path {
    /// The slots with the stages that `plan` names.
    pub fn new(plan: &Plan) -> Result<Self, RuntimeError> {
        let orders = &plan.orders;
        if let Some(slot) = Service::ALL.into_iter().find(|slot| orders.launch.program(*slot).is_some()) {
            let stage = orders.launch.slot(slot).map_or(String::new(), |chosen| chosen.stage.clone());
            return Err(RuntimeError::Program { slot, stage });
        }
        Ok(Self {
            gyro: gyro::slot(orders)?,
            accel: accel::slot(orders)?,
            fuser: fuser::slot(orders)?,
            course: course::slot(orders)?,
        })
    }

    /// Hands every attitude that follows from `sample` to `publish`.
    pub fn offer(&mut self, sample: Sample, publish: &mut dyn FnMut(AttitudeOutput)) {
        let Self { gyro, accel, fuser, course } = self;
        let Sample { imu, mag, gnss } = sample;
        if let Some(fix) = gnss {
            course.offer(fix.into(), publish);
        }
        let mut fused = |state: FusedState| course.offer(state.into(), publish);
        if let Some(field) = mag {
            fuser.offer(field.into(), &mut fused);
        }
        if let Some(fix) = gnss {
            fuser.offer(fix.into(), &mut fused);
        }
        accel.offer(imu, &mut |point| fuser.offer(point.into(), &mut fused));
        gyro.offer(imu, &mut |step| fuser.offer(step.into(), &mut fused));
    }
}

/// Runs the plan in this process.
pub fn run(plan: &Plan, ends: &AtomicBool) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_deref())?;
    let mut conditioner = ingest::conditioner(&plan.orders)?;
    let readings = Readings::open(&plan.orders.launch)?;
    let mut path = Path::new(plan)?;
    let mut view = View::new(plan);
    let (start_ns, cpu_start_s) = (monotonic_ns(), own_cpu_s());
    let flowed = flow(plan, ends, readings, &mut conditioner, &mut path, &mut collector, &mut view);
    view.end();
    let account = Account {
        ticks_in: conditioner.ticks(),
        ticks_out: None,
        refused: conditioner.refused(),
        cpu_s_per_s: (own_cpu_s() - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9).max(1e-9),
        services: Service::PATH
            .map(|service| ServiceReport { name: service.name(), pid: std::process::id(), restarts: 0 })
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
        if ends.load(Ordering::SeqCst) || plan.orders.ticks_max.is_some_and(|max| conditioner.ticks() >= max) {
            break;
        }
        let Some(mut sample) = conditioner.condition(&reading) else { continue };
        let since_first_ns = sample.imu.header.t_end_ns - *first_ns.get_or_insert(sample.imu.header.t_end_ns);
        if let Pace::Speed(speed) = plan.orders.pace {
            let due_ns = start_ns + (since_first_ns as f64 / speed) as u64;
            while monotonic_ns() < due_ns && !ends.load(Ordering::SeqCst) {
                sleep_until_ns(due_ns, SLEEP_LIMIT);
            }
        }
        sample.imu.header.t_born_ns = monotonic_ns();
        sample.imu.header.epoch = runtime::service::FIRST_EPOCH;
        if let Some(Truth { quaternion, scored }) = reading.reference {
            collector.reference(Reference { tick: sample.imu.header.tick, scored: scored.into(), quaternion });
        }
        path.offer(sample, &mut |mut output| {
            output.header.t_sent_ns = monotonic_ns();
            collector.attitude(&output);
        });
        if sample.imu.header.t_born_ns - seen_ns > VIEW_INTERVAL_NS {
            seen_ns = sample.imu.header.t_born_ns;
            view.show(collector, None);
        }
    }
    Ok(())
}
