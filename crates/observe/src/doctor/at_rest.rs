//! Checks of the sensors at rest. They compare the specific force f with gravity, and the gyro rate
//! with zero.
//!
//! - Input: a few seconds of samples.
//! - Output: two checks.
//! - Failure: while the body moves, both checks are reported as skipped.

use attitude::GRAVITY_M_S2;
use launch::pluralize;
use messages::ImuSample;
use runtime::ServiceConfig;

use super::{
    Check,
    remedy::{Remedy, SensorCalibration},
};

/// Maximum standard deviation at rest of |f|, the magnitude of the specific force, in m/s². It
/// allows for vibration and the noise of common sensors.
const MAX_FORCE_SD_M_S2: f64 = 0.3;
/// Maximum change of the specific force at rest during the observation, as a share of its
/// magnitude. It corresponds to a tilt of 0.9°.
const MAX_FORCE_DRIFT: f64 = 0.015;
/// Maximum standard deviation of each rate at rest, rad/s (1 °/s).
const MAX_RATE_SD_RAD_S: f64 = 0.0175;
/// Maximum mean rate at rest, rad/s (20 °/s). A larger rate indicates a steady turn or an unusable
/// gyro.
const MAX_REST_RATE_RAD_S: f64 = 0.35;
/// Gyro bias in rad/s above which a warning is reported (2 °/s). Typical sensors have a smaller
/// bias.
const MAX_BIAS_RAD_S: f64 = 0.035;
/// Minimum number of samples for a check.
const MIN_SAMPLES: f64 = 50.0;

/// Statistics of the magnitude of the specific force, and of the rate and the specific force along
/// each axis.
#[derive(Debug, Clone, Copy, Default)]
pub struct RestCheck {
    count: f64,
    norm_m_s2: RunningSums,
    rate_rad_s: [RunningSums; 3],
    force_m_s2: [RunningSums; 3],
}

/// Sums of a quantity, of its square, and of its product with the sample index.
#[derive(Debug, Clone, Copy, Default)]
struct RunningSums {
    sum: f64,
    squares: f64,
    index_products: f64,
}

impl RunningSums {
    fn push(&mut self, index: f64, value: f64) {
        self.sum += value;
        self.squares += value * value;
        self.index_products += index * value;
    }

    fn mean(&self, count: f64) -> f64 {
        self.sum / count
    }

    fn sd(&self, count: f64) -> f64 {
        (self.squares / count - self.mean(count).powi(2)).max(0.0).sqrt()
    }

    /// Returns the change from the first to the last of `count` samples, computed as the
    /// least-squares slope times `count`.
    fn drift(&self, count: f64) -> f64 {
        12.0 * (self.index_products - self.sum * (count - 1.0) / 2.0) / (count * count - 1.0)
    }
}

impl RestCheck {
    /// Adds a sample.
    pub fn push(&mut self, sample: &ImuSample) {
        let norm_m_s2 = norm(sample.force_m_s2);
        self.norm_m_s2.push(self.count, norm_m_s2);
        for (sums, value) in self.rate_rad_s.iter_mut().zip(sample.rate_rad_s) {
            sums.push(self.count, value);
        }
        for (sums, value) in self.force_m_s2.iter_mut().zip(sample.force_m_s2) {
            sums.push(self.count, value);
        }
        self.count += 1.0;
    }

    /// Returns the checks `gravity` and `gyro-at-rest` of a system with this configuration.
    pub fn checks(&self, config: &ServiceConfig) -> [Check; 2] {
        let count = self.count;
        if count < MIN_SAMPLES {
            return skipped(format!("{}: too few", pluralize(count as u64, "sample")));
        }
        let (norm_m_s2, norm_sd_m_s2) = (self.norm_m_s2.mean(count), self.norm_m_s2.sd(count));
        let rate_rad_s = norm(self.rate_rad_s.map(|rate| rate.mean(count)));
        let drift = norm(self.force_m_s2.map(|force| force.drift(count))) / norm_m_s2;
        let is_moving = self.rate_rad_s.iter().any(|rate| rate.sd(count) > MAX_RATE_SD_RAD_S)
            || norm_sd_m_s2 > MAX_FORCE_SD_M_S2
            || rate_rad_s > MAX_REST_RATE_RAD_S
            || drift > MAX_FORCE_DRIFT;
        if is_moving {
            let rate_deg_s = rate_rad_s.to_degrees();
            return skipped(format!(
                "the body moves (mean |f| {norm_m_s2:.2} m/s² ± {norm_sd_m_s2:.2}, mean rate {rate_deg_s:.1} °/s)"
            ));
        }
        let calibration = |sensor, action| SensorCalibration {
            sensor,
            action,
            system: config.launch.name.clone(),
            launch_file: config.launch_file.clone(),
        };
        [gravity_check(norm_m_s2, &calibration), gyro_check(rate_rad_s, &calibration)]
    }
}

fn skipped(reason: String) -> [Check; 2] {
    ["gravity", "gyro-at-rest"].map(|check| Check::ok(check, format!("skipped: {reason}")))
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Creates a calibration from the name of a sensor and the action.
type NewCalibration<'a> = dyn Fn(&'static str, &'static str) -> SensorCalibration + 'a;

fn gravity_check(norm_m_s2: f64, calibration: &NewCalibration<'_>) -> Check {
    let check = "gravity";
    let ratio = norm_m_s2 / GRAVITY_M_S2;
    let found = format!("mean |f| {norm_m_s2:.3} m/s², {:+.1} % of g, at rest", 100.0 * (ratio - 1.0));
    let remedy = Remedy::Calibrate(calibration("accel", "while you rest it on each of its six sides"));
    if (0.95 / GRAVITY_M_S2..1.05 / GRAVITY_M_S2).contains(&ratio) {
        Check::problem(check, found, Remedy::ConvertFromG)
    } else if !(0.9..1.1).contains(&ratio) {
        Check::problem(check, found, remedy)
    } else if !(0.98..1.02).contains(&ratio) {
        Check::warning(check, found, remedy)
    } else {
        Check::ok(check, found)
    }
}

fn gyro_check(rate_rad_s: f64, calibration: &NewCalibration<'_>) -> Check {
    let (check, found) = ("gyro-at-rest", format!("mean rate {:.3} °/s at rest", rate_rad_s.to_degrees()));
    if rate_rad_s > MAX_BIAS_RAD_S {
        Check::warning(check, found, Remedy::Calibrate(calibration("gyro", "while it is at rest")))
    } else {
        Check::ok(check, found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Severity;
    use launch::Launch;
    use runtime::Pace;

    fn checks_of(still: &RestCheck) -> [Check; 2] {
        still.checks(&ServiceConfig::standalone(Launch::default(), 1000.0, Pace::Max))
    }

    fn checks(force: f64, force_noise: f64, rate_rad_s: f64, rate_swing_rad_s: f64) -> [Check; 2] {
        let mut still = RestCheck::default();
        for i in 0..2000 {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
            sample.force_m_s2[2] = force + sign * force_noise;
            sample.rate_rad_s[0] = rate_rad_s + sign * rate_swing_rad_s;
            still.push(&sample);
        }
        checks_of(&still)
    }

    fn severities(force: f64, rate_rad_s: f64) -> [Severity; 2] {
        checks(force, 0.1, rate_rad_s, 1e-3).map(|check| check.result)
    }

    #[test]
    fn good_sensors_at_rest_are_ok() {
        assert_eq!(severities(9.81, 0.001), [Severity::Ok; 2]);
    }

    #[test]
    fn force_in_g_differs_from_bad_calibration() {
        let [gravity, _] = checks(1.001, 0.01, 0.0, 0.0);
        assert_eq!(gravity.result, Severity::Problem);
        assert_eq!(gravity.remedy, Some(Remedy::ConvertFromG));
        assert_eq!([9.5, 8.0].map(|force| severities(force, 0.0)[0]), [Severity::Warning, Severity::Problem]);
    }

    #[test]
    fn gyro_bias_is_a_warning() {
        assert_eq!(severities(9.81, 0.1)[1], Severity::Warning);
    }

    #[test]
    fn moving_body_is_not_checked() {
        for [gravity, gyro] in [checks(1.0, 0.5, 0.0, 0.0), checks(1.0, 0.0, 0.0, 0.1), checks(1.0, 0.0, 2.0, 0.0)] {
            assert_eq!([gravity.result, gyro.result], [Severity::Ok; 2]);
            assert!(gravity.found.contains("the body moves"), "{gravity}");
        }
    }

    #[test]
    fn slow_turn_rotates_force_and_is_not_a_bias() {
        let mut still = RestCheck::default();
        for i in 0..1000 {
            let (sin, cos) = (f64::from(i) * 1e-3 * 0.1).sin_cos();
            let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
            (sample.force_m_s2, sample.rate_rad_s) = ([9.81 * sin, 0.0, 9.81 * cos], [0.0, 0.1, 0.0]);
            still.push(&sample);
        }
        let [_, gyro] = checks_of(&still);
        assert!(gyro.found.contains("the body moves"), "{gyro}");
    }

    #[test]
    fn too_few_samples_are_not_checked() {
        let [gravity, _] = checks_of(&RestCheck::default());
        assert!(gravity.found.contains("too few"), "{gravity}");
    }
}
