//! Stages swapped at random.

use std::{collections::BTreeMap, fmt, sync::mpsc, time::Duration};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro};
use control::{ControlError, ControlRequest, SwapOutcome, SwapReport, SwapRequest, send_request};
use launch::{Service, StageConfig, pluralize};
use messages::AttitudeOutput;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{
    CampaignError, DistributionMs,
    kills::{launch_file, within},
    load::Load,
    system_under_test::SystemUnderTest,
    times_ns,
};

/// After the last swap the system may take this long to come to its end.
const END_LIMIT: Duration = Duration::from_secs(60);
/// How often the output is looked at while a swap goes on.
const LOOK_INTERVAL: Duration = Duration::from_millis(2);
/// Swaps that failed are told one by one up to this many.
const MAX_FAILED: usize = 20;

/// What is done.
#[derive(Debug, Clone, Copy)]
pub struct Swaps {
    /// How many.
    pub count: u32,
    /// Of the slots and the stages.
    pub seed: u64,
    /// Samples per second.
    pub rate_hz: u32,
    /// Threads that take the machine from the system.
    pub load: u32,
    /// Each stage is swapped for itself, which must change no byte.
    pub same: bool,
}

/// What came of it.
#[derive(Debug, Clone, Serialize)]
pub struct SwapsReport {
    /// Swaps asked for.
    pub swaps: u32,
    /// Those that were committed.
    pub committed: u32,
    /// The others, up to a number.
    pub failed: Vec<SwapReport>,
    /// Ticks with an attitude.
    pub ticks: u64,
    /// Ticks without.
    pub lost: u64,
    /// Attitudes that came twice.
    pub duplicated: u64,
    /// Attitudes that came before an earlier one.
    pub out_of_order: u64,
    /// The attitudes are those of an undisturbed run, byte for byte; only told where each stage is swapped for itself.
    pub same_bytes: Option<bool>,
    /// The longest interval between two attitudes across each swap.
    pub gap_ms: DistributionMs,
    /// The same where nothing is swapped, over as long a time after each: what the machine does by itself.
    pub quiet_gap_ms: DistributionMs,
    /// From each request to its answer.
    pub answer_ms: DistributionMs,
    /// The largest jump of the attitude, degrees.
    pub jump_max_deg: f64,
}

impl Swaps {
    /// Runs a system, swaps its stages one after another, and looks at what it gave out.
    pub fn run(&self) -> Result<SwapsReport, CampaignError> {
        let Self { count, seed, rate_hz, load, same } = *self;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let name = format!("swaps-{}", std::process::id());
        let text = launch_file(&name, rate_hz);
        let (mut gap_ns, mut quiet_gap_ns, mut answer_ns) = (times_ns(), times_ns(), times_ns());
        let (mut committed, mut failed, mut jump_max_deg) = (0, Vec::new(), 0.0_f64);
        let (outcome, bytes) = {
            let _load = Load::start(load);
            let mut system = SystemUnderTest::start(&name, &text, None, 2 * rate_hz as usize)?;
            for _ in 0..count {
                let wish = any(&mut random, same);
                let at_ns = monotonic_ns();
                let report = swap(&mut system, &name, wish)?;
                let took_ns = monotonic_ns() - at_ns;
                answer_ns.saturating_record(took_ns);
                system.forget();
                system.watch_until(monotonic_ns() + took_ns)?;
                quiet_gap_ns.saturating_record(longest_interval_ns(system.outputs()));
                system.forget();
                gap_ns.saturating_record((report.gap_us * 1e3) as u64);
                jump_max_deg = jump_max_deg.max(report.jump_deg);
                if report.outcome == SwapOutcome::Committed {
                    committed += 1;
                } else if failed.len() < MAX_FAILED {
                    failed.push(report);
                }
            }
            system.interrupt();
            system.end(END_LIMIT)?
        };
        let duration_s = outcome.ticks_out as f64 / f64::from(rate_hz);
        let same_bytes = same.then(|| crate::undisturbed(&name, &text, duration_s)).transpose()?;
        Ok(SwapsReport {
            swaps: count,
            committed,
            failed,
            ticks: outcome.ticks_out,
            lost: outcome.lost,
            duplicated: outcome.duplicated,
            out_of_order: disorder(&bytes),
            same_bytes: same_bytes.map(|undisturbed| bytes == undisturbed),
            gap_ms: DistributionMs::of(&gap_ns),
            quiet_gap_ms: DistributionMs::of(&quiet_gap_ns),
            answer_ms: DistributionMs::of(&answer_ns),
            jump_max_deg,
        })
    }
}

impl SwapsReport {
    /// Every swap was committed, nothing was lost, and nothing came twice or out of order.
    pub fn holds(&self) -> bool {
        self.committed == self.swaps
            && (self.lost, self.duplicated, self.out_of_order) == (0, 0, 0)
            && self.same_bytes != Some(false)
    }
}

impl fmt::Display for SwapsReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { swaps, committed, failed, ticks, lost, duplicated, out_of_order, .. } = self;
        writeln!(
            f,
            "{committed} of {} committed in {}: lost {lost}, duplicated {duplicated}, out of order {out_of_order}",
            pluralize((*swaps).into(), "swap"),
            pluralize(*ticks, "tick"),
        )?;
        for SwapReport { slot, from, to, reason, .. } in failed {
            writeln!(f, "{slot}: {from} → {to} failed: {}", reason.as_deref().unwrap_or("no reason given"))?;
        }
        match self.same_bytes {
            Some(true) => writeln!(f, "the same bytes as undisturbed")?,
            Some(false) => writeln!(f, "NOT the bytes of an undisturbed run")?,
            None => {}
        }
        writeln!(f, "longest interval between attitudes: {}", self.gap_ms)?;
        writeln!(f, "the same where nothing is swapped: {}", self.quiet_gap_ms)?;
        writeln!(f, "from the request to the answer: {}", self.answer_ms)?;
        write!(f, "largest jump {:.3}°", self.jump_max_deg)
    }
}

/// A stage for a slot.
fn any(random: &mut ChaCha8Rng, same: bool) -> SwapRequest {
    let of: [(Service, &[&str]); 4] = [
        (Service::Gyro, &Gyro::NAMES),
        (Service::Accel, &Accelerometer::NAMES),
        (Service::Fuser, &Fuser::NAMES),
        (Service::Course, &Course::NAMES),
    ];
    let (slot, names) = of[within(random, 0..of.len() as u64) as usize];
    let name = names[within(random, 0..names.len() as u64) as usize];
    let stage = StageConfig { stage: if same { names[0] } else { name }.into(), set: BTreeMap::new() };
    let limit_ms = Some(SwapRequest::DEFAULT_TIMEOUT_MS);
    SwapRequest { slot: slot.name().into(), stage, shadow: false, expected_epoch: None, timeout_ms: limit_ms }
}

/// Asks for a swap and looks at the output until it is answered; the control socket has a limit of its own.
fn swap(system: &mut SystemUnderTest, name: &str, wish: SwapRequest) -> Result<SwapReport, CampaignError> {
    let (answer, answered) = mpsc::channel::<Result<SwapReport, ControlError>>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            // Whoever waits for the answer is there until it comes, or has failed and does not need it.
            let _ = answer.send(send_request(name, &ControlRequest::Swap(wish)));
        });
        loop {
            match answered.recv_timeout(LOOK_INTERVAL) {
                Ok(report) => return Ok(report?),
                Err(mpsc::RecvTimeoutError::Timeout) => system.look()?,
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    return Err(CampaignError::System {
                        doing: "asking for a swap",
                        cause: std::io::Error::other("the thread that asked has ended"),
                    });
                }
            }
        }
    })
}

/// Between two attitudes, from publication to publication.
fn longest_interval_ns(outputs: &[AttitudeOutput]) -> u64 {
    let intervals = outputs.windows(2).map(|pair| pair[1].header.t_sent_ns.saturating_sub(pair[0].header.t_sent_ns));
    intervals.max().unwrap_or(0)
}

/// Lines of an attitude file whose time is not after that of the line before.
fn disorder(attitudes: &[u8]) -> u64 {
    let time_s = |line: &[u8]| str::from_utf8(line.split(|byte| *byte == b',').next()?).ok()?.parse::<f64>().ok();
    let times_s: Vec<_> = attitudes.split(|byte| *byte == b'\n').skip(1).filter_map(time_s).collect();
    times_s.windows(2).filter(|pair| pair[1] <= pair[0]).count() as u64
}
