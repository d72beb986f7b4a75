//! Rest detector. The body is at rest if gyro and accelerometer have stayed close to their own
//! means for a while.
//!
//! The gyro is checked at each sample, the accelerometer at each update. A mean rate within 2 °/s
//! of zero or of the known bias is accepted as a bias. A larger mean rate is accepted only while
//! the bias is unknown. In addition, neither the specific force nor the magnetic field may have
//! turned as it would if the body rotated at that rate.
//!
//! Failure: a steady rotation about the vertical at less than 2 °/s looks like rest. So does a
//! steady rotation about the vertical at up to 11 °/s if the bias is unknown and there is no
//! magnetometer, for example on a turntable that turns from the start. The rate is then mistaken
//! for a bias. This affects the heading, but not the tilt.

use crate::{Vector3, scalars::scalars};

/// Time constant of the means that samples are compared with, s.
const MEAN_TIME_CONSTANT_S: f64 = 0.5;
/// Largest deviation of a rate from its mean at rest, rad/s (2 °/s).
const MAX_RATE_DEVIATION_RAD_S: f64 = 0.034_906_585;
/// Largest deviation of the mean rate from zero or from the known bias, rad/s (2 °/s).
///
/// The limit applies to each component. A mean rate within the limit is accepted as a bias without
/// further conditions.
const MAX_DEVIATION_FROM_BIAS_RAD_S: f64 = 0.034_906_585;
/// Largest component of the mean rate that is accepted as a bias, rad/s (11 °/s). Data sheets of
/// consumer MEMS gyros allow a bias of 10 °/s.
const MAX_BIAS_RAD_S: f64 = 0.191_986_218;
/// Longest interval in which a large mean rate may be accepted as a bias, s. A longer interval,
/// such as one with a jump of the timestamps, does not show whether the body has rotated.
const MAX_INTERVAL_S: f64 = 0.5;
/// Largest change of force and magnetic field that is consistent with rest, as a fraction of the
/// change that a rotation at the mean rate would cause.
const MAX_CHANGE_FRACTION: f64 = 0.5;
/// Minimum change of the magnetic field by which a real rotation is recognised, µT.
///
/// The threshold is several times the noise of a magnetometer.
const MIN_FIELD_CHANGE_UT: f64 = 2.0;
/// Time without movement after which a large mean rate is accepted as a bias in any case, s.
///
/// Before this time, the mean rate is not accepted while a real rotation would change the measured
/// magnetic field by less than [`MIN_FIELD_CHANGE_UT`].
const MAX_UNDECIDED_S: f64 = 3.0;
/// Largest deviation of a force from its mean at rest, m/s².
const MAX_FORCE_DEVIATION_M_S2: f64 = 0.5;
/// Change of the mean force that is attributed to noise, m/s².
const MIN_FORCE_CHANGE_M_S2: f64 = 0.2;
/// Largest plausible component of the magnetic field, µT. A larger field counts as missing.
const MAX_FIELD_UT: f64 = 1e3;
/// Largest plausible rate, rad/s. A larger mean rate resets the detector.
const MAX_RATE_RAD_S: f64 = 1e6;
/// Time without movement after which rest is detected, s.
const MIN_QUIET_S: f64 = 1.5;
/// Longest time over which the rate at rest is averaged, s.
const BIAS_MEMORY_S: f64 = 20.0;

/// Largest speed reported by a receiver at which the body may still be at rest, m/s.
pub(super) const MAX_SPEED_AT_REST_M_S: f64 = 0.7;
/// Standard deviation of a bias measured at rest, rad/s.
pub(super) const BIAS_SD_AT_REST_RAD_S: f64 = 8e-4;

/// Input of an update of the rest detector.
#[derive(Debug, Clone, Copy)]
pub(super) struct RestInput {
    /// Last specific force in body axes, m/s².
    pub(super) force_m_s2: Vector3<f64>,
    /// Gyro bias, rad/s, if it is known from a rest or a hand-over.
    pub(super) known_bias_rad_s: Option<Vector3<f64>>,
    /// Time since the last update, s.
    pub(super) interval_s: f64,
}

/// Rest detector, which also averages the rate at rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RestDetector {
    rate_mean_rad_s: Vector3<f64>,
    force_mean_m_s2: Vector3<f64>,
    /// Last magnetic field since the last update, µT; zero if there was none.
    last_field_ut: Vector3<f64>,
    /// Mean magnetic field, µT; zero before the first sample.
    field_mean_ut: Vector3<f64>,
    /// Mean force and magnetic field at the start of the quiet time.
    initial_force_m_s2: Vector3<f64>,
    initial_field_ut: Vector3<f64>,
    /// Integral of the rate since the last update, rad.
    rotation_rad: Vector3<f64>,
    moved: bool,
    /// Set once the means contain a sample.
    is_started: bool,
    /// Set while it is not decided whether the mean rate is a bias.
    is_undecided: bool,
    quiet_s: f64,
    bias_rad_s: Vector3<f64>,
}

impl Default for RestDetector {
    fn default() -> Self {
        let zero = Vector3::zeros();
        Self {
            rate_mean_rad_s: zero,
            force_mean_m_s2: zero,
            last_field_ut: zero,
            field_mean_ut: zero,
            initial_force_m_s2: zero,
            initial_field_ut: zero,
            rotation_rad: zero,
            moved: true,
            is_started: false,
            is_undecided: false,
            quiet_s: 0.0,
            bias_rad_s: zero,
        }
    }
}

impl RestDetector {
    /// Processes one gyro sample and, if present, a magnetic field sample in body axes, µT.
    #[inline]
    pub(super) fn observe(&mut self, rate_rad_s: Vector3<f64>, field_ut: Option<Vector3<f64>>, dt_s: f64) {
        if let Some(field_ut) = field_ut {
            self.last_field_ut = field_ut;
        }
        let deviation_rad_s = rate_rad_s - self.rate_mean_rad_s;
        self.rotation_rad += rate_rad_s * dt_s;
        self.moved |= deviation_rad_s.norm_squared() >= MAX_RATE_DEVIATION_RAD_S * MAX_RATE_DEVIATION_RAD_S;
    }

    /// Evaluates the samples of the last interval.
    pub(super) fn update(&mut self, input: &RestInput) {
        let RestInput { force_m_s2, known_bias_rad_s, interval_s } = *input;
        let rate_rad_s = core::mem::take(&mut self.rotation_rad) / interval_s;
        if !self.is_started {
            *self =
                Self { rate_mean_rad_s: rate_rad_s, force_mean_m_s2: force_m_s2, is_started: true, ..Self::default() };
        }
        let deviation_m_s2 = force_m_s2 - self.force_mean_m_s2;
        self.moved |= deviation_m_s2.norm_squared() >= MAX_FORCE_DEVIATION_M_S2 * MAX_FORCE_DEVIATION_M_S2;
        if !(0.0..MAX_RATE_RAD_S * MAX_RATE_RAD_S).contains(&rate_rad_s.norm_squared()) {
            *self = Self::default();
            return;
        }
        let gain = (interval_s * (1.0 / MEAN_TIME_CONSTANT_S)).min(1.0);
        self.rate_mean_rad_s += (rate_rad_s - self.rate_mean_rad_s) * gain;
        self.force_mean_m_s2 += deviation_m_s2 * gain;
        self.average_field(gain);
        let is_near =
            |bias_rad_s: Vector3<f64>| (self.rate_mean_rad_s - bias_rad_s).amax() < MAX_DEVIATION_FROM_BIAS_RAD_S;
        let is_small = is_near(Vector3::zeros()) || known_bias_rad_s.is_some_and(is_near);
        let may_be_large = known_bias_rad_s.is_none() && interval_s < MAX_INTERVAL_S;
        let is_credible = is_small || may_be_large && self.rate_mean_rad_s.amax() < MAX_BIAS_RAD_S;
        if core::mem::take(&mut self.moved) || !is_credible {
            self.quiet_s = 0.0;
            return;
        }
        if self.quiet_s == 0.0 {
            (self.initial_force_m_s2, self.initial_field_ut) = (self.force_mean_m_s2, self.field_mean_ut);
        }
        if !is_small && self.has_turned() {
            self.quiet_s = 0.0;
            return;
        }
        self.quiet_s += interval_s;
        let field_change_ut = self.rate_mean_rad_s.cross(&self.initial_field_ut).norm() * self.quiet_s;
        self.is_undecided = !is_small
            && self.quiet_s < MAX_UNDECIDED_S
            && self.initial_field_ut != Vector3::zeros()
            && field_change_ut < MIN_FIELD_CHANGE_UT;
        self.bias_rad_s += (rate_rad_s - self.bias_rad_s) * (interval_s / self.quiet_s.min(BIAS_MEMORY_S)).min(1.0);
    }

    /// Averages the magnetic field. Without a sample since the last update, the mean stays
    /// unchanged.
    fn average_field(&mut self, gain: f64) {
        let field_ut = core::mem::take(&mut self.last_field_ut);
        if field_ut == Vector3::zeros() || field_ut.amax() > MAX_FIELD_UT {
            return;
        }
        let gain = if self.field_mean_ut == Vector3::zeros() { 1.0 } else { gain };
        self.field_mean_ut += (field_ut - self.field_mean_ut) * gain;
    }

    /// Returns `true` if the body appears to have rotated at the mean rate since the start of the
    /// quiet time.
    ///
    /// The evidence is the change of the mean force or of the mean magnetic field.
    fn has_turned(&self) -> bool {
        let rotation_rad = self.rate_mean_rad_s * self.quiet_s;
        let has_turned = |initial: Vector3<f64>, mean: Vector3<f64>, noise: f64| {
            let limit = (MAX_CHANGE_FRACTION * rotation_rad.cross(&initial).norm()).max(noise);
            (mean - initial).norm_squared() > limit * limit
        };
        let field_noise_ut = MAX_CHANGE_FRACTION * MIN_FIELD_CHANGE_UT;
        has_turned(self.initial_force_m_s2, self.force_mean_m_s2, MIN_FORCE_CHANGE_M_S2)
            || self.initial_field_ut != Vector3::zeros()
                && has_turned(self.initial_field_ut, self.field_mean_ut, field_noise_ut)
    }

    /// Restarts the quiet time, because the sensors are not credible.
    #[inline]
    pub(super) fn interrupt(&mut self) {
        self.moved = true;
        self.quiet_s = 0.0;
    }

    /// Returns `true` if the body has been quiet long enough.
    #[inline]
    pub(super) fn is_detected(&self) -> bool {
        self.quiet_s >= MIN_QUIET_S && !self.is_undecided
    }

    /// Returns the mean rate at rest, or `None` while no rest is detected.
    pub(super) fn bias_rad_s(&self) -> Option<Vector3<f64>> {
        self.is_detected().then_some(self.bias_rad_s)
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.quiet_s < 0.0).then_some("a time of rest below zero")
    }
}

scalars!(RestDetector:
    rate_mean_rad_s, force_mean_m_s2, last_field_ut, field_mean_ut, initial_force_m_s2, initial_field_ut, rotation_rad, moved,
    is_started, is_undecided, quiet_s, bias_rad_s
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GRAVITY_M_S2;

    const DT_S: f64 = 0.01;
    const FIELD_UT: [f64; 3] = [4.0, 18.0, -42.0];

    /// Returns the time (s) at which rest is first detected, or `None` if it is not detected within
    /// 20 s.
    ///
    /// The body rotates at `rate_rad_s`, and the gyro reads `bias_rad_s` too much.
    fn detected_s(rate_rad_s: Vector3<f64>, bias_rad_s: Vector3<f64>, with_field: bool) -> Option<f64> {
        let mut detector = RestDetector::default();
        (1..2000).map(|tick| f64::from(tick) * DT_S).find(|t_s| {
            let rotation = nalgebra::Rotation3::new(rate_rad_s * -*t_s);
            let field_ut = with_field.then(|| rotation * Vector3::from(FIELD_UT));
            detector.observe(rate_rad_s + bias_rad_s, field_ut, DT_S);
            if ((t_s / DT_S).round() as u32).is_multiple_of(20) {
                let force_m_s2 = rotation * Vector3::z() * GRAVITY_M_S2;
                detector.update(&RestInput { force_m_s2, known_bias_rad_s: None, interval_s: 0.2 });
            }
            detector.is_detected()
        })
    }

    fn deg_s(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z).map(f64::to_radians)
    }

    #[test]
    fn bias_of_10_deg_s_is_found_within_2_s() {
        for bias_rad_s in [deg_s(10.0, 10.0, -10.0), deg_s(0.0, 0.0, 10.0), deg_s(-10.0, 0.0, 0.0)] {
            for with_field in [true, false] {
                let detected_s = detected_s(Vector3::zeros(), bias_rad_s, with_field);
                assert!(detected_s.is_some_and(|t_s| t_s <= 2.0), "{bias_rad_s}, field {with_field}: {detected_s:?}");
            }
        }
    }

    #[test]
    fn large_rate_over_long_intervals_is_no_bias() {
        let mut detector = RestDetector::default();
        for _ in 0..10 {
            detector.observe(deg_s(5.0, 0.0, 5.0), None, 10.0);
            let force_m_s2 = Vector3::z() * GRAVITY_M_S2;
            detector.update(&RestInput { force_m_s2, known_bias_rad_s: None, interval_s: 10.0 });
            assert!(!detector.is_detected());
        }
    }

    #[test]
    fn rotation_that_force_or_field_shows_is_no_bias() {
        let still = Vector3::zeros();
        for rate_rad_s in [deg_s(0.0, 0.0, 3.0), deg_s(0.0, 0.0, 10.0), deg_s(3.0, 0.0, 0.0), deg_s(4.0, -4.0, 5.0)] {
            assert_eq!(detected_s(rate_rad_s, still, true), None, "{rate_rad_s}");
        }
        assert_eq!(detected_s(deg_s(4.0, 0.0, 0.0), still, false), None);
        // Without a magnetometer, a rotation about the vertical looks like a bias.
        assert!(detected_s(deg_s(0.0, 0.0, 5.0), still, false).is_some());
    }
}
