//! Attitude at any time of a recording, integrated from the gyro and relative to the start of a
//! gap-free segment.
//!
//! The integration is open loop, so only differences over up to about a second are accurate.

use attitude::{Vector3, gyro::RateKind};
use nalgebra::UnitQuaternion;

/// Maximum number of readings kept: half an hour at 500 Hz. Later readings are ignored.
const MAX_READINGS: usize = 900_000;
/// Longest interval that is integrated, ns. After a longer interval, a new segment starts.
const MAX_GAP_NS: i64 = 100_000_000;

/// Integrated gyro readings.
#[derive(Debug, Clone)]
pub(crate) struct AttitudeHistory {
    kind: RateKind,
    entries: Vec<Entry>,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    t_ns: i64,
    /// Mean rate over the interval that ends at `t_ns`.
    rate_rad_s: Vector3<f64>,
    /// Unmodified rate reading at `t_ns`.
    raw_rad_s: Vector3<f64>,
    /// Rotation from body axes at `t_ns` to body axes at the start of the segment.
    attitude: UnitQuaternion<f64>,
    /// Index of the gap-free segment. Attitudes in different segments are not comparable.
    segment: u32,
}

impl AttitudeHistory {
    pub(crate) fn new(kind: RateKind) -> Self {
        Self { kind, entries: Vec::new() }
    }

    pub(crate) fn is_full(&self) -> bool {
        self.entries.len() >= MAX_READINGS
    }

    pub(crate) fn push(&mut self, t_ns: i64, raw_rad_s: Vector3<f64>) {
        if self.is_full() {
            return;
        }
        let entry = match self.entries.last() {
            Some(last) if t_ns - last.t_ns <= MAX_GAP_NS => {
                let rate_rad_s = match self.kind {
                    RateKind::Mean => raw_rad_s,
                    RateKind::Instant => 0.5 * (last.raw_rad_s + raw_rad_s),
                };
                let rotation = UnitQuaternion::from_scaled_axis(rate_rad_s * ((t_ns - last.t_ns) as f64 * 1e-9));
                Entry { t_ns, rate_rad_s, raw_rad_s, attitude: last.attitude * rotation, segment: last.segment }
            }
            last => Entry {
                t_ns,
                rate_rad_s: raw_rad_s,
                raw_rad_s,
                attitude: UnitQuaternion::identity(),
                segment: last.map_or(0, |last| last.segment + 1),
            },
        };
        self.entries.push(entry);
    }

    pub(crate) fn last_rate_rad_s(&self) -> Option<Vector3<f64>> {
        self.entries.last().map(|entry| entry.raw_rad_s)
    }

    /// Returns the attitude at `t_ns` and the index of its segment.
    ///
    /// The result is `None` before the first reading, after the last one and within a gap.
    pub(crate) fn attitude(&self, t_ns: i64) -> Option<(UnitQuaternion<f64>, u32)> {
        let next = self.entries.partition_point(|entry| entry.t_ns < t_ns);
        let to = self.entries.get(next)?;
        if to.t_ns == t_ns {
            return Some((to.attitude, to.segment));
        }
        let from = self.entries.get(next.checked_sub(1)?)?;
        let since_s = (t_ns - from.t_ns) as f64 * 1e-9;
        let rotation = UnitQuaternion::from_scaled_axis(to.rate_rad_s * since_s);
        (from.segment == to.segment).then(|| (from.attitude * rotation, from.segment))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attitude_interpolates_and_is_none_across_gaps() {
        let mut history = AttitudeHistory::new(RateKind::Mean);
        for i in 0..100 {
            history.push(i * 10_000_000, Vector3::new(0.0, 0.0, 1.0));
        }
        history.push(2_000_000_000, Vector3::zeros());
        let (attitude, segment) = history.attitude(505_000_000).unwrap();
        assert!((attitude.angle() - 0.505).abs() < 1e-12);
        assert_eq!(history.attitude(1_500_000_000), None);
        assert_ne!(history.attitude(2_000_000_000).unwrap().1, segment);
        assert_eq!(history.attitude(-1), None);
        assert_eq!(history.attitude(2_000_000_001), None);
    }
}
