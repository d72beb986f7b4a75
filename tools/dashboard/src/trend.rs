//! Values of the last minute.

use std::{collections::VecDeque, time::Duration};

use crate::orientation::Attitude;

/// Interval between two values of a trend.
pub const SAMPLE_INTERVAL: Duration = Duration::from_millis(500);
/// Number of values kept: one minute.
const MAX_SAMPLES: usize = 120;

/// Key figures of a system. A figure is `None` if it is unknown.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figures {
    /// Newest tick.
    pub tick: Option<u64>,
    /// Attitudes per second.
    pub rate_hz: Option<f64>,
    /// Median and 99th percentile of the end-to-end latency, µs.
    pub latency_us: Option<[f64; 2]>,
    /// Number of lost ticks, or of lost messages of a remote vehicle.
    pub lost: Option<u64>,
}

/// Values of one quantity over the last minute.
#[derive(Debug, Clone, PartialEq)]
pub struct Trend {
    /// Name of the quantity.
    pub name: &'static str,
    /// Unit; empty for a count.
    pub unit: &'static str,
    /// `true` if the scale starts at 0, so that 0 is an empty bar. Otherwise, the scale starts at
    /// the minimum.
    from_zero: bool,
    values: VecDeque<Option<f64>>,
}

/// Trends of a system.
#[derive(Debug, Clone, PartialEq)]
pub struct Trends {
    previous_lost: Option<u64>,
    /// Roll, pitch, yaw, rate, 99th percentile of the latency, losses per interval.
    pub all: [Trend; 6],
}

impl Default for Trends {
    fn default() -> Self {
        let trend = |name, unit, from_zero| Trend { name, unit, from_zero, values: VecDeque::new() };
        Self {
            previous_lost: None,
            all: [
                trend("roll", "°", false),
                trend("pitch", "°", false),
                trend("yaw", "°", false),
                trend("rate", "Hz", true),
                trend("p99", "µs", true),
                trend("lost", "", true),
            ],
        }
    }
}

impl Trends {
    /// Adds the current values. Call this once per [`SAMPLE_INTERVAL`].
    pub fn push(&mut self, figures: &Figures, attitude: Option<&Attitude>) {
        let lost = figures.lost.zip(self.previous_lost).map(|(now, before)| now.saturating_sub(before) as f64);
        self.previous_lost = figures.lost;
        let angles = attitude.map_or([None; 3], |attitude| attitude.roll_pitch_yaw_deg.map(Some));
        let others = [figures.rate_hz, figures.latency_us.map(|[_, p99]| p99), lost];
        for (trend, value) in self.all.iter_mut().zip(angles.into_iter().chain(others)) {
            trend.push(value);
        }
    }
}

impl Trend {
    fn push(&mut self, value: Option<f64>) {
        if self.values.len() == MAX_SAMPLES {
            self.values.pop_front();
        }
        self.values.push_back(value.filter(|value| value.is_finite()));
    }

    /// Returns the newest value with its unit, or a dash if unknown.
    pub fn newest(&self) -> String {
        let value = self.values.back().copied().flatten();
        value.map_or("–".into(), |value| match (self.from_zero, self.unit) {
            (false, unit) => format!("{}{unit}", format_signed(value)),
            (true, "") => format!("{value:.0}"),
            (true, unit) => format!("{value:.0} {unit}"),
        })
    }

    /// Returns `count` bars over the last minute, the newest last, in steps from 0 to `height`.
    ///
    /// A bar is `None` if all its values are unknown. It is 0 only if its value is 0 and the scale
    /// starts at 0. A bar that covers several values shows the one farthest from the middle of the
    /// scale, so that peaks stay visible.
    pub fn bars(&self, count: usize, height: u64) -> Vec<Option<u64>> {
        let known = self.values.iter().copied().flatten();
        let max = known.clone().fold(f64::NEG_INFINITY, f64::max);
        let min = if self.from_zero { 0.0 } else { known.fold(f64::INFINITY, f64::min) };
        let per_bar = MAX_SAMPLES.div_ceil(count.max(1));
        let min_steps = u64::from(!self.from_zero);
        let bar = |values: &[Option<f64>]| {
            let known = values.iter().copied().flatten();
            let middle = f64::midpoint(max, min);
            let value = known.max_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()))?;
            let share = match max > min {
                true => (value - min) / (max - min),
                // The scale has no range, because all values are equal.
                false if self.from_zero && value <= 0.0 => 0.0,
                false => 0.5,
            };
            let steps = (height.saturating_sub(min_steps)) as f64;
            Some(min_steps + (share * steps).ceil().clamp(0.0, steps) as u64)
        };
        let values: Vec<_> = self.values.iter().copied().collect();
        let bars: Vec<_> = values.rchunks(per_bar).rev().map(bar).collect();
        let missing = count.saturating_sub(bars.len());
        std::iter::repeat_n(None, missing).chain(bars).collect()
    }
}

/// Formats a number with sign and one decimal. A value that rounds to zero is +0.0.
pub(crate) fn format_signed(number: f64) -> String {
    let rounded = (number * 10.0).round() / 10.0 + 0.0;
    format!("{rounded:+.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trends_of(rates_hz: impl IntoIterator<Item = f64>) -> Trends {
        let mut trends = Trends::default();
        for rate_hz in rates_hz {
            trends.push(&Figures { rate_hz: Some(rate_hz), ..Figures::default() }, None);
        }
        trends
    }

    #[test]
    fn peak_is_visible_for_any_bar_count() {
        let trends = trends_of((0..300).map(|i| if i == 250 { 1000.0 } else { 100.0 }));
        let rate = &trends.all[3];
        assert_eq!(rate.newest(), "100 Hz");
        for count in [10, 24, 60, 120] {
            let bars = rate.bars(count, 8);
            assert_eq!(bars.len(), count);
            assert_eq!(bars.iter().filter(|bar| **bar == Some(8)).count(), 1, "{count}: {bars:?}");
        }
        assert!(
            !trends_of((0..400).map(|i| if i == 250 { 1000.0 } else { 100.0 })).all[3].bars(10, 8).contains(&Some(1))
        );
    }

    #[test]
    fn unknown_value_has_no_bar_and_loss_counts_once() {
        let mut trends = Trends::default();
        for lost in [5, 5, 9, 9] {
            trends.push(&Figures { lost: Some(lost), ..Figures::default() }, None);
        }
        let [roll, .., lost] = &trends.all;
        assert_eq!((roll.newest().as_str(), roll.bars(3, 8)), ("–", vec![None; 3]));
        assert_eq!(lost.bars(120, 8)[116..], [None, Some(0), Some(8), Some(0)]);
    }
}
