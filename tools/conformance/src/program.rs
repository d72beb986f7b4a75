//! A stage that is a program of its own: the kit, as on every stage, and what a step of it costs.

use std::{
    fs,
    thread::sleep,
    time::{Duration, Instant},
};

use attitude::stage::Stage;
use host::{HostError, HostedStage, HostableStage, child::START_TIMEOUT};
use launch::{ExternalStage, Service};

use crate::{
    processor::OneProcessor,
    report::{Check, Figure, Report},
    script::S1,
    slot::{AccelSlot, CourseSlot, Fills, FuserSlot, GyroSlot, Slot},
};

/// Steps that are timed, and how often one is asked for.
const STEPS: usize = 3000;
const INTERVAL: Duration = Duration::from_millis(1);

/// Checks the program that fills a slot under this name; `on_begin` is told which kind of checks begins, for they may take minutes. A
/// judge has time: each answer may take as long as a start.
pub fn program(name: &str, program: &ExternalStage, on_begin: &mut dyn FnMut(&str)) -> Result<Report, HostError> {
    match program.slot {
        Service::Gyro => judged::<GyroSlot>(name, program, on_begin),
        Service::Accel => judged::<AccelSlot>(name, program, on_begin),
        Service::Course => judged::<CourseSlot>(name, program, on_begin),
        // A launch file has programs for these slots only.
        Service::Fuser | Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => {
            judged::<FuserSlot>(name, program, on_begin)
        }
    }
}

fn judged<L: Slot>(name: &str, program: &ExternalStage, on_begin: &mut dyn FnMut(&str)) -> Result<Report, HostError>
where
    L::Own: HostableStage,
    HostedStage<L::Own>: Fills<L>,
{
    let mut report = {
        let _one = OneProcessor::keep_to();
        let stage = HostedStage::<L::Own>::start(name, program, START_TIMEOUT)?;
        crate::report::<L, _>(&|| stage.clone(), on_begin)
    };
    on_begin("cost");
    match HostedStage::start(name, program, START_TIMEOUT) {
        Ok(stage) => report.checks.extend(costs::<L>(stage)),
        Err(cause) => report.checks.push(Check::holds("it starts once more", Some(cause.to_string()))),
    }
    Ok(report)
}

/// How long a step takes to and fro at 1 kHz, and the processor time of the program.
fn costs<L: Slot>(mut stage: HostedStage<L::Own>) -> Vec<Check>
where
    L::Own: HostableStage,
    HostedStage<L::Own>: Fills<L>,
{
    let inputs = L::inputs(&S1);
    let (mut times, begun, cpu_before_ns) = (Vec::new(), Instant::now(), cpu_ns(&stage));
    for (count, (_, input)) in (0u32..).zip(inputs.iter().take(STEPS)) {
        sleep((INTERVAL * count).saturating_sub(begun.elapsed()));
        let asked = Instant::now();
        stage.step(input);
        times.push(asked.elapsed());
    }
    let share =
        cpu_ns(&stage).zip(cpu_before_ns).map(|(now, before)| (now - before) / begun.elapsed().as_nanos() as f64);
    times.sort_unstable();
    let quantile = |share: f64| times.get((share * (times.len().max(1) - 1) as f64) as usize).copied();
    let check = |name: &str, value: Option<f64>, unit: &'static str| {
        Check::most(name, Figure { value, limit: None, unit }, String::new)
    };
    let us = |time: Option<Duration>| time.map(|time| time.as_secs_f64() * 1e6);
    vec![
        check("a step at 1 kHz, to and fro: median", us(quantile(0.5)), "µs"),
        check("a step at 1 kHz, to and fro: 99 %", us(quantile(0.99)), "µs"),
        check("processor time of the program at 1 kHz", share.map(|share| share * 100.0), "%"),
    ]
}

/// Processor time of the program, ns.
fn cpu_ns<B>(stage: &HostedStage<B>) -> Option<f64> {
    let text = fs::read_to_string(format!("/proc/{}/schedstat", stage.pid()?)).ok()?;
    text.split_whitespace().next()?.parse().ok()
}
