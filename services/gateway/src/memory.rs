//! How much memory the gateway may take: what comes from outside can make Zenoh keep more than its settings say.
//!
//! A message that comes in many small parts holds a buffer for each, and what a client declares is kept as long as it is connected; Zenoh
//! limits neither. A gateway that has grown too much ends, says so, and begins anew; the data path does not notice.

use std::{
    fs,
    time::{Duration, Instant},
};

use crate::GatewayError;

/// Between two looks.
const INTERVAL: Duration = Duration::from_millis(50);
/// Memory of its own that a gateway may take beyond what it has at its start, KiB. 64 stations that do not read take a third of it.
const GROWTH_MAX_KIB: u64 = 96 * 1024;
/// As much more for a gateway of a split system, which keeps ticks.
const TICKS_KIB: u64 = 256 * 1024;

/// Looks now and then how much it is.
#[derive(Debug)]
pub(crate) struct Memory {
    limit_kib: u64,
    looked: Instant,
}

impl Memory {
    /// From here on it counts.
    pub(crate) fn new(is_split: bool) -> Self {
        let ticks_kib = if is_split { TICKS_KIB } else { 0 };
        Self { limit_kib: own_kib().unwrap_or(0) + GROWTH_MAX_KIB + ticks_kib, looked: Instant::now() }
    }

    /// It is not too much.
    pub(crate) fn check(&mut self) -> Result<(), GatewayError> {
        if self.looked.elapsed() < INTERVAL {
            return Ok(());
        }
        self.looked = Instant::now();
        match own_kib() {
            Some(own_kib) if own_kib > self.limit_kib => {
                Err(GatewayError::Memory { has_mib: own_kib / 1024, limit_mib: self.limit_kib / 1024 })
            }
            _ => Ok(()),
        }
    }
}

/// What this process has in memory and shares with nobody, KiB. A system that does not tell has no limit here.
fn own_kib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    line.split_whitespace().next()?.parse().ok()
}
