//! One end of a hop as a process: it says what it is ready for, sends at an absolute pace, or keeps the latency of what comes.

use std::{
    io::{self, Read},
    thread,
    time::Duration,
};

use hdrhistogram::Histogram;
use runtime::clock::{monotonic_ns, sleep_until_ns, minimise_timer_slack};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use crate::{Failure, Variant, WARM_S};

/// Longest wait for a sample.
pub(crate) const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// From the last sample until nothing more is expected, and from the start until the first.
const IDLE_LIMIT_NS: u64 = 5_000_000_000;
/// Between the word to begin and the first sample, ns.
const LEAD_NS: u64 = 10_000_000;
/// What is later than this is counted as this late, ns.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// Which end it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum End {
    Near,
    Far,
}

/// What a process of the hop is told.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Part {
    pub(crate) variant: Variant,
    pub(crate) end: End,
    /// The endpoint, or the name of the system.
    pub(crate) at: String,
    pub(crate) rate_hz: u32,
    pub(crate) warm_ticks: u64,
    pub(crate) ticks: u64,
}

impl Part {
    pub(crate) fn new(variant: Variant, end: End, at: &str, rate_hz: u32, seconds: f64) -> Self {
        let ticks = |seconds: f64| (seconds * f64::from(rate_hz)).ceil() as u64;
        let warm_ticks = ticks(WARM_S);
        Self { variant, end, at: at.into(), rate_hz, warm_ticks, ticks: warm_ticks + ticks(seconds) }
    }
}

/// What the far end says at its end.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Heard {
    pub(crate) p50_us: f64,
    pub(crate) p99_us: f64,
    pub(crate) samples: u64,
}

/// Ties this process to the run that started it.
pub(crate) fn end_with_parent() -> Result<(), Failure> {
    Ok(set_parent_process_death_signal(Some(Signal::KILL))?)
}

/// The near end: hands a tick and the time to `send` whenever one is due, when it is told to begin.
pub(crate) fn send(part: &Part, mut send: impl FnMut(u64, u64) -> Result<(), Failure>) -> Result<(), Failure> {
    minimise_timer_slack();
    println!("ready");
    io::stdin().read_to_string(&mut String::new())?;
    let start_ns = monotonic_ns() + LEAD_NS;
    for tick in 0..part.ticks {
        let due_ns = start_ns + tick * 1_000_000_000 / u64::from(part.rate_hz);
        while monotonic_ns() < due_ns {
            sleep_until_ns(due_ns, WAIT_LIMIT);
        }
        send(tick, monotonic_ns())?;
    }
    stay()
}

/// The far end: `receive` hands what comes within [`WAIT_LIMIT`], tick and time of sending, to what it is given.
pub(crate) fn receive(
    part: &Part,
    mut receive: impl FnMut(&mut dyn FnMut(u64, u64)) -> Result<(), Failure>,
) -> Result<(), Failure> {
    println!("ready");
    let mut latency_ns = Histogram::<u64>::new_with_max(MAX_LATENCY_NS, 3)?;
    let mut warm = false;
    let (mut last_tick, mut heard_ns) = (0, monotonic_ns());
    while last_tick + 1 < part.ticks && monotonic_ns() - heard_ns < IDLE_LIMIT_NS {
        receive(&mut |tick, sent_ns| {
            heard_ns = monotonic_ns();
            last_tick = last_tick.max(tick);
            if tick >= part.warm_ticks {
                latency_ns.saturating_record(heard_ns.saturating_sub(sent_ns));
            }
        })?;
        if !warm && last_tick + 1 >= part.warm_ticks {
            warm = true;
            println!("warm");
        }
    }
    let us = |quantile| latency_ns.value_at_quantile(quantile) as f64 / 1000.0;
    println!("{}", serde_json::to_string(&Heard { p50_us: us(0.5), p99_us: us(0.99), samples: latency_ns.len() })?);
    stay()
}

/// Until this process is ended, so that its CPU time can be read.
fn stay() -> Result<(), Failure> {
    loop {
        thread::park();
    }
}
