//! Memory limit of the gateway. It is needed because remote peers can make Zenoh use more memory
//! than configured.
//!
//! A message split into many small fragments occupies a buffer for each of them, and a client's
//! declarations are kept as long as the client is connected. Zenoh limits neither. A gateway that
//! exceeds the limit ends with an error and is restarted. The data path is not affected.

use std::{
    fs,
    time::{Duration, Instant},
};

use crate::error::GatewayError;

/// Interval between two checks of the memory limit.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum growth of private memory since the start, KiB. 64 connected stations that never read
/// their messages use a third of this limit.
const MAX_GROWTH_KIB: u64 = 96 * 1024;
/// Additional growth allowed for the tick cache of a split system, KiB.
const TICK_CACHE_KIB: u64 = 256 * 1024;

/// Periodic check of the memory limit.
#[derive(Debug)]
pub(crate) struct MemoryLimit {
    limit_kib: u64,
    checked: Instant,
}

impl MemoryLimit {
    /// Creates a limit relative to the memory currently in use.
    pub(crate) fn new(is_split: bool) -> Self {
        let tick_cache_kib = if is_split { TICK_CACHE_KIB } else { 0 };
        Self { limit_kib: private_kib().unwrap_or(0) + MAX_GROWTH_KIB + tick_cache_kib, checked: Instant::now() }
    }

    /// Returns an error if the limit is exceeded.
    pub(crate) fn check(&mut self) -> Result<(), GatewayError> {
        if self.checked.elapsed() < CHECK_INTERVAL {
            return Ok(());
        }
        self.checked = Instant::now();
        match private_kib() {
            Some(private_kib) if private_kib > self.limit_kib => {
                Err(GatewayError::Memory { used_mib: private_kib / 1024, limit_mib: self.limit_kib / 1024 })
            }
            _ => Ok(()),
        }
    }
}

/// Returns the private memory of the process in KiB, or `None` if the kernel does not report it.
fn private_kib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    line.split_whitespace().next()?.parse().ok()
}
