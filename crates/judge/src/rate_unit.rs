//! Check of the unit of the rates, based on rotation that the gyro reports but gravity does not
//! show.
//!
//! A rotation about an axis perpendicular to the force rotates the force in body axes by the same
//! angle. If the gyro reports a fast rotation while the force keeps its direction, the rates are
//! far too large. This detects a wrong unit even when the motion does not reveal the axes. The
//! force is averaged over a step, so that vibration does not look like rotation.

use attitude::Vector3;

use crate::{
    axes_vs_gravity::MAX_SAMPLE_INTERVAL_S,
    diagnosis::{self, Diagnosis},
};

/// Length of a window, s. A body swung by hand does not return to its initial orientation within
/// this time.
const WINDOW_S: f64 = 0.5;
/// Length of a step, s. It is long enough for motor and propeller vibration to average out, and
/// short enough that the body rotates only a little.
const STEP_S: f64 = 0.05;
/// Minimum rotation perpendicular to the force, rad. Windows with less rotation are ignored. No
/// vehicle or hand-held body repeatedly rotates this far in one window.
const MIN_ROTATION_RAD: f64 = 1.0;
/// Largest ratio of the force's rotation to the gyro's that counts as a mismatch. If the rates are
/// in °/s instead of rad/s, the ratio is 1/57, plus the effect of accelerations.
const MAX_FORCE_SHARE: f64 = 0.1;
/// Minimum number of mismatches for a diagnosis. A few mismatches occur even with the right unit:
/// if a body swings back within a window, the force appears to rotate less than the body did.
const MIN_MISMATCHES: u32 = 5;
/// Minimum share of mismatches among the windows with at least [`MIN_ROTATION_RAD`]. With a wrong
/// unit nearly all of these windows mismatch. With the right unit only a few do.
const MIN_MISMATCH_SHARE: f64 = 0.8;

/// Comparison of the rotation measured by the gyro with the rotation of the force.
#[derive(Debug, Clone, Default)]
pub(crate) struct RateUnitCheck {
    dt_s: f64,
    step_s: f64,
    /// Rotation vector summed over the current step, rad.
    rotation_rad: Vector3<f64>,
    /// Sum of the force over the current step.
    force: Vector3<f64>,
    /// Direction of the force at the start of the window.
    start_up: Option<Vector3<f64>>,
    gyro_rad: f64,
    /// Largest angle between the force and its direction at the start of the window.
    force_rad: f64,
    windows: u32,
    mismatches: u32,
}

impl RateUnitCheck {
    /// Discards the current window after a discontinuity.
    pub(crate) fn interrupt(&mut self) {
        *self = Self { windows: self.windows, mismatches: self.mismatches, ..Self::default() };
    }

    pub(crate) fn push(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) {
        if !(0.0..MAX_SAMPLE_INTERVAL_S).contains(&dt_s) {
            return self.interrupt();
        }
        self.step_s += dt_s;
        self.rotation_rad += Vector3::from(rate_rad_s) * dt_s;
        self.force += Vector3::from(force_m_s2);
        if self.step_s < STEP_S {
            return;
        }
        let Some(up) = self.force.try_normalize(f64::MIN_POSITIVE) else { return self.interrupt() };
        let start_up = *self.start_up.get_or_insert(up);
        self.dt_s += self.step_s;
        self.gyro_rad += (self.rotation_rad - up * self.rotation_rad.dot(&up)).norm();
        self.force_rad = self.force_rad.max(start_up.cross(&up).norm().atan2(start_up.dot(&up)));
        (self.step_s, self.rotation_rad, self.force) = (0.0, Vector3::zeros(), Vector3::zeros());
        if self.dt_s < WINDOW_S {
            return;
        }
        if self.gyro_rad > MIN_ROTATION_RAD {
            self.windows += 1;
            self.mismatches += u32::from(self.force_rad < MAX_FORCE_SHARE * self.gyro_rad);
        }
        self.interrupt();
    }

    pub(crate) fn diagnose(&self) -> Option<Diagnosis> {
        let is_wrong = self.mismatches >= MIN_MISMATCHES
            && f64::from(self.mismatches) > MIN_MISMATCH_SHARE * f64::from(self.windows);
        is_wrong.then(|| diagnosis::unobserved_rotation(self.mismatches, WINDOW_S))
    }
}
