//! Five processes in the graph of the pipeline: a source, two that read it, one that joins what both pass on, and a sink; over topics
//! that a variant brings.
//!
//! Input: a topic in, a topic out. Output: what each process reports of itself, and their sum. Time: the source's pace is absolute.
//! Failure: a process that waits in vain for [`IDLE_LIMIT`] reports what it has; the sink counts what did not come as lost.

use std::{
    cmp::Ordering,
    fs, io,
    time::{Duration, Instant},
};

use hdrhistogram::Histogram;
use messages::Ticked;
use runtime::clock::{monotonic_ns, sleep_until_ns, minimise_timer_slack};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use crate::{Cost, Failure, LatencyUs, Variant, WARM_S, process::Process};

/// Samples that a topic holds.
pub(crate) const TOPIC_SAMPLES: usize = 1024;
/// Longest sleep before looking for samples again.
pub(crate) const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// From the last sample until nothing more is expected.
const IDLE_LIMIT: Duration = Duration::from_secs(5);
/// From the start until every process must be ready, and from the end until it must have reported.
const LIMIT: Duration = Duration::from_secs(10);
/// Between the word to begin and the first sample, ns.
const LEAD_NS: u64 = 10_000_000;
/// What is later than this is counted as this late, ns.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// What a process is told.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Part {
    pub(crate) variant: Variant,
    pub(crate) place: Place,
    /// The name of what the processes share.
    pub(crate) share: String,
    rate_hz: u32,
    /// Samples before the first that is measured.
    warm_ticks: u64,
    /// All samples.
    ticks: u64,
}

/// What a process does.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) enum Place {
    Source,
    Gyro,
    Accel,
    Fuser,
    Sink,
}

/// What a process says at its end.
#[derive(Debug, Serialize, Deserialize)]
struct EndReport {
    cpu_s_per_s: f64,
    received: Option<Received>,
}

/// What a sink says of the samples.
#[derive(Debug, Serialize, Deserialize)]
struct Received {
    latency_us: LatencyUs,
    lost: u64,
}

/// Where samples come from.
pub(crate) trait Input {
    type Sample: Ticked;

    fn receive(&mut self) -> Result<Option<Self::Sample>, Failure>;
    /// Sleeps until there are samples, or for [`WAIT_LIMIT`].
    fn wait(&mut self);
}

/// Two inputs, joined by tick; what goes on is the sample of the first.
pub(crate) struct Join<A: Input, B: Input> {
    first: A,
    second: B,
    held: (Option<A::Sample>, Option<B::Sample>),
}

impl<A: Input, B: Input> Join<A, B> {
    pub(crate) fn new(first: A, second: B) -> Self {
        Self { first, second, held: (None, None) }
    }
}

impl<A: Input, B: Input> Input for Join<A, B> {
    type Sample = A::Sample;

    fn receive(&mut self) -> Result<Option<A::Sample>, Failure> {
        loop {
            let Self { first, second, held } = self;
            held.0 = held.0.take().map_or_else(|| first.receive(), |sample| Ok(Some(sample)))?;
            held.1 = held.1.take().map_or_else(|| second.receive(), |sample| Ok(Some(sample)))?;
            let (Some(a), Some(b)) = (&held.0, &held.1) else { return Ok(None) };
            match a.header().tick.cmp(&b.header().tick) {
                Ordering::Equal => {
                    held.1 = None;
                    return Ok(held.0.take());
                }
                Ordering::Less => held.0 = None,
                Ordering::Greater => held.1 = None,
            }
        }
    }

    fn wait(&mut self) {
        if self.held.0.is_none() { self.first.wait() } else { self.second.wait() }
    }
}

/// Where samples go.
pub(crate) trait Outlet {
    type Sample: Ticked;

    fn send(&mut self, sample: &Self::Sample) -> Result<(), Failure>;
    /// Wakes the readers, once after all that was sent.
    fn wake(&mut self);
}

/// Runs the processes and sums up what its processes say.
pub(crate) fn run(variant: Variant, share: &str, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let ticks = |seconds: f64| (seconds * f64::from(rate_hz)).ceil() as u64;
    let warm_ticks = ticks(WARM_S);
    let part =
        |place| Part { variant, place, share: share.into(), rate_hz, warm_ticks, ticks: warm_ticks + ticks(seconds) };
    let mut processes = Vec::new();
    for place in [Place::Sink, Place::Fuser, Place::Accel, Place::Gyro, Place::Source] {
        let part = serde_json::to_string(&part(place))?;
        processes.push(Process::start(std::env::current_exe()?.as_os_str(), ["--part", &part])?);
    }
    let ready_by = Instant::now() + LIMIT;
    for process in &mut processes {
        process.line(ready_by)?;
    }
    let source = processes.last_mut().expect("the source is the last");
    source.write_line("")?;
    let said_by = Instant::now() + Duration::from_secs_f64(WARM_S + seconds) + LIMIT;
    let (mut cpu_s_per_s, mut received) = (0.0, None);
    for process in &mut processes {
        let said: EndReport = serde_json::from_str(&process.line(said_by)?)?;
        cpu_s_per_s += said.cpu_s_per_s;
        received = received.or(said.received);
    }
    let Received { latency_us, lost } = received.ok_or("the last process of the chain did not say what it received")?;
    Ok(Cost { latency_us, cpu_s_per_s, lost })
}

/// The first process: sends a sample whenever one is due.
pub(crate) fn source<O: Outlet>(part: &Part, mut outlet: O) -> Result<(), Failure> {
    minimise_timer_slack();
    say_ready();
    io::stdin().read_line(&mut String::new())?;
    let mut meter = Meter::new(part);
    let start_ns = monotonic_ns() + LEAD_NS;
    for tick in 0..part.ticks {
        let due_ns = start_ns + tick * 1_000_000_000 / u64::from(part.rate_hz);
        while monotonic_ns() < due_ns {
            sleep_until_ns(due_ns, WAIT_LIMIT);
        }
        let mut sample: O::Sample = bytemuck::Zeroable::zeroed();
        sample.header_mut().tick = tick;
        sample.header_mut().t_born_ns = monotonic_ns();
        outlet.send(&sample)?;
        outlet.wake();
        meter.passed(tick)?;
    }
    meter.report(None)
}

/// A process in between: `pass` makes the sample that goes on.
pub(crate) fn relay<I: Input, O: Outlet>(
    part: &Part,
    input: I,
    mut outlet: O,
    pass: impl Fn(&I::Sample) -> O::Sample,
) -> Result<(), Failure> {
    let mut meter = Meter::new(part);
    drain(part, input, |samples| {
        for sample in samples {
            outlet.send(&pass(sample))?;
        }
        outlet.wake();
        samples.iter().try_for_each(|sample| meter.passed(sample.header().tick))
    })?;
    meter.report(None)
}

/// The last process: keeps the latency of each sample.
pub(crate) fn sink<I: Input>(part: &Part, input: I) -> Result<(), Failure> {
    let mut meter = Meter::new(part);
    let mut latency_ns = Histogram::<u64>::new_with_max(MAX_LATENCY_NS, 3)?;
    drain(part, input, |samples| {
        let now_ns = monotonic_ns();
        for header in samples.iter().map(Ticked::header) {
            if header.tick >= part.warm_ticks {
                latency_ns.saturating_record(now_ns.saturating_sub(header.t_born_ns));
            }
            meter.passed(header.tick)?;
        }
        Ok(())
    })?;
    let us = |ns: u64| ns as f64 / 1000.0;
    let at = |quantile| us(latency_ns.value_at_quantile(quantile));
    let latency_us = LatencyUs { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: us(latency_ns.max()) };
    meter.report(Some(Received { latency_us, lost: part.ticks - part.warm_ticks - latency_ns.len() }))
}

/// Hands all samples that are there to `take`, until the last has come.
fn drain<I: Input>(
    part: &Part,
    mut input: I,
    mut take: impl FnMut(&[I::Sample]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    say_ready();
    let mut samples = Vec::with_capacity(TOPIC_SAMPLES);
    let mut idle_ns = monotonic_ns();
    loop {
        samples.clear();
        while samples.len() < TOPIC_SAMPLES
            && let Some(sample) = input.receive()?
        {
            samples.push(sample);
        }
        match samples.last() {
            Some(last) => {
                take(&samples)?;
                if last.header().tick + 1 >= part.ticks {
                    return Ok(());
                }
                idle_ns = last.header().t_born_ns;
            }
            None if u128::from(monotonic_ns().saturating_sub(idle_ns)) > IDLE_LIMIT.as_nanos() => return Ok(()),
            None => input.wait(),
        }
    }
}

/// Ties this process to the run that started it.
pub(crate) fn end_with_parent() -> Result<(), Failure> {
    Ok(set_parent_process_death_signal(Some(Signal::KILL))?)
}

fn say_ready() {
    println!("ready");
}

/// CPU time of this process over the samples that are measured.
struct Meter {
    warm_ticks: u64,
    start: Option<(u64, f64)>,
}

impl Meter {
    fn new(part: &Part) -> Self {
        Self { warm_ticks: part.warm_ticks, start: None }
    }

    fn passed(&mut self, tick: u64) -> Result<(), Failure> {
        if self.start.is_none() && tick + 1 >= self.warm_ticks {
            self.start = Some((monotonic_ns(), cpu_s()?));
        }
        Ok(())
    }

    fn report(&self, received: Option<Received>) -> Result<(), Failure> {
        let (start_ns, cpu_start_s) = self.start.ok_or("no sample came; is the machine overloaded?")?;
        let cpu_s_per_s = (cpu_s()? - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9);
        println!("{}", serde_json::to_string(&EndReport { cpu_s_per_s, received })?);
        Ok(())
    }
}

/// CPU time of this process, which has one thread, since it started, s.
fn cpu_s() -> Result<f64, Failure> {
    let text = fs::read_to_string("/proc/self/schedstat")?;
    let ns = text.split_whitespace().next().ok_or("/proc/self/schedstat is empty")?;
    Ok(ns.parse::<f64>()? * 1e-9)
}
