//! What the sensors say while nothing moves: gravity, and no turn.
//!
//! Input: samples of a few seconds. Output: two checks. Time: none. Failure: while the body moves nothing can be said, and that is said.

use launch::pluralize;
use messages::ImuSample;

use super::Check;

/// Standard gravity, m/s² (ISO 80000-3).
const GRAVITY_M_S2: f64 = 9.806_65;
/// At rest |f| varies less than this, standard deviation, m/s²: vibration and noise of usual sensors.
const MAX_FORCE_SD_M_S2: f64 = 0.3;
/// At rest the specific force turns by less than this while it is looked at, as a share of |f| (0.9°).
const MAX_DRIFT: f64 = 0.015;
/// At rest each rate varies less than this, standard deviation, rad/s (1 °/s).
const MAX_RATE_SD_RAD_S: f64 = 0.0175;
/// What is beyond it is no rest but a steady turn, or no gyro that can be used, rad/s (20 °/s).
const MAX_RATE_RAD_S: f64 = 0.35;
/// A bias beyond it is more than usual sensors have, rad/s (2 °/s).
const MAX_BIAS_RAD_S: f64 = 0.035;
/// Samples that say something.
const MIN_SAMPLES: f64 = 50.0;

/// What came: |f|, the rate about each axis, the specific force along each.
#[derive(Debug, Clone, Copy, Default)]
pub struct Still {
    count: f64,
    norm_m_s2: Moments,
    rate_rad_s: [Moments; 3],
    force_m_s2: [Moments; 3],
}

/// Sums of a quantity, of its square, and of its product with the sample's number.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    sum: f64,
    squares: f64,
    by_number: f64,
}

impl Moments {
    fn take(&mut self, number: f64, value: f64) {
        self.sum += value;
        self.squares += value * value;
        self.by_number += number * value;
    }

    fn mean(&self, count: f64) -> f64 {
        self.sum / count
    }

    fn sd(&self, count: f64) -> f64 {
        (self.squares / count - self.mean(count).powi(2)).max(0.0).sqrt()
    }

    /// By how much it changed from the first sample to the last: the slope of the line of least squares, times their number.
    fn drift(&self, count: f64) -> f64 {
        12.0 * (self.by_number - self.sum * (count - 1.0) / 2.0) / (count * count - 1.0)
    }
}

impl Still {
    /// Takes a sample.
    pub fn take(&mut self, sample: &ImuSample) {
        let norm_m_s2 = norm(sample.force_m_s2);
        self.norm_m_s2.take(self.count, norm_m_s2);
        for (moments, value) in self.rate_rad_s.iter_mut().zip(sample.rate_rad_s) {
            moments.take(self.count, value);
        }
        for (moments, value) in self.force_m_s2.iter_mut().zip(sample.force_m_s2) {
            moments.take(self.count, value);
        }
        self.count += 1.0;
    }

    /// |f| against g, and the rate against zero.
    pub fn checks(&self) -> [Check; 2] {
        let count = self.count;
        if count < MIN_SAMPLES {
            return unseen(format!("{}: too few", pluralize(count as u64, "sample")));
        }
        let (norm_m_s2, norm_sd_m_s2) = (self.norm_m_s2.mean(count), self.norm_m_s2.sd(count));
        let rate_rad_s = norm(self.rate_rad_s.map(|rate| rate.mean(count)));
        let drift = norm(self.force_m_s2.map(|force| force.drift(count))) / norm_m_s2;
        let moves = self.rate_rad_s.iter().any(|rate| rate.sd(count) > MAX_RATE_SD_RAD_S)
            || norm_sd_m_s2 > MAX_FORCE_SD_M_S2
            || rate_rad_s > MAX_RATE_RAD_S
            || drift > MAX_DRIFT;
        if moves {
            let rate_deg_s = rate_rad_s.to_degrees();
            return unseen(format!(
                "the body moves (mean |f| {norm_m_s2:.2} m/s² ± {norm_sd_m_s2:.2}, mean rate {rate_deg_s:.1} °/s)"
            ));
        }
        [gravity(norm_m_s2), gyro(rate_rad_s)]
    }
}

fn unseen(why: String) -> [Check; 2] {
    ["gravity", "gyro-at-rest"].map(|check| Check::ok(check, format!("not looked at: {why}")))
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
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
    if rate_rad_s > MAX_BIAS_RAD_S {
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
    fn a_slow_turn_is_told_from_a_bias_by_the_force_that_turns_with_it() {
        let mut still = Still::default();
        for i in 0..1000 {
            let (sin, cos) = (f64::from(i) * 1e-3 * 0.1).sin_cos();
            let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
            (sample.force_m_s2, sample.rate_rad_s) = ([9.81 * sin, 0.0, 9.81 * cos], [0.0, 0.1, 0.0]);
            still.take(&sample);
        }
        let [_, gyro] = still.checks();
        assert!(gyro.found.contains("the body moves"), "{gyro}");
    }

    #[test]
    fn nothing_is_said_without_samples() {
        let [gravity, _] = Still::default().checks();
        assert!(gravity.found.contains("too few"), "{gravity}");
    }
}
