//! Counts missed ticks on a topic that has a message for every tick.
//!
//! Input: tick and upstream loss counter of each message, in any order. A tick may arrive late,
//! repeatedly or from another incarnation of the publisher.
//!
//! Output: number of ticks that were published but not received.
//!
//! Failure: if there are too many open gaps, the oldest one is closed, and late ticks can no longer
//! fill it.

/// Maximum number of open gaps. Late ticks can still fill an open gap.
const MAX_OPEN_GAPS: usize = 64;

#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// Tick after the newest one received; `None` if the first message may have any tick.
    next: Option<u64>,
    /// First tick and end tick (exclusive) of each open gap.
    open: Vec<(u64, u64)>,
    /// Number of ticks in closed gaps.
    closed: u64,
    /// Value of the upstream loss counter in the first message, and its maximum since then.
    lost_upstream: Option<(u64, u64)>,
}

impl Gaps {
    /// Creates a counter that expects every tick starting with `tick`.
    pub(crate) fn starting_at(tick: u64) -> Self {
        Self { next: Some(tick), lost_upstream: Some((0, 0)), ..Self::default() }
    }

    pub(crate) fn record(&mut self, tick: u64, lost_upstream: u64) {
        let (first, newest) = self.lost_upstream.unwrap_or((lost_upstream, lost_upstream));
        self.lost_upstream = Some((first, newest.max(lost_upstream)));
        let next = self.next.unwrap_or(tick);
        self.next = Some(next.max(tick.saturating_add(1)));
        if tick > next {
            if self.open.len() == MAX_OPEN_GAPS {
                let (first, end) = self.open.remove(0);
                self.closed += end - first;
            }
            self.open.push((next, tick));
        } else if tick < next {
            self.fill(tick);
        }
    }

    /// Returns the number of ticks that were published but not received.
    pub(crate) fn missed(&self) -> u64 {
        let open: u64 = self.open.iter().map(|(first, end)| end - first).sum();
        let (first, newest) = self.lost_upstream.unwrap_or_default();
        (self.closed + open).saturating_sub(newest.saturating_sub(first))
    }

    fn fill(&mut self, tick: u64) {
        let Some(index) = self.open.iter().position(|&(first, end)| (first..end).contains(&tick)) else { return };
        let (first, end) = self.open.remove(index);
        let remaining = [(first, tick), (tick + 1, end)].into_iter().filter(|(first, end)| first < end);
        self.open.splice(index..index, remaining);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missed(gaps: Gaps, ticks: &[(u64, u64)]) -> u64 {
        let mut gaps = gaps;
        ticks.iter().for_each(|&(tick, lost_upstream)| gaps.record(tick, lost_upstream));
        gaps.missed()
    }

    #[test]
    fn absent_ticks_are_missed_unless_lost_upstream() {
        assert_eq!(missed(Gaps::default(), &[(5, 0), (6, 0), (10, 0)]), 3);
        assert_eq!(missed(Gaps::default(), &[(5, 2), (6, 2), (10, 4)]), 1);
        let early = missed(Gaps::starting_at(0), &[(5, 2), (6, 2)]);
        assert_eq!(early, 3, "the first five are expected, two were lost before");
    }

    #[test]
    fn late_and_repeated_ticks_are_not_missed() {
        assert_eq!(missed(Gaps::starting_at(0), &[(0, 0), (4, 0), (2, 0), (1, 0), (3, 0), (3, 0), (5, 0)]), 0);
        assert_eq!(missed(Gaps::starting_at(0), &[(0, 0), (4, 0), (2, 0), (2, 0)]), 2);
    }

    #[test]
    fn open_gaps_are_bounded_and_count_is_exact() {
        let ticks: Vec<_> = (0..1000).map(|n| (2 * n, 0)).collect();
        let mut gaps = Gaps::default();
        ticks.iter().for_each(|&(tick, lost)| gaps.record(tick, lost));
        assert_eq!((gaps.open.len(), gaps.missed()), (MAX_OPEN_GAPS, 999));
    }
}
