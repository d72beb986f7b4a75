//! Wraps of the counters that devices use as clocks.

/// Periods of 32-bit counters of µs and of ms, in ns. Their wraps are recognised by the size of the
/// step across the wrap.
pub const COUNTER_PERIODS_NS: [i64; 2] = [(1 << 32) * 1_000, (1 << 32) * 1_000_000];
/// Maximum step across the wrap of a counter of unknown period, ns.
const MAX_WRAP_STEP_NS: i64 = 10_000_000_000;

/// Returns the period of the counter if the decrease from `last_ns` to `t_ns` is a wrap.
///
/// `period_ns` is the period if it is known. Otherwise, a wrap of a 32-bit counter of µs or ms is
/// recognised if the step across it is short enough.
pub fn wrap_ns(period_ns: Option<i64>, last_ns: i64, t_ns: i64) -> Option<i64> {
    let known = period_ns.map(|period_ns| (period_ns, period_ns / 2));
    let guessed = COUNTER_PERIODS_NS.map(|period_ns| (period_ns, MAX_WRAP_STEP_NS));
    let mut periods = known.into_iter().chain(guessed.into_iter().filter(|_| known.is_none()));
    periods.find_map(|(period_ns, max_step_ns)| {
        let step_ns = t_ns.checked_add(period_ns)?.checked_sub(last_ns)?;
        (t_ns < last_ns && (1..=max_step_ns).contains(&step_ns)).then_some(period_ns)
    })
}

/// Periods of narrower counters, ns: 16 bits of ms, 24 and 31 bits of µs, 31 bits of ms, and 32
/// bits of ns. They are so short that a restart of the device could be mistaken for a wrap. The
/// step across the wrap is therefore compared with the previous step.
const NARROW_PERIODS_NS: [i64; 5] =
    [(1 << 16) * 1_000_000, (1 << 24) * 1_000, (1 << 31) * 1_000, (1 << 31) * 1_000_000, 1 << 32];

/// Returns the period of a narrow counter if it has wrapped between `last_ns` and the smaller value
/// `t_ns`. The step across the wrap must be similar to the previous step, `interval_ns`.
pub fn narrow_period_ns(interval_ns: i64, last_ns: i64, t_ns: i64) -> Option<i64> {
    NARROW_PERIODS_NS.into_iter().find(|period_ns| {
        let steps_ns = interval_ns.saturating_add(1) / 2..=interval_ns.saturating_mul(2);
        let is_in_period = t_ns >= 0 && t_ns < last_ns && last_ns < *period_ns;
        is_in_period && interval_ns > 0 && steps_ns.contains(&(t_ns + period_ns - last_ns))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wraps_are_told_from_restarts() {
        let [us, ms] = COUNTER_PERIODS_NS;
        assert_eq!(wrap_ns(None, us - 5, 5), Some(us));
        assert_eq!(wrap_ns(None, ms - 5, 5), Some(ms));
        assert_eq!(wrap_ns(None, us / 2, 5), None, "a restart");
        assert_eq!(wrap_ns(None, 10, 5), None, "out of order");
        assert_eq!(wrap_ns(Some(1000), 900, 100), Some(1000));
        assert_eq!(wrap_ns(Some(1000), 900, 800), None, "out of order");
        let narrow = 65_536_000_000;
        let step = 10_000_000;
        assert_eq!(narrow_period_ns(step, narrow - 4_000_000, 6_000_000), Some(narrow));
        assert_eq!(narrow_period_ns(step, narrow - 4_000_000, 60_000_000), None, "a restart");
        assert_eq!(narrow_period_ns(step, narrow - 90_000_000, 6_000_000), None, "a restart");
        assert_eq!(narrow_period_ns(step, 20_000_000, 10_000_000), None, "out of order");
        assert_eq!(narrow_period_ns(0, narrow, 0), None, "unknown interval");
    }
}
