//! One end of a hop, run as a process. The near end sends on an absolute schedule, and the far end
//! records latencies.

use std::{
    io::{self, Read},
    thread,
    time::Duration,
};

use hdrhistogram::Histogram;
use runtime::{PacingTimer, clock::monotonic_ns};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use crate::{Failure, Variant, WARM_UP_S};

/// Longest wait for a sample.
pub(crate) const MAX_WAIT: Duration = Duration::from_millis(50);
/// Longest time without a sample before the far end stops, ns. It also applies before the first
/// sample.
const IDLE_TIMEOUT_NS: u64 = 5_000_000_000;
/// Delay from the start command to the first sample, ns.
const LEAD_NS: u64 = 10_000_000;
/// Largest recorded latency, ns. Higher latencies are counted as this value.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// End of a hop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum End {
    Near,
    Far,
}

/// Settings for one process of the hop.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ProcessSettings {
    pub(crate) variant: Variant,
    pub(crate) end: End,
    /// Endpoint, system name or iceoryx2 root folder, depending on the variant.
    pub(crate) address: String,
    pub(crate) rate_hz: u32,
    pub(crate) warm_up_ticks: u64,
    pub(crate) ticks: u64,
}

impl ProcessSettings {
    pub(crate) fn new(variant: Variant, end: End, address: &str, rate_hz: u32, seconds: f64) -> Self {
        let ticks = |seconds: f64| (seconds * f64::from(rate_hz)).ceil() as u64;
        let warm_up_ticks = ticks(WARM_UP_S);
        Self { variant, end, address: address.into(), rate_hz, warm_up_ticks, ticks: warm_up_ticks + ticks(seconds) }
    }
}

/// Report of the far end.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct FarEndReport {
    pub(crate) p50_us: f64,
    pub(crate) p99_us: f64,
    pub(crate) samples: u64,
}

/// Makes the kernel kill this process when its parent ends.
pub(crate) fn die_with_parent() -> Result<(), Failure> {
    Ok(set_parent_process_death_signal(Some(Signal::KILL))?)
}

/// Runs the near end. After the start command, calls `send` with the tick and the current time (ns)
/// whenever a sample is due.
pub(crate) fn send(
    settings: &ProcessSettings,
    mut send: impl FnMut(u64, u64) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut timer = PacingTimer::for_current_thread();
    println!("ready");
    io::stdin().read_to_string(&mut String::new())?;
    let start_ns = monotonic_ns() + LEAD_NS;
    for tick in 0..settings.ticks {
        let due_ns = start_ns + tick * 1_000_000_000 / u64::from(settings.rate_hz);
        while monotonic_ns() < due_ns {
            timer.sleep_until_ns(due_ns, MAX_WAIT);
        }
        send(tick, monotonic_ns())?;
    }
    park_forever()
}

/// Runs the far end.
///
/// `receive` waits for at most [`MAX_WAIT`]. It calls the function passed to it with the tick and
/// the sending time (ns) of each sample.
pub(crate) fn receive(
    settings: &ProcessSettings,
    mut receive: impl FnMut(&mut dyn FnMut(u64, u64)) -> Result<(), Failure>,
) -> Result<(), Failure> {
    println!("ready");
    let mut latency_ns = Histogram::<u64>::new_with_max(MAX_LATENCY_NS, 3)?;
    let mut is_warm = false;
    let (mut last_tick, mut received_ns) = (0, monotonic_ns());
    while last_tick + 1 < settings.ticks && monotonic_ns() - received_ns < IDLE_TIMEOUT_NS {
        receive(&mut |tick, sent_ns| {
            received_ns = monotonic_ns();
            last_tick = last_tick.max(tick);
            if tick >= settings.warm_up_ticks {
                latency_ns.saturating_record(received_ns.saturating_sub(sent_ns));
            }
        })?;
        if !is_warm && last_tick + 1 >= settings.warm_up_ticks {
            is_warm = true;
            println!("warm");
        }
    }
    let us = |quantile| latency_ns.value_at_quantile(quantile) as f64 / 1000.0;
    println!(
        "{}",
        serde_json::to_string(&FarEndReport { p50_us: us(0.5), p99_us: us(0.99), samples: latency_ns.len() })?
    );
    park_forever()
}

/// Waits until this process is killed, so that its CPU time stays readable.
fn park_forever() -> Result<(), Failure> {
    loop {
        thread::park();
    }
}
