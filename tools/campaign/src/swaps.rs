//! Campaign that swaps random stages.

use std::{collections::BTreeMap, fmt, sync::mpsc, time::Duration};

use control::{ControlError, ControlRequest, SwapOutcome, SwapReport, SwapRequest, send_request};
use launch::{Service, Slot, StageConfig, pluralize};
use messages::AttitudeOutput;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{
    CampaignError, DistributionMs,
    kills::random_in_range,
    load::Load,
    new_histogram_ns,
    system_under_test::{SystemUnderTest, launch_text},
};

/// Timeout for the system to exit after the last swap.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(60);
/// Interval between two reads of the output during a swap.
const POLL_INTERVAL: Duration = Duration::from_millis(2);
/// Maximum number of failed swaps that the report lists.
const MAX_REPORTED_FAILURES: usize = 20;

/// Parameters of a swap campaign.
#[derive(Debug, Clone, Copy)]
pub struct SwapCampaign {
    /// Number of swaps.
    pub count: u32,
    /// Seed for the random choice of slots and stages.
    pub seed: u64,
    /// Samples per second.
    pub rate_hz: u32,
    /// Number of threads that compete with the system for the CPU.
    pub load_threads: u32,
    /// `true` to replace each stage by another instance of the same stage. The output must then
    /// stay byte-for-byte identical.
    pub same_stage: bool,
}

/// Result of a swap campaign.
#[derive(Debug, Clone, Serialize)]
pub struct SwapCampaignReport {
    /// Number of requested swaps.
    pub swaps: u32,
    /// Number of committed swaps.
    pub committed: u32,
    /// Reports of the first failed swaps, at most `MAX_REPORTED_FAILURES`.
    pub failed: Vec<SwapReport>,
    /// Number of ticks with an attitude.
    pub ticks: u64,
    /// Number of ticks without an attitude.
    pub lost: u64,
    /// Number of attitudes that were published twice.
    pub duplicated: u64,
    /// Number of attitudes that were published after an attitude of a later tick.
    pub out_of_order: u64,
    /// `true` if the output is byte-for-byte identical to that of an undisturbed run; `None` unless
    /// `same_stage` is set.
    pub same_bytes: Option<bool>,
    /// Longest interval between two successive attitudes during each swap.
    pub gap_ms: DistributionMs,
    /// Longest interval between two successive attitudes during a period without a swap, for
    /// comparison with `gap_ms`. One such period follows each swap and is as long as the response
    /// time of that swap.
    pub baseline_gap_ms: DistributionMs,
    /// Time from each request to its response.
    pub response_ms: DistributionMs,
    /// Largest attitude jump at a swap, degrees.
    pub max_jump_deg: f64,
}

impl SwapCampaign {
    /// Runs a system, performs one swap after another and evaluates the output.
    ///
    /// # Errors
    ///
    /// Returns an error if the system, a request or the undisturbed run fails.
    pub fn run(&self) -> Result<SwapCampaignReport, CampaignError> {
        let Self { count, seed, rate_hz, load_threads, same_stage } = *self;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let name = format!("swaps-{}", std::process::id());
        let text = launch_text(&name, &Service::PATH, rate_hz);
        let (mut gap_ns, mut baseline_gap_ns, mut response_ns) =
            (new_histogram_ns(), new_histogram_ns(), new_histogram_ns());
        let (mut committed, mut failed, mut max_jump_deg) = (0, Vec::new(), 0.0_f64);
        let (totals, bytes) = {
            let _load = Load::start(load_threads);
            let mut system = SystemUnderTest::start(&name, &text, None, 2 * rate_hz as usize)?;
            for _ in 0..count {
                let request = random_request(&mut random, same_stage);
                let at_ns = monotonic_ns();
                let report = run_swap(&mut system, &name, request)?;
                let took_ns = monotonic_ns() - at_ns;
                response_ns.saturating_record(took_ns);
                system.clear_outputs();
                system.poll_until(monotonic_ns() + took_ns)?;
                baseline_gap_ns.saturating_record(longest_interval_ns(system.outputs()));
                system.clear_outputs();
                gap_ns.saturating_record((report.gap_us * 1e3) as u64);
                max_jump_deg = max_jump_deg.max(report.jump_deg);
                if report.outcome == SwapOutcome::Committed {
                    committed += 1;
                } else if failed.len() < MAX_REPORTED_FAILURES {
                    failed.push(report);
                }
            }
            system.interrupt();
            system.wait_for_end(SHUTDOWN_TIMEOUT)?
        };
        let duration_s = totals.ticks_out as f64 / f64::from(rate_hz);
        let same_bytes = same_stage.then(|| crate::run_undisturbed(&name, &text, duration_s)).transpose()?;
        Ok(SwapCampaignReport {
            swaps: count,
            committed,
            failed,
            ticks: totals.ticks_out,
            lost: totals.lost,
            duplicated: totals.duplicated,
            out_of_order: count_out_of_order(&bytes),
            same_bytes: same_bytes.map(|undisturbed| bytes == undisturbed),
            gap_ms: DistributionMs::from_histogram(&gap_ns),
            baseline_gap_ms: DistributionMs::from_histogram(&baseline_gap_ns),
            response_ms: DistributionMs::from_histogram(&response_ns),
            max_jump_deg,
        })
    }
}

impl SwapCampaignReport {
    /// Returns `true` if the campaign passed.
    ///
    /// Every swap must have been committed, no tick may be lost, duplicated or out of order, and no
    /// byte may differ from the undisturbed run.
    pub fn passed(&self) -> bool {
        self.committed == self.swaps
            && (self.lost, self.duplicated, self.out_of_order) == (0, 0, 0)
            && self.same_bytes != Some(false)
    }
}

impl fmt::Display for SwapCampaignReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { swaps, committed, failed, ticks, lost, duplicated, out_of_order, .. } = self;
        writeln!(
            f,
            "{committed} of {} committed in {}: lost {lost}, duplicated {duplicated}, out of order {out_of_order}",
            pluralize((*swaps).into(), "swap"),
            pluralize(*ticks, "tick"),
        )?;
        for SwapReport { slot, from, to, reason, .. } in failed {
            let reason = reason.as_ref().map_or("unknown reason".into(), |reason| reason.with_lines().to_string());
            writeln!(f, "{slot}: {from} → {to} failed: {reason}")?;
        }
        match self.same_bytes {
            Some(true) => writeln!(f, "identical to an undisturbed run")?,
            Some(false) => writeln!(f, "NOT identical to an undisturbed run")?,
            None => {}
        }
        writeln!(f, "longest interval between attitudes: {}", self.gap_ms)?;
        writeln!(f, "longest interval without a swap: {}", self.baseline_gap_ms)?;
        writeln!(f, "time from request to response: {}", self.response_ms)?;
        write!(f, "largest jump: {:.3}°", self.max_jump_deg)
    }
}

/// Returns a request for a random stage of a random slot.
fn random_request(random: &mut ChaCha8Rng, same_stage: bool) -> SwapRequest {
    let slot = Slot::ALL[random_in_range(random, 0..Slot::ALL.len() as u64) as usize];
    let names = slot.stages();
    let name = names[random_in_range(random, 0..names.len() as u64) as usize];
    let stage = StageConfig { stage: if same_stage { names[0] } else { name }.into(), set: BTreeMap::new() };
    let timeout_ms = Some(SwapRequest::DEFAULT_TIMEOUT_MS);
    SwapRequest { slot: slot.name().into(), stage, shadow: false, expected_epoch: None, timeout_ms }
}

/// Requests a swap and polls the system until the response arrives.
///
/// No deadline is needed here, because the control socket has its own timeout.
pub(crate) fn run_swap(
    system: &mut SystemUnderTest,
    name: &str,
    request: SwapRequest,
) -> Result<SwapReport, CampaignError> {
    let (sender, receiver) = mpsc::channel::<Result<SwapReport, ControlError>>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            // Sending fails only if the receiver has already returned with an error, so a send
            // error is ignored.
            let _ = sender.send(send_request(name, &ControlRequest::Swap(request)));
        });
        loop {
            match receiver.recv_timeout(POLL_INTERVAL) {
                Ok(report) => return Ok(report?),
                Err(mpsc::RecvTimeoutError::Timeout) => system.poll()?,
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    return Err(CampaignError::Io {
                        action: "requesting a swap",
                        cause: std::io::Error::other("the requesting thread has ended"),
                    });
                }
            }
        }
    })
}

/// Returns the longest interval between the publications of two successive attitudes.
fn longest_interval_ns(outputs: &[AttitudeOutput]) -> u64 {
    let intervals = outputs.windows(2).map(|pair| pair[1].header.t_sent_ns.saturating_sub(pair[0].header.t_sent_ns));
    intervals.max().unwrap_or(0)
}

/// Counts the lines of an attitude file at which the time does not increase.
fn count_out_of_order(attitudes: &[u8]) -> u64 {
    let time_s = |line: &[u8]| str::from_utf8(line.split(|byte| *byte == b',').next()?).ok()?.parse::<f64>().ok();
    let times_s: Vec<_> = attitudes.split(|byte| *byte == b'\n').skip(1).filter_map(time_s).collect();
    times_s.windows(2).filter(|pair| pair[1] <= pair[0]).count() as u64
}
