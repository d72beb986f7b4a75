//! Five processes connected like the pipeline: a source, two relays, a relay that joins their
//! outputs, and a sink. Each variant provides its own kind of topic.
//!
//! Input: one or two topics per process.
//!
//! Output: a report from each process, and the combined result.
//!
//! Time: the source follows an absolute schedule.
//!
//! Failure: a process that receives no input for [`IDLE_TIMEOUT`] stops and reports its results so
//! far. The sink counts missing samples as lost.

use std::{
    cmp::Ordering,
    fs, io,
    time::{Duration, Instant},
};

use hdrhistogram::Histogram;
use messages::Ticked;
use runtime::{PacingTimer, clock::monotonic_ns};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use crate::{Cost, Failure, LatencyUs, Variant, WARM_UP_S, process::Process};

/// Capacity of a topic, samples.
pub(crate) const TOPIC_SAMPLES: usize = 1024;
/// Longest wait before a process polls its input again.
pub(crate) const MAX_WAIT: Duration = Duration::from_millis(50);
/// Longest time without a sample before a process stops waiting.
const IDLE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit for a process to become ready. Also limits the wait for its report after the last
/// sample.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(10);
/// Delay from the start command to the first sample, ns.
const LEAD_NS: u64 = 10_000_000;
/// Largest recorded latency, ns. Higher latencies are counted as this value.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// Settings for one process.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ProcessSettings {
    pub(crate) variant: Variant,
    pub(crate) role: ChainRole,
    /// Name of the system or path of the shared file, depending on the variant.
    pub(crate) shared_name: String,
    rate_hz: u32,
    /// Number of samples before the first measured one.
    warm_up_ticks: u64,
    /// Total number of samples, including the warm-up.
    ticks: u64,
}

/// Role of a process in the chain.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) enum ChainRole {
    Source,
    Gyro,
    Accel,
    Fuser,
    Sink,
}

/// Report that a process prints when it ends.
#[derive(Debug, Serialize, Deserialize)]
struct ProcessReport {
    cpu_s_per_s: f64,
    sink: Option<SinkReport>,
}

/// Report of the sink on the samples it received.
#[derive(Debug, Serialize, Deserialize)]
struct SinkReport {
    latency_us: LatencyUs,
    lost: u64,
}

/// Input topic of a process.
pub(crate) trait Input {
    type Sample: Ticked;

    fn receive(&mut self) -> Result<Option<Self::Sample>, Failure>;
    /// Waits for samples, for at most [`MAX_WAIT`].
    fn wait(&mut self);
}

/// Join of two inputs by tick. It yields the sample of the first input.
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

/// Output topic of a process.
pub(crate) trait Output {
    type Sample: Ticked;

    fn send(&mut self, sample: &Self::Sample) -> Result<(), Failure>;
    /// Wakes the subscribers. Called once after each batch of sent samples.
    fn wake(&mut self);
}

/// Runs the processes and combines their reports.
pub(crate) fn run(variant: Variant, shared_name: &str, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let ticks = |seconds: f64| (seconds * f64::from(rate_hz)).ceil() as u64;
    let warm_up_ticks = ticks(WARM_UP_S);
    let settings = |role| ProcessSettings {
        variant,
        role,
        shared_name: shared_name.into(),
        rate_hz,
        warm_up_ticks,
        ticks: warm_up_ticks + ticks(seconds),
    };
    let mut processes = Vec::new();
    for role in [ChainRole::Sink, ChainRole::Fuser, ChainRole::Accel, ChainRole::Gyro, ChainRole::Source] {
        let settings = serde_json::to_string(&settings(role))?;
        processes.push(Process::start(std::env::current_exe()?.as_os_str(), ["--process", &settings])?);
    }
    let ready_deadline = Instant::now() + RESPONSE_TIMEOUT;
    for process in &mut processes {
        process.line(ready_deadline)?;
    }
    let source = processes.last_mut().expect("the source is started last");
    source.write_input("")?;
    let report_deadline = Instant::now() + Duration::from_secs_f64(WARM_UP_S + seconds) + RESPONSE_TIMEOUT;
    let (mut cpu_s_per_s, mut sink) = (0.0, None);
    for process in &mut processes {
        let report: ProcessReport = serde_json::from_str(&process.line(report_deadline)?)?;
        cpu_s_per_s += report.cpu_s_per_s;
        sink = sink.or(report.sink);
    }
    let SinkReport { latency_us, lost } = sink.ok_or("the sink did not report")?;
    Ok(Cost { latency_us, cpu_s_per_s, lost, phases: None })
}

/// Runs the first process, which publishes a sample whenever one is due.
pub(crate) fn source<O: Output>(settings: &ProcessSettings, mut output: O) -> Result<(), Failure> {
    let mut timer = PacingTimer::for_current_thread();
    report_ready();
    io::stdin().read_line(&mut String::new())?;
    let mut meter = CpuMeter::new(settings);
    let start_ns = monotonic_ns() + LEAD_NS;
    for tick in 0..settings.ticks {
        let due_ns = start_ns + tick * 1_000_000_000 / u64::from(settings.rate_hz);
        while monotonic_ns() < due_ns {
            timer.sleep_until_ns(due_ns, MAX_WAIT);
        }
        let mut sample: O::Sample = bytemuck::Zeroable::zeroed();
        sample.header_mut().tick = tick;
        sample.header_mut().t_born_ns = monotonic_ns();
        output.send(&sample)?;
        output.wake();
        meter.record(tick)?;
    }
    meter.report(None)
}

/// Runs an intermediate process, which publishes the result of `forward` for each sample.
pub(crate) fn relay<I: Input, O: Output>(
    settings: &ProcessSettings,
    input: I,
    mut output: O,
    forward: impl Fn(&I::Sample) -> O::Sample,
) -> Result<(), Failure> {
    let mut meter = CpuMeter::new(settings);
    drain(settings, input, |samples| {
        for sample in samples {
            output.send(&forward(sample))?;
        }
        output.wake();
        samples.iter().try_for_each(|sample| meter.record(sample.header().tick))
    })?;
    meter.report(None)
}

/// Runs the last process, which records the latency of each sample.
pub(crate) fn sink<I: Input>(settings: &ProcessSettings, input: I) -> Result<(), Failure> {
    let mut meter = CpuMeter::new(settings);
    let mut latency_ns = Histogram::<u64>::new_with_max(MAX_LATENCY_NS, 3)?;
    drain(settings, input, |samples| {
        let now_ns = monotonic_ns();
        for header in samples.iter().map(Ticked::header) {
            if header.tick >= settings.warm_up_ticks {
                latency_ns.saturating_record(now_ns.saturating_sub(header.t_born_ns));
            }
            meter.record(header.tick)?;
        }
        Ok(())
    })?;
    let us = |ns: u64| ns as f64 / 1000.0;
    let at = |quantile| us(latency_ns.value_at_quantile(quantile));
    let latency_us = LatencyUs { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: us(latency_ns.max()) };
    meter.report(Some(SinkReport { latency_us, lost: settings.ticks - settings.warm_up_ticks - latency_ns.len() }))
}

/// Passes available samples to `handle` until the last sample of the run has arrived.
///
/// Also stops if no sample has arrived for [`IDLE_TIMEOUT`].
fn drain<I: Input>(
    settings: &ProcessSettings,
    mut input: I,
    mut handle: impl FnMut(&[I::Sample]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    report_ready();
    let mut samples = Vec::with_capacity(TOPIC_SAMPLES);
    let mut idle_since_ns = monotonic_ns();
    loop {
        samples.clear();
        while samples.len() < TOPIC_SAMPLES
            && let Some(sample) = input.receive()?
        {
            samples.push(sample);
        }
        match samples.last() {
            Some(last) => {
                handle(&samples)?;
                if last.header().tick + 1 >= settings.ticks {
                    return Ok(());
                }
                idle_since_ns = last.header().t_born_ns;
            }
            None if u128::from(monotonic_ns().saturating_sub(idle_since_ns)) > IDLE_TIMEOUT.as_nanos() => return Ok(()),
            None => input.wait(),
        }
    }
}

/// Makes the kernel kill this process when its parent ends.
pub(crate) fn die_with_parent() -> Result<(), Failure> {
    Ok(set_parent_process_death_signal(Some(Signal::KILL))?)
}

fn report_ready() {
    println!("ready");
}

/// Meter for the CPU time that this process uses after the warm-up.
struct CpuMeter {
    warm_up_ticks: u64,
    start: Option<(u64, f64)>,
}

impl CpuMeter {
    fn new(settings: &ProcessSettings) -> Self {
        Self { warm_up_ticks: settings.warm_up_ticks, start: None }
    }

    fn record(&mut self, tick: u64) -> Result<(), Failure> {
        if self.start.is_none() && tick + 1 >= self.warm_up_ticks {
            self.start = Some((monotonic_ns(), cpu_s()?));
        }
        Ok(())
    }

    fn report(&self, sink: Option<SinkReport>) -> Result<(), Failure> {
        let (start_ns, cpu_start_s) = self.start.ok_or("no sample received; the machine may be overloaded")?;
        let cpu_s_per_s = (cpu_s()? - cpu_start_s) / ((monotonic_ns() - start_ns) as f64 * 1e-9);
        println!("{}", serde_json::to_string(&ProcessReport { cpu_s_per_s, sink })?);
        Ok(())
    }
}

/// Returns the CPU time of this single-threaded process since its start, s.
fn cpu_s() -> Result<f64, Failure> {
    let text = fs::read_to_string("/proc/self/schedstat")?;
    let ns = text.split_whitespace().next().ok_or("/proc/self/schedstat is empty")?;
    Ok(ns.parse::<f64>()? * 1e-9)
}
