//! What the sensors say while nothing moves: gravity, and no turn.
//!
//! Input: samples of a few seconds. Output: two checks. Time: none. Failure: while the body moves nothing can be said, and that is said.

use messages::ImuSample;

use super::Check;

/// Standard gravity, m/s² (ISO 80000-3).
const GRAVITY_M_S2: f64 = 9.806_65;
/// At rest |f| varies less than this, standard deviation, m/s²: vibration and noise of usual sensors.
const FORCE_SD_MAX_M_S2: f64 = 0.3;
/// At rest each rate varies less than this, standard deviation, rad/s (1 °/s).
const RATE_SD_MAX_RAD_S: f64 = 0.0175;
/// What is beyond it is no rest but a steady turn, or no gyro that can be used, rad/s (20 °/s).
const RATE_MAX_RAD_S: f64 = 0.35;
/// A bias beyond it is more than usual sensors have, rad/s (2 °/s).
const BIAS_MAX_RAD_S: f64 = 0.035;
/// Samples that say something.
const SAMPLES_MIN: f64 = 50.0;

/// Mean and spread of what came: |f|, and the rate about each axis.
#[derive(Debug, Clone, Copy, Default)]
pub struct Still {
    count: f64,
    sums: [f64; 4],
    squares: [f64; 4],
}

impl Still {
    /// Takes a sample.
    pub fn take(&mut self, sample: &ImuSample) {
        let norm_m_s2 = sample.force_m_s2.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [x, y, z] = sample.rate_rad_s;
        self.count += 1.0;
        for (i, value) in [norm_m_s2, x, y, z].into_iter().enumerate() {
            self.sums[i] += value;
            self.squares[i] += value * value;
        }
    }

    /// |f| against g, and the rate against zero.
    pub fn checks(&self) -> [Check; 2] {
        let means = self.sums.map(|sum| sum / self.count);
        let mut sds = [0.0; 4];
        for (i, sd) in sds.iter_mut().enumerate() {
            *sd = (self.squares[i] / self.count - means[i] * means[i]).max(0.0).sqrt();
        }
        let [norm_m_s2, rates @ ..] = means;
        let rate_rad_s = rates.iter().map(|x| x * x).sum::<f64>().sqrt();
        let spread = sds[1..].iter().any(|sd| *sd > RATE_SD_MAX_RAD_S) || sds[0] > FORCE_SD_MAX_M_S2;
        if self.count < SAMPLES_MIN {
            let found = format!("{} samples are too few", self.count);
            return ["gravity", "gyro-at-rest"].map(|check| Check::ok(check, format!("not looked at: {found}")));
        }
        if spread || rate_rad_s > RATE_MAX_RAD_S {
            let found = format!(
                "not looked at: the body moves (mean |f| {norm_m_s2:.2} m/s² ± {:.2}, mean rate {:.1} °/s)",
                sds[0],
                rate_rad_s.to_degrees()
            );
            return ["gravity", "gyro-at-rest"].map(|check| Check::ok(check, found.clone()));
        }
        [gravity(norm_m_s2), gyro(rate_rad_s)]
    }
}

fn gravity(norm_m_s2: f64) -> Check {
    let check = "gravity";
    let share = norm_m_s2 / GRAVITY_M_S2;
    let found = format!("mean |f| {norm_m_s2:.3} m/s², {:+.1} % of g, at rest", 100.0 * (share - 1.0));
    let calibrate = "calibrate the accelerometer: [ingest.calibration.accel] in launch.toml";
    if (0.95 / GRAVITY_M_S2..1.05 / GRAVITY_M_S2).contains(&share) {
        Check::problem(
            check,
            found,
            "the accelerometer gives g, not m/s²: scale = [9.80665, 9.80665, 9.80665] in [ingest.calibration.accel]",
        )
    } else if !(0.9..1.1).contains(&share) {
        Check::problem(check, found, calibrate)
    } else if !(0.98..1.02).contains(&share) {
        Check::warning(check, found, calibrate)
    } else {
        Check::ok(check, found)
    }
}

fn gyro(rate_rad_s: f64) -> Check {
    let (check, found) = ("gyro-at-rest", format!("mean rate {:.3} °/s at rest", rate_rad_s.to_degrees()));
    if rate_rad_s > BIAS_MAX_RAD_S {
        let remedy = "if nothing turns, take the bias out: bias in [ingest.calibration.gyro] of launch.toml; a gyro in °/s needs a scale of 0.0174533";
        Check::warning(check, found, remedy)
    } else {
        Check::ok(check, found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Outcome;

    fn checks(force: f64, force_noise: f64, rate_rad_s: f64, rate_swing_rad_s: f64) -> [Check; 2] {
        let mut still = Still::default();
        for i in 0..2000 {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
            sample.force_m_s2[2] = force + sign * force_noise;
            sample.rate_rad_s[0] = rate_rad_s + sign * rate_swing_rad_s;
            still.take(&sample);
        }
        still.checks()
    }

    fn outcomes(force: f64, rate_rad_s: f64) -> [Outcome; 2] {
        checks(force, 0.1, rate_rad_s, 1e-3).map(|check| check.result)
    }

    #[test]
    fn a_sound_sensor_at_rest_is_found_sound() {
        assert_eq!(outcomes(9.81, 0.001), [Outcome::Ok; 2]);
    }

    #[test]
    fn a_force_in_g_is_told_from_a_bad_calibration() {
        let [gravity, _] = checks(1.001, 0.01, 0.0, 0.0);
        assert_eq!(gravity.result, Outcome::Problem);
        assert!(gravity.remedy.unwrap().contains("gives g, not m/s²"));
        assert_eq!([9.5, 8.0].map(|force| outcomes(force, 0.0)[0]), [Outcome::Warning, Outcome::Problem]);
    }

    #[test]
    fn a_bias_is_seen() {
        assert_eq!(outcomes(9.81, 0.1)[1], Outcome::Warning);
    }

    #[test]
    fn nothing_is_said_of_a_body_that_moves() {
        for [gravity, gyro] in [checks(1.0, 0.5, 0.0, 0.0), checks(1.0, 0.0, 0.0, 0.1), checks(1.0, 0.0, 2.0, 0.0)] {
            assert_eq!([gravity.result, gyro.result], [Outcome::Ok; 2]);
            assert!(gravity.found.contains("the body moves"), "{gravity}");
        }
    }

    #[test]
    fn nothing_is_said_without_samples() {
        let [gravity, _] = Still::default().checks();
        assert!(gravity.found.contains("too few"), "{gravity}");
    }
}
