//! Checks a stage that runs as a separate program and measures the cost of its steps.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use attitude::stage::Stage;
use host::{HostError, HostableStage, HostedStage, child::START_TIMEOUT};
use launch::{ExternalStage, Slot};

use crate::{
    budget::Budget,
    cpu_affinity::SingleCpu,
    report::{Check, Measurement, Report},
    script::S1,
    slot::{AccelSlot, CourseSlot, FuserSlot, GyroSlot, SlotSpec, SlotStage},
};

/// Number of steps that are timed.
const TIMED_STEPS: usize = 3000;
/// Interval between timed steps.
const STEP_INTERVAL: Duration = Duration::from_millis(1);

/// Checks an external program as the stage `name` of its slot.
///
/// Checks that do not fit into `time` are left out; `None` means no limit. `on_check` receives the
/// name of each check before it runs. The timeout for each response is the start timeout of a
/// program.
///
/// # Errors
///
/// Returns an error if the program cannot be started or is not a stage of its slot.
pub fn run_external(
    name: &str,
    program: &ExternalStage,
    time: Option<Duration>,
    on_check: &dyn Fn(&str),
) -> Result<Report, HostError> {
    match program.slot {
        Slot::Gyro => run_in_slot::<GyroSlot>(name, program, time, on_check),
        Slot::Accel => run_in_slot::<AccelSlot>(name, program, time, on_check),
        Slot::Fuser => run_in_slot::<FuserSlot>(name, program, time, on_check),
        Slot::Course => run_in_slot::<CourseSlot>(name, program, time, on_check),
    }
}

fn run_in_slot<L: SlotSpec>(
    name: &str,
    program: &ExternalStage,
    time: Option<Duration>,
    on_check: &dyn Fn(&str),
) -> Result<Report, HostError>
where
    L::BuiltIn: HostableStage,
    HostedStage<L::BuiltIn>: SlotStage<L>,
{
    let cost_time = STEP_INTERVAL * TIMED_STEPS as u32;
    let budget = Budget::new(time.map(|time| time.saturating_sub(cost_time)), on_check);
    let mut report = {
        let _pinned = SingleCpu::pin();
        let stage = HostedStage::<L::BuiltIn>::start(name, program, START_TIMEOUT)?;
        crate::report::<L, _>(&|| stage.clone(), &budget)
    };
    on_check("step round trip at 1 kHz");
    match HostedStage::start(name, program, START_TIMEOUT) {
        Ok(stage) => report.checks.extend(cost_checks::<L>(stage)),
        Err(cause) => report.checks.push(Check::property("the program starts a second time", Some(cause.to_string()))),
    }
    Ok(report)
}

/// Runs steps at 1 kHz and measures their round-trip times and the CPU time of the program.
fn cost_checks<L: SlotSpec>(mut stage: HostedStage<L::BuiltIn>) -> Vec<Check>
where
    L::BuiltIn: HostableStage,
    HostedStage<L::BuiltIn>: SlotStage<L>,
{
    let inputs = L::inputs(&S1);
    let (mut times, started, cpu_before_ns) = (Vec::new(), Instant::now(), stage.cpu_ns());
    for (count, (_, input)) in (0u32..).zip(inputs.iter().take(TIMED_STEPS)) {
        sleep((STEP_INTERVAL * count).saturating_sub(started.elapsed()));
        let requested = Instant::now();
        stage.step(input);
        times.push(requested.elapsed());
    }
    let share =
        stage.cpu_ns().zip(cpu_before_ns).map(|(now, before)| (now - before) / started.elapsed().as_nanos() as f64);
    times.sort_unstable();
    let quantile = |share: f64| times.get((share * (times.len().max(1) - 1) as f64) as usize).copied();
    let check = |name: &str, value: Option<f64>, unit: &'static str| {
        Check::at_most(name, Measurement { value, limit: None, unit }, String::new)
    };
    let us = |time: Option<Duration>| time.map(|time| time.as_secs_f64() * 1e6);
    vec![
        check("step round trip at 1 kHz, median", us(quantile(0.5)), "µs"),
        check("step round trip at 1 kHz, 99th percentile", us(quantile(0.99)), "µs"),
        check("CPU time of the program at 1 kHz", share.map(|share| share * 100.0), "%"),
    ]
}
