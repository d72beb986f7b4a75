//! Random parameters of a world.

use swap::SwapLimits;

use crate::{
    faults::MAX_PREVIOUS_ATTEMPTS,
    rng::{MAX_DELAY_MS, SimRng},
};

/// Random parameters of a world.
#[derive(Debug)]
pub(crate) struct Scenario {
    pub(crate) period_ms: u64,
    pub(crate) faults_until_ms: u64,
    pub(crate) exits_per_mille: u64,
    pub(crate) hangs_per_mille: u64,
    pub(crate) bad_candidates_per_mille: u64,
    pub(crate) subscribers_restart: bool,
    pub(crate) supervisor_exits_ms: Option<u64>,
    /// Lateness of the subscribers, ticks.
    pub(crate) lateness_ticks: u64,
    /// Number of outputs that a process keeps. In some worlds it is too small for every hand-over
    /// to succeed.
    pub(crate) history_ticks: usize,
    /// Upper limit of the regular delay from a process to its subscribers, ms.
    pub(crate) max_link_delay_ms: u64,
    pub(crate) limits: SwapLimits,
}

impl Scenario {
    pub(crate) fn new(rng: &mut SimRng) -> Self {
        let subscribers_restart = rng.chance(300);
        let period_ms = rng.in_range(1, 3);
        let limits = SwapLimits {
            ready_timeout_ms: 60,
            catch_up_timeout_ms: 80,
            shadow_ms: rng.in_range(0, 30),
            commit_timeout_ms: rng.in_range(60, 150),
            restore_timeout_ms: 120,
            linger_ms: if subscribers_restart { 1000 } else { rng.in_range(0, 60) },
            stop_retry_ms: 30,
            max_lag_ticks: rng.in_range(8, 20),
            margin_ticks: rng.in_range(0, 60),
        };
        let lateness_ticks = limits.max_lag_ticks
            + limits.margin_ticks(MAX_PREVIOUS_ATTEMPTS)
            + (limits.commit_timeout_ms + 260) / period_ms;
        let is_fault_free = rng.chance(300);
        Self {
            period_ms,
            faults_until_ms: rng.in_range(200, 700),
            exits_per_mille: if is_fault_free { 0 } else { rng.in_range(0, 6) },
            hangs_per_mille: if is_fault_free { 0 } else { rng.in_range(0, 6) },
            bad_candidates_per_mille: if is_fault_free { 0 } else { rng.in_range(0, 400) },
            subscribers_restart,
            supervisor_exits_ms: rng.chance(20).then(|| rng.in_range(0, 700)),
            lateness_ticks,
            history_ticks: if rng.chance(150) { rng.in_range(1, 60) } else { lateness_ticks } as usize,
            max_link_delay_ms: if rng.chance(200) { 60 } else { MAX_DELAY_MS },
            limits,
        }
    }
}
