//! Time limits and attempts of a swap, and the margin before the hand-over.

use swap::SwapLimits;

use crate::Config;

/// Time from the newest sample to the hand-over tick, s. If the decision takes longer to arrive,
/// the hand-over is reverted.
const MARGIN_S: f64 = 0.05;
/// Maximum number of attempts per swap request.
///
/// Each retry doubles the margin [`MARGIN_S`], because a stalled machine can deliver the decision
/// too late.
pub(crate) const MAX_ATTEMPTS: u32 = 3;

/// Returns the limits of all swaps of a system.
pub(crate) fn swap_limits(config: &Config) -> SwapLimits {
    let Config { rate_hz, lockstep, window_ticks, .. } = *config;
    let margin_ticks = if lockstep { window_ticks } else { (rate_hz * MARGIN_S) as u64 }.max(8);
    let longest_margin_ticks = if lockstep { margin_ticks } else { margin_ticks << (MAX_ATTEMPTS - 1) };
    SwapLimits {
        ready_timeout_ms: 10_000,
        catch_up_timeout_ms: 5_000,
        shadow_ms: 100,
        commit_timeout_ms: 300 + (longest_margin_ticks as f64 / rate_hz * 1e3) as u64,
        restore_timeout_ms: 500,
        // In lockstep the previous stage keeps running for a long time, because a restarted
        // subscriber needs its outputs no matter how late it returns. The 60 s cover a replacement
        // that takes `ready_timeout_ms` to fail, followed by a few processes that take as long to
        // start.
        linger_ms: if lockstep { 60_000 } else { 1_000 },
        stop_retry_ms: 400,
        max_lag_ticks: ((rate_hz * 0.02) as u64).max(8),
        margin_ticks,
    }
}
