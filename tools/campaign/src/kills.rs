//! Campaign that kills services at random times.

use std::{fmt, time::Duration};

use launch::{Service, Slot, pluralize};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{
    CampaignError, DistributionMs,
    load::Load,
    new_histogram_ns,
    system_under_test::{SystemUnderTest, launch_text},
};

/// Range of the random pause between two kills, ms.
const PAUSE_RANGE_MS: std::ops::Range<u64> = 100..400;
/// Timeout for the system to exit after the last kill.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(60);

/// Parameters of a kill campaign.
#[derive(Debug, Clone, Copy)]
pub struct KillCampaign {
    /// Number of kills.
    pub count: u32,
    /// Seed for the random kill times and the random choice of services.
    pub seed: u64,
    /// Samples per second.
    pub rate_hz: u32,
    /// Number of threads that compete with the system for the CPU.
    pub load_threads: u32,
}

/// Result of a kill campaign.
#[derive(Debug, Clone, Serialize)]
pub struct KillCampaignReport {
    /// Number of kills that were requested.
    pub requested: u32,
    /// Number of kills that were followed by a new attitude. On a loaded machine a service may not
    /// have restarted yet when it is to be killed again.
    pub kills: u32,
    /// Number of ticks with an attitude.
    pub ticks: u64,
    /// Number of ticks without an attitude.
    pub lost: u64,
    /// Number of attitudes that were published twice.
    pub duplicated: u64,
    /// `true` if the output is byte-for-byte identical to that of an undisturbed run.
    pub same_bytes: bool,
    /// Time from each kill to the first attitude of a sample that was taken after the kill.
    pub recovery_ms: DistributionMs,
}

impl KillCampaign {
    /// Runs a system, kills its services and compares the output with that of an undisturbed run.
    ///
    /// # Errors
    ///
    /// Returns an error if the system or the undisturbed run fails.
    pub fn run(&self) -> Result<KillCampaignReport, CampaignError> {
        let Self { count, seed, rate_hz, load_threads } = *self;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let name = format!("kills-{}", std::process::id());
        let pauses_ms: Vec<_> = (0..count).map(|_| random_in_range(&mut random, PAUSE_RANGE_MS)).collect();
        let duration_s = 2.0 + pauses_ms.iter().sum::<u64>() as f64 * 1e-3;
        let text = launch_text(&name, &Service::PATH, rate_hz);
        let mut recovery_ns = new_histogram_ns();
        let (totals, bytes) = {
            let _load = Load::start(load_threads);
            let mut system = SystemUnderTest::start(&name, &text, Some(duration_s), 2 * rate_hz as usize)?;
            let mut kills = Vec::new();
            for pause_ms in pauses_ms {
                system.poll_until(monotonic_ns() + pause_ms * 1_000_000)?;
                let slot = Slot::ALL[random_in_range(&mut random, 0..Slot::ALL.len() as u64) as usize];
                let next_tick = system.next_tick();
                kills.extend(system.kill(Service::from(slot)).map(|at_ns| (at_ns, next_tick)));
            }
            system.poll_until(monotonic_ns() + 1_000_000_000)?;
            let mut outputs = system.outputs().iter();
            for (at_ns, next_tick) in kills {
                let next = outputs.find(|output| output.header.tick >= next_tick && output.header.t_sent_ns > at_ns);
                if let Some(next) = next {
                    recovery_ns.saturating_record(next.header.t_sent_ns - at_ns);
                }
            }
            system.wait_for_end(SHUTDOWN_TIMEOUT)?
        };
        let undisturbed = crate::run_undisturbed(&name, &text, duration_s)?;
        Ok(KillCampaignReport {
            requested: count,
            kills: recovery_ns.len() as u32,
            ticks: totals.ticks_out,
            lost: totals.lost,
            duplicated: totals.duplicated,
            same_bytes: bytes == undisturbed,
            recovery_ms: DistributionMs::from_histogram(&recovery_ns),
        })
    }
}

impl KillCampaignReport {
    /// Returns `true` if no tick was lost or duplicated and the output is identical to that of the
    /// undisturbed run.
    pub fn passed(&self) -> bool {
        self.lost == 0 && self.duplicated == 0 && self.same_bytes
    }
}

impl fmt::Display for KillCampaignReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { requested, kills, ticks, lost, duplicated, same_bytes, recovery_ms } = self;
        let bytes = if *same_bytes { "identical to an undisturbed run" } else { "NOT identical to an undisturbed run" };
        let (requested, ticks) = (pluralize((*requested).into(), "kill"), pluralize(*ticks, "tick"));
        writeln!(f, "{kills} of {requested} in {ticks}: lost {lost}, duplicated {duplicated}, {bytes}")?;
        if !same_bytes {
            writeln!(f, "a restart that takes longer than lateness_s of the launch file changes the output")?;
        }
        write!(f, "time from a kill to the next attitude: {recovery_ms}")
    }
}

/// Returns a random number in the range. It is uniform except for the modulo bias.
pub(crate) fn random_in_range(random: &mut ChaCha8Rng, range: std::ops::Range<u64>) -> u64 {
    range.start + random.next_u64() % (range.end - range.start)
}
