//! Direction of gravity in body axes. A body that is constantly upside down indicates wrong
//! mounting, axes or signs.

use attitude::Vector3;

use crate::diagnosis::{self, Diagnosis};

/// Maximum rate at which the orientation is checked, rad/s. At higher rates, any vehicle may be
/// upside down in a roll or a loop.
const MAX_RATE_RAD_S: f64 = 1.0;
/// Cosine of the angle between the force and the body's up axis, below which the body counts as
/// upside down. It corresponds to 120°, beyond the tilt of a body on its side.
const UPSIDE_DOWN_COSINE: f64 = -0.5;
/// Largest relative deviation of the force's magnitude from its mean for the force to count as
/// gravity. It corresponds to a turn at 25° bank.
const GRAVITY_TOLERANCE: f64 = 0.1;
/// Weight of each sample in the running mean of the force's magnitude. It gives a time constant of
/// 1 s at 100 Hz. A weight per sample is used, because it does not depend on the unit of time,
/// which may be wrong.
const SMOOTHING: f64 = 0.01;
/// Minimum observation time for a diagnosis, s. In aerobatics a vehicle is upside down for less
/// time.
const MIN_OBSERVED_S: f64 = 4.0;
/// Minimum share of the observation time for which the body must be upside down for a diagnosis. A
/// body that is turned over by hand stays below it.
const MIN_UPSIDE_DOWN_SHARE: f64 = 0.9;
/// Minimum number of magnetic field samples for the field to be used. A single sample has up to 45°
/// of noise.
const MIN_FIELDS: u64 = 10;

/// Check of the share of time for which the body is upside down.
#[derive(Debug, Clone, Default)]
pub(crate) struct OrientationCheck {
    observed_s: f64,
    upside_down_s: f64,
    /// Running mean of the force's magnitude, in the input's unit.
    mean_magnitude: Option<f64>,
    force: Vector3<f64>,
    last_up: Option<Vector3<f64>>,
    fields: u64,
    /// Sum of the cosines of the angles between force and magnetic field.
    cosine_sum: f64,
}

impl OrientationCheck {
    pub(crate) fn push(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force: [f64; 3]) {
        self.last_up = None;
        let force = Vector3::from(force);
        let magnitude = force.norm();
        let mean_magnitude = self.mean_magnitude.get_or_insert(magnitude);
        *mean_magnitude += (magnitude - *mean_magnitude) * SMOOTHING;
        let is_gravity = (magnitude - *mean_magnitude).abs() < GRAVITY_TOLERANCE * *mean_magnitude;
        if !is_gravity || !(0.0..1.0).contains(&dt_s) || Vector3::from(rate_rad_s).norm() > MAX_RATE_RAD_S {
            return;
        }
        let Some(up) = force.try_normalize(f64::MIN_POSITIVE) else { return };
        self.observed_s += dt_s;
        self.upside_down_s += if up.z < UPSIDE_DOWN_COSINE { dt_s } else { 0.0 };
        self.force += force * dt_s;
        self.last_up = Some(up);
    }

    pub(crate) fn push_field(&mut self, field_ut: [f64; 3]) {
        let Some((up, field)) = self.last_up.zip(Vector3::from(field_ut).try_normalize(1e-9)) else { return };
        self.fields += 1;
        self.cosine_sum += up.dot(&field);
    }

    pub(crate) fn diagnose(&self) -> Option<Diagnosis> {
        if self.observed_s < MIN_OBSERVED_S || self.upside_down_s < MIN_UPSIDE_DOWN_SHARE * self.observed_s {
            return None;
        }
        let mean_cosine = (self.fields >= MIN_FIELDS).then(|| self.cosine_sum / self.fields as f64);
        Some(diagnosis::upside_down((self.force / self.observed_s).into(), mean_cosine))
    }
}
