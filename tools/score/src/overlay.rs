//! Decimated attitude curves of all chains over a trial, for common charts.
//!
//! Input: the attitude of every chain at a tick, and the reference if present.
//!
//! Output: curves of the angles and errors. If there is no reference, curves of the difference
//! between each chain and the first one.
//!
//! Time: sample timestamps, relative to that of the first sample.
//!
//! Failure: a missing value interrupts a curve.

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
    state::Attitude,
};
use foreign::ForeignText;
use readings::source::Truth;

use crate::{plot::curve::Curve, table::ErrorsDeg};

/// Number of bins in a curve. Each bin yields at most two points.
const BINS: u64 = 400;

/// Curves of all chains over a trial.
pub(crate) struct Overlay {
    /// Name of the trial.
    pub(crate) name: ForeignText,
    /// Angles of the reference; empty without a reference.
    pub(crate) reference: AngleCurves,
    /// Angles of each chain.
    pub(crate) stages: Vec<AngleCurves>,
    /// Error of each chain against the reference.
    pub(crate) errors: Vec<ErrorCurves>,
    /// Difference between the first chain and each of the others.
    pub(crate) differences: Vec<ErrorCurves>,
    first_ns: Option<i64>,
}

/// Roll, pitch and yaw over time, degrees.
pub(crate) struct AngleCurves(pub(crate) [Curve; 3]);

/// Angle between two attitudes over time, with its root mean square.
pub(crate) struct ErrorCurves {
    /// Inclination, heading and total, degrees.
    pub(crate) curves: [Curve; 3],
    accuracy: Accuracy,
}

impl Overlay {
    pub(crate) fn new(name: &ForeignText, rows: u64, stages: usize) -> Self {
        let curves = || std::array::from_fn(|_| Curve::with_bins(rows, BINS));
        let error_curves = |count: usize| -> Vec<_> {
            (0..count).map(|_| ErrorCurves { curves: curves(), accuracy: Accuracy::default() }).collect()
        };
        Self {
            name: name.clone(),
            reference: AngleCurves(curves()),
            stages: (0..stages).map(|_| AngleCurves(curves())).collect(),
            errors: error_curves(stages),
            differences: error_curves(stages.saturating_sub(1)),
            first_ns: None,
        }
    }

    /// Adds one tick: the reference, if known, and the attitude of each chain that has one.
    pub(crate) fn push(&mut self, t_ns: i64, truth: Option<Truth>, attitudes: &[Option<Quaternion<f64>>]) {
        let t_s = t_ns.saturating_sub(*self.first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        let reference = truth.map(|truth| quaternion(truth.quaternion));
        let is_scored = truth.is_some_and(|truth| truth.scored);
        self.reference.push(t_s, reference);
        for ((angles, errors), attitude) in self.stages.iter_mut().zip(&mut self.errors).zip(attitudes) {
            angles.push(t_s, *attitude);
            errors.push(t_s, attitude.zip(reference), is_scored);
        }
        let Some((first, others)) = attitudes.split_first() else { return };
        for (difference, other) in self.differences.iter_mut().zip(others) {
            difference.push(t_s, other.zip(*first), true);
        }
    }

    pub(crate) fn finish(&mut self) {
        let angles = [&mut self.reference].into_iter().chain(&mut self.stages).flat_map(|angles| &mut angles.0);
        let errors = self.errors.iter_mut().chain(&mut self.differences).flat_map(|errors| &mut errors.curves);
        angles.chain(errors).for_each(Curve::finish);
    }

    /// Returns the time of the last point, s.
    pub(crate) fn end_s(&self) -> f64 {
        self.stages.iter().flat_map(|angles| &angles.0).map(Curve::end_s).fold(0.0, f64::max)
    }

    /// Returns `true` if any sample was scored against a reference.
    pub(crate) fn has_reference(&self) -> bool {
        self.errors.iter().any(|errors| errors.rms().total.is_some())
    }
}

impl AngleCurves {
    fn push(&mut self, t_s: f64, attitude: Option<Quaternion<f64>>) {
        let angles = attitude.map(|attitude| Attitude::from_quaternion(attitude).angles());
        let rad = angles.map_or([f64::NAN; 3], |angles| [angles.roll_rad, angles.pitch_rad, angles.yaw_rad]);
        self.0.iter_mut().zip(rad).for_each(|(curve, rad)| curve.push(t_s, rad.to_degrees()));
    }
}

impl ErrorCurves {
    fn push(&mut self, t_s: f64, pair: Option<(Quaternion<f64>, Quaternion<f64>)>, is_scored: bool) {
        let error = pair.map(|(estimate, truth)| AttitudeError::between(estimate, truth));
        let deg = error.map_or([f64::NAN; 3], |error| [error.inclination_deg, error.heading_deg, error.total_deg]);
        self.curves.iter_mut().zip(deg).for_each(|(curve, deg)| curve.push(t_s, deg));
        if let Some(error) = error.filter(|error| is_scored && error.total_deg.is_finite()) {
            self.accuracy.add(error);
        }
    }

    /// Returns the root mean square over the scored samples.
    pub(crate) fn rms(&self) -> ErrorsDeg {
        ErrorsDeg::from_error(self.accuracy.rmse())
    }
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}
