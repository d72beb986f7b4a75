//! Which ticks of a topic with every tick never came, whatever the order in which they came.
//!
//! Input: the tick and the losses of each message. Output: how many were published and not seen. A tick may come late, from another
//! incarnation of the publisher, or again. Failure: beyond a number of gaps the oldest counts for good.

/// Gaps that may still be filled.
const MAX_OPEN: usize = 64;

#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// The tick after the newest one.
    next: Option<u64>,
    /// First and last tick after each gap.
    open: Vec<(u64, u64)>,
    /// Ticks of gaps that count for good.
    settled: u64,
    /// Ticks that the publisher never had: when the first message came, and now.
    lost_upstream: Option<(u64, u64)>,
}

impl Gaps {
    /// From this tick on every one is expected.
    pub(crate) fn from(tick: u64) -> Self {
        Self { next: Some(tick), lost_upstream: Some((0, 0)), ..Self::default() }
    }

    pub(crate) fn take(&mut self, tick: u64, lost_upstream: u64) {
        let (first, most) = self.lost_upstream.unwrap_or((lost_upstream, lost_upstream));
        self.lost_upstream = Some((first, most.max(lost_upstream)));
        let next = self.next.unwrap_or(tick);
        self.next = Some(next.max(tick.saturating_add(1)));
        if tick > next {
            if self.open.len() == MAX_OPEN {
                let (first, end) = self.open.remove(0);
                self.settled += end - first;
            }
            self.open.push((next, tick));
        } else if tick < next {
            self.fill(tick);
        }
    }

    /// Ticks that were published and not seen.
    pub(crate) fn missed(&self) -> u64 {
        let open: u64 = self.open.iter().map(|(first, end)| end - first).sum();
        let (first, most) = self.lost_upstream.unwrap_or_default();
        (self.settled + open).saturating_sub(most.saturating_sub(first))
    }

    fn fill(&mut self, tick: u64) {
        let Some(at) = self.open.iter().position(|&(first, end)| (first..end).contains(&tick)) else { return };
        let (first, end) = self.open.remove(at);
        let left = [(first, tick), (tick + 1, end)].into_iter().filter(|(first, end)| first < end);
        self.open.splice(at..at, left);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missed(gaps: Gaps, ticks: &[(u64, u64)]) -> u64 {
        let mut gaps = gaps;
        ticks.iter().for_each(|&(tick, lost_upstream)| gaps.take(tick, lost_upstream));
        gaps.missed()
    }

    #[test]
    fn what_never_came_is_missed_and_what_was_never_published_is_not() {
        assert_eq!(missed(Gaps::default(), &[(5, 0), (6, 0), (10, 0)]), 3);
        assert_eq!(missed(Gaps::default(), &[(5, 2), (6, 2), (10, 4)]), 1);
        assert_eq!(missed(Gaps::from(0), &[(5, 2), (6, 2)]), 3, "the first five are expected, two were lost before");
    }

    #[test]
    fn what_comes_late_or_again_is_not_missed() {
        assert_eq!(missed(Gaps::from(0), &[(0, 0), (4, 0), (2, 0), (1, 0), (3, 0), (3, 0), (5, 0)]), 0);
        assert_eq!(missed(Gaps::from(0), &[(0, 0), (4, 0), (2, 0), (2, 0)]), 2);
    }

    #[test]
    fn the_memory_of_gaps_is_limited_and_their_count_is_not() {
        let ticks: Vec<_> = (0..1000).map(|n| (2 * n, 0)).collect();
        let mut gaps = Gaps::default();
        ticks.iter().for_each(|&(tick, lost)| gaps.take(tick, lost));
        assert_eq!((gaps.open.len(), gaps.missed()), (MAX_OPEN, 999));
    }
}
