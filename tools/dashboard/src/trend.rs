//! The last minute of a value.

use std::{collections::VecDeque, time::Duration};

use crate::{Attitude, Facts, drawing::signed};

/// Between two values of a trend.
pub const STEP: Duration = Duration::from_millis(500);
/// Values kept: the last minute.
const MAX_VALUES: usize = 120;

/// The last minute of a value.
#[derive(Debug, Clone, PartialEq)]
pub struct Trend {
    /// What it is.
    pub name: &'static str,
    /// In which unit.
    pub unit: &'static str,
    /// It is counted from 0: the smallest is drawn as nothing.
    from_zero: bool,
    values: VecDeque<Option<f64>>,
}

/// What is followed of a system.
#[derive(Debug, Clone, PartialEq)]
pub struct Trends {
    lost: Option<u64>,
    /// Roll, pitch, yaw, rate, latency, losses.
    pub each: [Trend; 6],
}

impl Default for Trends {
    fn default() -> Self {
        let trend = |name, unit, from_zero| Trend { name, unit, from_zero, values: VecDeque::new() };
        Self {
            lost: None,
            each: [
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
    /// What is known now, once each [`STEP`].
    pub fn step(&mut self, facts: &Facts, attitude: Option<&Attitude>) {
        let lost = facts.lost.zip(self.lost).map(|(now, before)| now.saturating_sub(before) as f64);
        self.lost = facts.lost;
        let angles = attitude.map_or([None; 3], |attitude| attitude.roll_pitch_yaw_deg.map(Some));
        let others = [facts.rate_hz, facts.latency_us.map(|[_, p99]| p99), lost];
        for (trend, value) in self.each.iter_mut().zip(angles.into_iter().chain(others)) {
            trend.push(value);
        }
    }
}

impl Trend {
    fn push(&mut self, value: Option<f64>) {
        if self.values.len() == MAX_VALUES {
            self.values.pop_front();
        }
        self.values.push_back(value.filter(|value| value.is_finite()));
    }

    /// The newest with its unit.
    pub fn newest(&self) -> String {
        let value = self.values.back().copied().flatten();
        value.map_or("–".into(), |value| match (self.from_zero, self.unit) {
            (false, unit) => format!("{}{unit}", signed(value)),
            (true, "") => format!("{value:.0}"),
            (true, unit) => format!("{value:.0} {unit}"),
        })
    }

    /// The last minute as so many bars of a height from 1 to `height`, 0 where it is counted from 0 and is none; the newest last. Of values that share
    /// a bar the one farthest from the newest before it is drawn, so that no peak is left out; `None` where nothing was known.
    pub fn bars(&self, count: usize, height: u64) -> Vec<Option<u64>> {
        let known = self.values.iter().copied().flatten();
        let most = known.clone().fold(f64::NEG_INFINITY, f64::max);
        let least = if self.from_zero { 0.0 } else { known.fold(f64::INFINITY, f64::min) };
        let per_bar = MAX_VALUES.div_ceil(count.max(1));
        let lowest = u64::from(!self.from_zero);
        let bar = |values: &[Option<f64>]| {
            let known = values.iter().copied().flatten();
            let middle = f64::midpoint(most, least);
            let value = known.max_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()))?;
            let share = match most > least {
                true => (value - least) / (most - least),
                // It has not changed.
                false if self.from_zero && value <= 0.0 => 0.0,
                false => 0.5,
            };
            let steps = (height.saturating_sub(lowest)) as f64;
            Some(lowest + (share * steps).ceil().clamp(0.0, steps) as u64)
        };
        let values: Vec<_> = self.values.iter().copied().collect();
        let bars: Vec<_> = values.rchunks(per_bar).rev().map(bar).collect();
        let missing = count.saturating_sub(bars.len());
        std::iter::repeat_n(None, missing).chain(bars).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trends_of(rates_hz: impl IntoIterator<Item = f64>) -> Trends {
        let mut trends = Trends::default();
        for rate_hz in rates_hz {
            trends.step(&Facts { rate_hz: Some(rate_hz), ..Facts::default() }, None);
        }
        trends
    }

    #[test]
    fn a_minute_is_kept_and_a_peak_is_seen_however_few_bars_there_are() {
        let trends = trends_of((0..300).map(|i| if i == 250 { 1000.0 } else { 100.0 }));
        let rate = &trends.each[3];
        assert_eq!(rate.newest(), "100 Hz");
        for count in [10, 24, 60, 120] {
            let bars = rate.bars(count, 8);
            assert_eq!(bars.len(), count);
            assert_eq!(bars.iter().filter(|bar| **bar == Some(8)).count(), 1, "{count}: {bars:?}");
        }
        assert!(
            !trends_of((0..400).map(|i| if i == 250 { 1000.0 } else { 100.0 })).each[3].bars(10, 8).contains(&Some(1))
        );
    }

    #[test]
    fn what_is_unknown_is_no_bar_and_a_loss_counts_once() {
        let mut trends = Trends::default();
        for lost in [5, 5, 9, 9] {
            trends.step(&Facts { lost: Some(lost), ..Facts::default() }, None);
        }
        let [roll, .., lost] = &trends.each;
        assert_eq!((roll.newest().as_str(), roll.bars(3, 8)), ("–", vec![None; 3]));
        assert_eq!(lost.bars(120, 8)[116..], [None, Some(0), Some(8), Some(0)]);
    }
}
