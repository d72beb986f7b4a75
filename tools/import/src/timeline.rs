//! Times of the samples of one series. Resolves wraps of counters, and splits the series into
//! segments between restarts of the clock.
//!
//! Input: the timestamps of a series in file order.
//!
//! Output: times that do not wrap, and the [`Segment`] of each sample.
//!
//! Time: the clock of the source.
//!
//! Failure: a single sample that is earlier than its predecessor remains in the current segment.
//! The consumer skips and counts such samples.

use mapping::counter::{COUNTER_PERIODS_NS, narrow_period_ns, wrap_ns};

use crate::{ImportError, row_writer::Samples};

/// Number of consecutive samples that confirm that the clock was set back. The times of these
/// samples must increase, and must all be earlier than that of a previous sample.
const CONFIRMING_SAMPLES: usize = 5;
/// Maximum number of segments. Later segments are merged into the last one.
const MAX_SEGMENTS: usize = 256;
/// Tolerance for assigning a sample to a segment of another series, ns.
const SLACK_NS: i64 = 1_000_000_000;

/// Part of a log between two restarts of the clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Time of the first sample, ns.
    pub first_ns: i64,
    /// Time of the last sample, ns.
    pub last_ns: i64,
    /// Number of samples.
    pub samples: u64,
}

impl Segment {
    /// Returns the time from the first to the last sample, s.
    pub fn duration_s(&self) -> f64 {
        self.last_ns.abs_diff(self.first_ns) as f64 / 1e9
    }
}

/// Sample with a timestamp.
pub(crate) trait Timed {
    /// Returns the time, ns.
    fn t_ns(&self) -> i64;

    /// Adds an offset to the time.
    fn shift(&mut self, offset_ns: i64);
}

/// Clock of a source.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct SourceClock {
    /// Period of the counter in ns, if known.
    pub(crate) period_ns: Option<i64>,
}

/// Finds the segments of a series.
#[derive(Debug, Clone, Default)]
pub(crate) struct SegmentFinder {
    clock: SourceClock,
    offset_ns: i64,
    /// Interval between the last two samples with increasing time, ns.
    interval_ns: i64,
    /// Times of the latest samples, all of which are earlier than the end of the segment. The times
    /// increase from sample to sample.
    backward_ns: Vec<i64>,
    segments: Vec<Segment>,
    /// Number of times that the counter wrapped.
    pub(crate) wraps: u64,
}

/// Relation of a sample to the segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// The sample belongs to the current segment.
    Current,
    /// The sample is earlier than its predecessor. The following samples decide whether it starts a
    /// new segment.
    Backward,
    /// The sample confirms a new segment, which starts with the first of the backward samples.
    NewSegment,
}

impl SegmentFinder {
    pub(crate) fn new(clock: &SourceClock) -> Self {
        Self { clock: clock.clone(), ..Self::default() }
    }

    /// Adds the next timestamp.
    pub(crate) fn push(&mut self, t_ns: i64) {
        self.step(t_ns);
    }

    /// Returns the clock with its counter period, derived from the steps between the samples.
    pub(crate) fn clock(&self) -> SourceClock {
        self.clock.clone()
    }

    /// Returns the segments so far.
    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    fn step(&mut self, raw_ns: i64) -> Step {
        let mut t_ns = raw_ns.saturating_add(self.offset_ns);
        let has_room = self.segments.len() < MAX_SEGMENTS;
        let Some(segment) = self.segments.last_mut() else {
            self.segments.push(Segment { first_ns: t_ns, last_ns: t_ns, samples: 1 });
            return Step::Current;
        };
        if self.clock.period_ns.is_none() && self.offset_ns == 0 {
            self.clock.period_ns = narrow_period_ns(self.interval_ns, segment.last_ns, t_ns);
        }
        if t_ns < segment.last_ns
            && let Some(period_ns) = wrap_ns(self.clock.period_ns, segment.last_ns, t_ns)
        {
            self.offset_ns = self.offset_ns.saturating_add(period_ns);
            self.wraps += 1;
            t_ns = t_ns.saturating_add(period_ns);
        }
        if t_ns >= segment.last_ns || !has_room {
            self.backward_ns.clear();
            if t_ns > segment.last_ns {
                self.interval_ns = t_ns.saturating_sub(segment.last_ns);
            }
            segment.last_ns = segment.last_ns.max(t_ns);
            segment.samples += 1;
            return Step::Current;
        }
        if self.backward_ns.last().is_some_and(|last_ns| t_ns <= *last_ns) {
            segment.samples += self.backward_ns.len() as u64;
            self.backward_ns.clear();
        }
        self.backward_ns.push(t_ns);
        if self.backward_ns.len() < CONFIRMING_SAMPLES {
            return Step::Backward;
        }
        let first_ns = self.backward_ns.first().copied().unwrap_or(t_ns);
        self.segments.push(Segment { first_ns, last_ns: t_ns, samples: CONFIRMING_SAMPLES as u64 });
        self.backward_ns.clear();
        Step::NewSegment
    }
}

/// Returns the index of the longest segment; the first one if several are equally long.
pub(crate) fn longest(segments: &[Segment]) -> usize {
    let length_ns = |segment: &Segment| segment.last_ns.abs_diff(segment.first_ns);
    (0..segments.len()).rev().max_by_key(|index| segments.get(*index).map(length_ns)).unwrap_or(0)
}

/// Segments of the series that determines the rows, and the segment to read.
#[derive(Debug, Clone, Default)]
pub(crate) struct SegmentChoice {
    pub(crate) clock: SourceClock,
    pub(crate) segments: Vec<Segment>,
    /// Index of the segment to read.
    pub(crate) index: usize,
}

impl SegmentChoice {
    /// Returns the samples of the series that determines the rows, limited to the chosen segment.
    pub(crate) fn rows<'a, T: Timed + 'a>(&self, samples: Samples<'a, T>) -> Samples<'a, T> {
        let (chosen, mut finder) = (self.index, SegmentFinder::new(&self.clock));
        let (mut samples, mut index, mut pending, mut ready) = (samples, 0, Vec::new(), Vec::new());
        let mut next = move || -> Result<Option<T>, ImportError> {
            loop {
                // `ready` is in reverse order.
                if let Some((segment, sample)) = ready.pop() {
                    if segment == chosen {
                        return Ok(Some(sample));
                    }
                    continue;
                }
                let Some(mut sample) = samples.next().transpose()? else {
                    ready.extend(pending.drain(..).rev().map(|sample| (index, sample)));
                    if ready.is_empty() {
                        return Ok(None);
                    }
                    continue;
                };
                let waiting = finder.backward_ns.len();
                let step = finder.step(sample.t_ns());
                sample.shift(finder.offset_ns);
                let is_stale = step == Step::Current || waiting > 0 && finder.backward_ns.len() == 1;
                if is_stale {
                    // The samples that went back did not start a new segment, so they belong to the
                    // current one.
                    ready.extend(pending.drain(..).map(|sample| (index, sample)));
                }
                match step {
                    Step::Current => ready.push((index, sample)),
                    Step::Backward => pending.push(sample),
                    Step::NewSegment => {
                        index += 1;
                        ready.extend(pending.drain(..).map(|sample| (index, sample)));
                        ready.push((index, sample));
                    }
                }
                ready.reverse();
            }
        };
        Box::new(std::iter::from_fn(move || next().transpose()))
    }

    /// Returns the samples of another series, limited to the chosen segment.
    ///
    /// After the clock has gone back, the samples belong to the next segment that contains their
    /// time.
    pub(crate) fn others<'a, T: Timed + 'a>(&self, samples: Samples<'a, T>) -> Samples<'a, T> {
        let has_wrapped = self.segments.iter().any(|segment| self.wrapped_ns(segment.last_ns) > 0);
        if self.segments.len() < 2 && !has_wrapped {
            return samples;
        }
        let (choice, mut current, mut last_ns, mut offset_ns) = (self.clone(), 0, None::<i64>, 0);
        Box::new(samples.filter_map(move |sample| {
            let mut sample = match sample {
                Ok(sample) => sample,
                Err(error) => return Some(Err(error)),
            };
            let raw_ns = sample.t_ns();
            let t_ns = raw_ns.saturating_add(offset_ns);
            let goes_back = last_ns.is_some_and(|last_ns| t_ns < last_ns);
            if last_ns.is_none() || goes_back || !choice.contains(current, t_ns) {
                let from = if last_ns.is_none() { 0 } else { current };
                let found = choice.find(from, raw_ns, goes_back.then_some(t_ns));
                if let Some((index, shift_ns)) = found {
                    (current, offset_ns) = (index, shift_ns);
                }
            }
            last_ns = Some(raw_ns.saturating_add(offset_ns));
            sample.shift(offset_ns);
            (current == choice.index).then_some(Ok(sample))
        }))
    }

    fn wrapped_ns(&self, t_ns: i64) -> i64 {
        let periods = self.clock.period_ns.into_iter().chain(COUNTER_PERIODS_NS);
        periods.filter(|period_ns| t_ns >= *period_ns).min().unwrap_or(0)
    }

    fn contains(&self, index: usize, t_ns: i64) -> bool {
        self.segments.get(index).is_some_and(|segment| {
            (segment.first_ns.saturating_sub(SLACK_NS)..=segment.last_ns.saturating_add(SLACK_NS)).contains(&t_ns)
        })
    }

    /// Returns the index of the first segment that contains the time `raw_ns`, and the offset in ns
    /// to add to this time. The search starts at the segment `from`.
    ///
    /// If `back_ns` is given, the clock has gone back to that time. The result is then a later
    /// segment, or an offset that includes a further wrap of the counter.
    fn find(&self, from: usize, raw_ns: i64, back_ns: Option<i64>) -> Option<(usize, i64)> {
        (from..self.segments.len()).find_map(|index| {
            let segment = self.segments.get(index)?;
            let periods = self.clock.period_ns.into_iter().chain(COUNTER_PERIODS_NS);
            // For each period, the smallest multiple that moves the time into the segment, and past
            // `back_ns` if the segment is the current one.
            let start_ns = segment.first_ns.saturating_sub(SLACK_NS);
            let least_ns = back_ns.filter(|_| index == from).map_or(start_ns, |back_ns| start_ns.max(back_ns));
            let wraps = periods.map(|period_ns| {
                let distance_ns = least_ns.saturating_sub(raw_ns);
                distance_ns.div_euclid(period_ns).saturating_add(1).max(0).saturating_mul(period_ns)
            });
            let offsets = std::iter::once(0).chain(wraps);
            let is_possible = |offset_ns: &i64| {
                let t_ns = raw_ns.saturating_add(*offset_ns);
                self.contains(index, t_ns) && (index > from || back_ns.is_none_or(|back_ns| t_ns > back_ns))
            };
            offsets.into_iter().find(is_possible).map(|offset_ns| (index, offset_ns))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Timed for i64 {
        fn t_ns(&self) -> i64 {
            *self
        }

        fn shift(&mut self, offset_ns: i64) {
            *self += offset_ns;
        }
    }

    const MS: i64 = 1_000_000;

    fn times(ms: &[i64]) -> Samples<'static, i64> {
        Box::new(ms.iter().map(|ms| Ok(ms * MS)).collect::<Vec<_>>().into_iter())
    }

    fn choice(ms: &[i64], period_ns: Option<i64>) -> SegmentChoice {
        let clock = SourceClock { period_ns };
        let mut finder = SegmentFinder::new(&clock);
        ms.iter().for_each(|ms| finder.push(ms * MS));
        let clock = finder.clock();
        SegmentChoice { clock, segments: finder.segments().to_vec(), index: 0 }
    }

    fn ms(samples: Samples<'_, i64>) -> Vec<i64> {
        samples.map(|t_ns| t_ns.unwrap() / MS).collect()
    }

    #[test]
    fn clock_set_back_starts_segment_and_single_samples_do_not() {
        let stamps = [100, 110, 105, 120, 130, 10, 20, 30, 40, 50, 45, 60];
        let mut choice = choice(&stamps, None);
        assert_eq!(choice.segments.iter().map(|segment| segment.first_ns / MS).collect::<Vec<_>>(), [100, 10]);
        assert_eq!(longest(&choice.segments), 1);
        assert_eq!(ms(choice.rows(times(&stamps))), [100, 110, 105, 120, 130]);
        choice.index = 1;
        assert_eq!(ms(choice.rows(times(&stamps))), [10, 20, 30, 40, 50, 45, 60]);
        assert_eq!(ms(choice.others(times(&[101, 131, 11, 41]))), [11, 41]);
    }

    #[test]
    fn wrapped_counters_continue() {
        let period_ms = COUNTER_PERIODS_NS[0] / MS;
        let stamps: Vec<i64> = (-50..50).map(|n| (n * 20_i64).rem_euclid(period_ms)).collect();
        let choice = choice(&stamps, None);
        assert_eq!(choice.segments.len(), 1);
        let rows = ms(choice.rows(times(&stamps)));
        assert!(rows.windows(2).all(|pair| (19..=21).contains(&(pair[1] - pair[0]))), "{rows:?}");
        assert_eq!(ms(choice.others(times(&[period_ms - 500, 500]))), [period_ms - 500, period_ms + 500]);
        assert_eq!(ms(choice.others(times(&[500]))).len(), 1, "the series starts after the wrap");
    }

    #[test]
    fn narrow_counters_are_recognised_by_their_step() {
        let period_ms = 65_536;
        let stamps: Vec<i64> = (-100..7000).map(|n| (n * 20_i64).rem_euclid(period_ms)).collect();
        let narrow = choice(&stamps, None);
        assert_eq!((narrow.segments.len(), narrow.clock.period_ns), (1, Some(period_ms * MS)));
        let rows = ms(narrow.rows(times(&stamps)));
        assert!(rows.len() == stamps.len() && rows.windows(2).all(|pair| pair[1] - pair[0] == 20), "{rows:?}");
        assert_eq!(ms(narrow.others(times(&[period_ms - 500, 500]))), [period_ms - 500, period_ms + 500]);
        let restart: Vec<i64> = (0..100).map(|n| 65_000 + 5 * n).chain((0..100).map(|n| 100 + 5 * n)).collect();
        assert_eq!(choice(&restart, None).segments.len(), 2, "a restart");
    }

    #[test]
    fn counter_of_known_width_wraps_repeatedly() {
        let stamps: Vec<i64> = (0..200).map(|n| n * 10 % 65).collect();
        let choice = choice(&stamps, Some(65 * MS));
        assert_eq!(choice.segments.len(), 1);
        assert_eq!(ms(choice.rows(times(&stamps))), (0..200).map(|n| n * 10).collect::<Vec<_>>());
    }
}
