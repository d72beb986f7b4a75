//! The attitude by the gyro at any moment of a recording, from an arbitrary beginning; open loop, and so good over a second.

use attitude::{Vector3, gyro::RateKind};
use nalgebra::UnitQuaternion;

/// Readings kept: half an hour at 500 Hz. What comes later is not looked at.
const MAX_READINGS: usize = 900_000;
/// Across a longer interval nothing is known of the turn, ns.
const GAP_NS: i64 = 100_000_000;

/// What the gyro said.
#[derive(Debug, Clone)]
pub(crate) struct History {
    kind: RateKind,
    moments: Vec<Moment>,
}

#[derive(Debug, Clone, Copy)]
struct Moment {
    t_ns: i64,
    /// Mean of the interval that ends here.
    rate_rad_s: Vector3<f64>,
    /// The last reading's own.
    read_rad_s: Vector3<f64>,
    /// Body → where the body was first.
    attitude: UnitQuaternion<f64>,
    /// It follows the one before without a gap: moments of one number are connected.
    piece: u32,
}

impl History {
    pub(crate) fn new(kind: RateKind) -> Self {
        Self { kind, moments: Vec::new() }
    }

    pub(crate) fn is_full(&self) -> bool {
        self.moments.len() >= MAX_READINGS
    }

    /// The next reading.
    pub(crate) fn take(&mut self, t_ns: i64, read_rad_s: Vector3<f64>) {
        if self.is_full() {
            return;
        }
        let moment = match self.moments.last() {
            Some(last) if t_ns - last.t_ns <= GAP_NS => {
                let rate_rad_s = match self.kind {
                    RateKind::Mean => read_rad_s,
                    RateKind::Instant => 0.5 * (last.read_rad_s + read_rad_s),
                };
                let turn = UnitQuaternion::from_scaled_axis(rate_rad_s * ((t_ns - last.t_ns) as f64 * 1e-9));
                Moment { t_ns, rate_rad_s, read_rad_s, attitude: last.attitude * turn, piece: last.piece }
            }
            last => Moment {
                t_ns,
                rate_rad_s: read_rad_s,
                read_rad_s,
                attitude: UnitQuaternion::identity(),
                piece: last.map_or(0, |last| last.piece + 1),
            },
        };
        self.moments.push(moment);
    }

    /// The last rate that was read.
    pub(crate) fn rate_rad_s(&self) -> Option<Vector3<f64>> {
        self.moments.last().map(|moment| moment.read_rad_s)
    }

    /// Where the body was, and the number of the piece that the moment is in; none before the first and after the last reading, and in a gap.
    pub(crate) fn attitude(&self, t_ns: i64) -> Option<(UnitQuaternion<f64>, u32)> {
        let next = self.moments.partition_point(|moment| moment.t_ns < t_ns);
        let to = self.moments.get(next)?;
        if to.t_ns == t_ns {
            return Some((to.attitude, to.piece));
        }
        let from = self.moments.get(next.checked_sub(1)?)?;
        let since_s = (t_ns - from.t_ns) as f64 * 1e-9;
        let turn = UnitQuaternion::from_scaled_axis(to.rate_rad_s * since_s);
        (from.piece == to.piece).then(|| (from.attitude * turn, from.piece))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_attitude_between_two_readings_lies_on_the_way_and_none_spans_a_gap() {
        let mut history = History::new(RateKind::Mean);
        for i in 0..100 {
            history.take(i * 10_000_000, Vector3::new(0.0, 0.0, 1.0));
        }
        history.take(2_000_000_000, Vector3::zeros());
        let (at, piece) = history.attitude(505_000_000).unwrap();
        assert!((at.angle() - 0.505).abs() < 1e-12);
        assert_eq!(history.attitude(1_500_000_000), None);
        assert_ne!(history.attitude(2_000_000_000).unwrap().1, piece);
        assert_eq!(history.attitude(-1), None);
        assert_eq!(history.attitude(2_000_000_001), None);
    }
}
