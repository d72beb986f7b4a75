//! The attitudes of all stages over a trial, one over the other, thinned.
//!
//! Input: the attitudes of every chain at a tick, and the truth where there is one. Output: curves of the angles, of the errors, and, where there is no
//! truth, of how far each chain is from the first. Time: that of the samples, from the first. Failure: what is not there breaks a curve.

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
    state::Attitude,
};
use ingest::source::Truth;
use serde::Serialize;

use crate::{plot::curve::Curve, table::ErrorsDeg};

/// Bins of a curve, each of at most two points.
const BINS: u64 = 400;

/// Every chain of stages over a trial.
pub(crate) struct Overlay {
    /// The trial's name.
    pub(crate) name: String,
    /// Of the reference, where there is one.
    pub(crate) reference: Angles,
    /// Of each chain.
    pub(crate) stages: Vec<Angles>,
    /// Of each chain against the reference.
    pub(crate) errors: Vec<Deviations>,
    /// Of each chain after the first against that.
    pub(crate) differences: Vec<Deviations>,
    first_ns: Option<i64>,
}

/// Roll, pitch, yaw over time, degrees.
pub(crate) struct Angles(pub(crate) [Curve; 3]);

/// How far an attitude is from another over time, and on the whole.
pub(crate) struct Deviations {
    /// Inclination, heading, total, degrees.
    pub(crate) curves: [Curve; 3],
    accuracy: Accuracy,
}

/// How far two chains of stages are apart over a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// The trial.
    pub trial: String,
    /// The fuser of the first chain.
    pub from: String,
    /// That of the other.
    pub to: String,
    /// Root mean square.
    #[serde(flatten)]
    pub rms: ErrorsDeg,
}

impl Overlay {
    pub(crate) fn new(name: &str, rows: u64, stages: usize) -> Self {
        let curves = || std::array::from_fn(|_| Curve::in_bins(rows, BINS));
        let deviations = |count: usize| -> Vec<_> {
            (0..count).map(|_| Deviations { curves: curves(), accuracy: Accuracy::default() }).collect()
        };
        Self {
            name: name.into(),
            reference: Angles(curves()),
            stages: (0..stages).map(|_| Angles(curves())).collect(),
            errors: deviations(stages),
            differences: deviations(stages.saturating_sub(1)),
            first_ns: None,
        }
    }

    /// Takes a tick: the attitude of each chain that gave one.
    pub(crate) fn take(&mut self, t_ns: i64, truth: Option<Truth>, attitudes: &[Option<[f64; 4]>]) {
        let t_s = t_ns.saturating_sub(*self.first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        let known = truth.map(|truth| quaternion(truth.quaternion));
        let counts = truth.is_some_and(|truth| truth.scored);
        self.reference.push(t_s, known);
        let attitudes: Vec<_> = attitudes.iter().map(|attitude| attitude.map(quaternion)).collect();
        for ((angles, errors), attitude) in self.stages.iter_mut().zip(&mut self.errors).zip(&attitudes) {
            angles.push(t_s, *attitude);
            errors.push(t_s, attitude.zip(known), counts);
        }
        let Some((first, others)) = attitudes.split_first() else { return };
        for (difference, other) in self.differences.iter_mut().zip(others) {
            difference.push(t_s, other.zip(*first), true);
        }
    }

    pub(crate) fn finish(&mut self) {
        let angles = [&mut self.reference].into_iter().chain(&mut self.stages).flat_map(|angles| &mut angles.0);
        let deviations =
            self.errors.iter_mut().chain(&mut self.differences).flat_map(|deviations| &mut deviations.curves);
        angles.chain(deviations).for_each(Curve::finish);
    }

    /// The last time, s.
    pub(crate) fn end_s(&self) -> f64 {
        self.stages.iter().flat_map(|angles| &angles.0).map(Curve::end_s).fold(0.0, f64::max)
    }

    /// There was a reference that counted.
    pub(crate) fn has_reference(&self) -> bool {
        self.errors.iter().any(|errors| errors.rms().total.is_some())
    }
}

impl Angles {
    fn push(&mut self, t_s: f64, attitude: Option<Quaternion<f64>>) {
        let angles = attitude.map(|attitude| Attitude::from_quaternion(attitude).angles());
        let rad = angles.map_or([f64::NAN; 3], |angles| [angles.roll_rad, angles.pitch_rad, angles.yaw_rad]);
        self.0.iter_mut().zip(rad).for_each(|(curve, rad)| curve.push(t_s, rad.to_degrees()));
    }
}

impl Deviations {
    fn push(&mut self, t_s: f64, pair: Option<(Quaternion<f64>, Quaternion<f64>)>, counts: bool) {
        let error = pair.map(|(estimate, truth)| AttitudeError::between(estimate, truth));
        let deg = error.map_or([f64::NAN; 3], |error| [error.inclination_deg, error.heading_deg, error.total_deg]);
        self.curves.iter_mut().zip(deg).for_each(|(curve, deg)| curve.push(t_s, deg));
        if let Some(error) = error.filter(|error| counts && error.total_deg.is_finite()) {
            self.accuracy.add(error);
        }
    }

    /// Root mean square of what counts.
    pub(crate) fn rms(&self) -> ErrorsDeg {
        ErrorsDeg::of(self.accuracy.rmse())
    }
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}
