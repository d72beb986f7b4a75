//! Services killed at random moments.

use std::{fmt, time::Duration};

use launch::{Service, pluralize};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{CampaignError, DistributionMs, load::Load, system_under_test::SystemUnderTest, times_ns};

/// Pause between two kills, ms.
const PAUSE_MS: std::ops::Range<u64> = 100..400;
/// After the last kill the system may take this long to come to its end.
const END_LIMIT: Duration = Duration::from_secs(60);

/// What is done.
#[derive(Debug, Clone, Copy)]
pub struct Kills {
    /// How many.
    pub count: u32,
    /// Of the moments and the services.
    pub seed: u64,
    /// Samples per second.
    pub rate_hz: u32,
    /// Threads that take the machine from the system.
    pub load: u32,
}

/// What came of it.
#[derive(Debug, Clone, Serialize)]
pub struct KillsReport {
    /// Services killed.
    pub kills: u32,
    /// Ticks with an attitude.
    pub ticks: u64,
    /// Ticks without.
    pub lost: u64,
    /// Attitudes that came twice.
    pub duplicated: u64,
    /// The attitudes are those of an undisturbed run, byte for byte.
    pub same_bytes: bool,
    /// From the kill to the first attitude of a sample that was taken after it.
    pub recovery_ms: DistributionMs,
}

impl Kills {
    /// Runs a system, kills its services, and compares what it gave out with an undisturbed run.
    pub fn run(&self) -> Result<KillsReport, CampaignError> {
        let Self { count, seed, rate_hz, load } = *self;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let name = format!("kills-{}", std::process::id());
        let pauses_ms: Vec<_> = (0..count).map(|_| within(&mut random, PAUSE_MS)).collect();
        let duration_s = 2.0 + pauses_ms.iter().sum::<u64>() as f64 * 1e-3;
        let text = launch_file(&name, rate_hz);
        let mut recovery_ns = times_ns();
        let (outcome, bytes) = {
            let _load = Load::start(load);
            let mut system = SystemUnderTest::start(&name, &text, Some(duration_s), 2 * rate_hz as usize)?;
            let mut kills = Vec::new();
            for pause_ms in pauses_ms {
                system.watch_until(monotonic_ns() + pause_ms * 1_000_000)?;
                let service = Service::SLOTS[within(&mut random, 0..Service::SLOTS.len() as u64) as usize];
                let next_tick = system.next_tick();
                kills.extend(system.kill(service).map(|at_ns| (at_ns, next_tick)));
            }
            system.watch_until(monotonic_ns() + 1_000_000_000)?;
            let mut outputs = system.outputs().iter();
            for (at_ns, next_tick) in kills {
                let next = outputs.find(|output| output.header.tick >= next_tick && output.header.t_sent_ns > at_ns);
                if let Some(next) = next {
                    recovery_ns.saturating_record(next.header.t_sent_ns - at_ns);
                }
            }
            system.end(END_LIMIT)?
        };
        let undisturbed = crate::undisturbed(&name, &text, duration_s)?;
        Ok(KillsReport {
            kills: recovery_ns.len() as u32,
            ticks: outcome.ticks_out,
            lost: outcome.lost,
            duplicated: outcome.duplicated,
            same_bytes: bytes == undisturbed,
            recovery_ms: DistributionMs::of(&recovery_ns),
        })
    }
}

impl KillsReport {
    /// Nothing was lost, nothing came twice, and every byte is the same.
    pub fn holds(&self) -> bool {
        self.lost == 0 && self.duplicated == 0 && self.same_bytes
    }
}

impl fmt::Display for KillsReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kills, ticks, lost, duplicated, same_bytes, recovery_ms } = self;
        let bytes = if *same_bytes { "the same bytes as undisturbed" } else { "NOT the bytes of an undisturbed run" };
        let (kills, ticks) = (pluralize((*kills).into(), "kill"), pluralize(*ticks, "tick"));
        writeln!(f, "{kills} in {ticks}: lost {lost}, duplicated {duplicated}, {bytes}")?;
        write!(f, "from the kill to the next attitude: {recovery_ms}")
    }
}

/// A system for campaigns: its services may die as often as it pleases.
pub(crate) fn launch_file(name: &str, rate_hz: u32) -> String {
    format!(
        "name = \"{name}\"\n[restart]\nmin_uptime_s = 0\n[ingest]\nsource = \"sim\"\n[ingest.sim]\nrate_hz = {rate_hz}\n"
    )
}

/// A number of the range, each as likely but for what the remainder makes of it.
pub(crate) fn within(random: &mut ChaCha8Rng, range: std::ops::Range<u64>) -> u64 {
    range.start + random.next_u64() % (range.end - range.start)
}
