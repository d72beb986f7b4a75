//! What differs from world to world.

use swap::Limits;

use crate::{
    chance::{Chance, DELAY_MS},
    faults::ATTEMPTS_BEFORE_MAX,
};

/// What this world is like.
#[derive(Debug)]
pub(crate) struct Nature {
    pub(crate) period_ms: u64,
    pub(crate) faults_until_ms: u64,
    pub(crate) deaths_per_mille: u64,
    pub(crate) hangs_per_mille: u64,
    pub(crate) bad_candidates_per_mille: u64,
    pub(crate) readers_restart: bool,
    pub(crate) supervisor_dies_ms: Option<u64>,
    /// Ticks that a reader waits for others.
    pub(crate) lateness_ticks: u64,
    /// Ticks that a process keeps; too few now and then.
    pub(crate) kept_ticks: usize,
    /// Longest usual delay between a process and its readers, ms.
    pub(crate) outlet_ms: u64,
    pub(crate) limits: Limits,
}

impl Nature {
    pub(crate) fn new(chance: &mut Chance) -> Self {
        let readers_restart = chance.happens(300);
        let period_ms = chance.between(1, 3);
        let limits = Limits {
            ready_ms: 60,
            caught_up_ms: 80,
            shadow_ms: chance.between(0, 30),
            commit_ms: chance.between(60, 150),
            restore_ms: 120,
            linger_ms: if readers_restart { 1000 } else { chance.between(0, 60) },
            end_ms: 30,
            lag_max_ticks: chance.between(8, 20),
            margin_ticks: chance.between(0, 60),
        };
        let lateness_ticks =
            limits.lag_max_ticks + limits.margin_ticks(ATTEMPTS_BEFORE_MAX) + (limits.commit_ms + 260) / period_ms;
        let calm = chance.happens(300);
        Self {
            period_ms,
            faults_until_ms: chance.between(200, 700),
            deaths_per_mille: if calm { 0 } else { chance.between(0, 6) },
            hangs_per_mille: if calm { 0 } else { chance.between(0, 6) },
            bad_candidates_per_mille: if calm { 0 } else { chance.between(0, 400) },
            readers_restart,
            supervisor_dies_ms: chance.happens(20).then(|| chance.between(0, 700)),
            lateness_ticks,
            kept_ticks: if chance.happens(150) { chance.between(1, 60) } else { lateness_ticks } as usize,
            outlet_ms: if chance.happens(200) { 60 } else { DELAY_MS },
            limits,
        }
    }
}
