//! Control law of `levelling-pi`: the effect of each input on the level, the azimuth and the bias.

use core::f64::consts::PI;

use super::{
    aiding::{MatchedIncrement, Track},
    filter::{KNOWN_BIAS_SD_RAD_S, LevellingPi, MAX_BIAS_RAD_S, UNKNOWN_BIAS_SD_RAD_S},
    heading::HeadingCorrection,
};
use crate::{
    Complex, Vector3,
    fuser::{
        fused::Corrections,
        levelling::{
            geometry::{
                azimuth, forward, gyro_error_from_tilt, level_correction, tilt_from_acceleration,
                vehicle_acceleration_m_s2,
            },
            level_force::LevelForce,
            limits::{MAX_FORCE_M_S2, MAX_RATE_RAD_S, limited},
        },
        low_pass::{averaging_gain, low_pass_gain},
    },
    gnss::Fix,
    state::wrapped_rad,
};

/// Standard deviation of a bias estimated at standstill, rad/s.
const STANDSTILL_BIAS_SD_RAD_S: f64 = 0.01 * PI / 180.0;
/// Random walk of the bias, rad/s/√s: 0.0005 °/s/√s.
const BIAS_RANDOM_WALK_RAD_S: f64 = 0.0005 * PI / 180.0;
/// Time constant with which the bias follows the mean rate at standstill, s.
const STANDSTILL_BIAS_TIME_CONSTANT_S: f64 = 5.0;
/// Constant part of the limit on the mismatch between velocity increments, m/s.
///
/// The mismatch is the difference between the increments from the force and from the fixes. The
/// limit bounds the effect of an outlier.
const MAX_UNEXPLAINED_M_S: f64 = 0.5;
/// Part of the mismatch limit that is proportional to the duration of the increments, m/s². See
/// [`MAX_UNEXPLAINED_M_S`].
const MAX_UNEXPLAINED_M_S2: f64 = 2.0;

impl LevellingPi {
    /// Propagates the uncertainties over one interval.
    ///
    /// The random walk of the bias and the azimuth drift due to the bias increase them.
    pub(super) fn advance(&mut self, dt_s: f64) {
        let variance = self.bias_variance_rad2_s2 + BIAS_RANDOM_WALK_RAD_S * BIAS_RANDOM_WALK_RAD_S * dt_s;
        self.bias_variance_rad2_s2 = variance.min(UNKNOWN_BIAS_SD_RAD_S * UNKNOWN_BIAS_SD_RAD_S);
        self.heading.advance(self.bias_sd_rad_s(), dt_s);
        self.aiding.advance(dt_s);
        self.since_force_s += dt_s;
    }

    pub(super) fn bias_sd_rad_s(&self) -> f64 {
        libm::sqrt(self.bias_variance_rad2_s2)
    }

    pub(super) fn is_bias_known(&self) -> bool {
        self.bias_sd_rad_s() < KNOWN_BIAS_SD_RAD_S
    }

    /// Processes a fix. Its velocity increment corrects the level, and its track corrects the
    /// azimuth.
    pub(super) fn process_fix(&mut self, fix: &Fix) -> Corrections {
        let (increment, track) = self.aiding.process_fix(fix, self.heading.known, &self.settings);
        let mut corrections = Corrections { velocity: true, ..Corrections::default() };
        if let Some(increment) = increment {
            self.level_by_increment(&increment);
            (corrections.tilt, corrections.bias) = (true, true);
        }
        if let Some(track) = track {
            corrections.aligned = self.apply_track(&track, increment.map(|both| both.span_s));
        }
        corrections
    }

    /// Corrects level and bias by the mismatch between force and fixes.
    ///
    /// The mismatch is the difference between the velocity increments that they measure. The tilt
    /// correction is (∫ f_P dt − ΔV)/(g τ). The bias correction is the tilt correction divided by 4
    /// τ.
    fn level_by_increment(&mut self, increment: &MatchedIncrement) {
        let settings = self.settings;
        let MatchedIncrement { by_force_m_s, by_fixes_m_s, span_s } = *increment;
        let unexplained_m_s =
            limited_norm(by_force_m_s - by_fixes_m_s, MAX_UNEXPLAINED_M_S + MAX_UNEXPLAINED_M_S2 * span_s);
        let tilt_rad = tilt_from_acceleration(unexplained_m_s) / settings.time_constant_s;
        self.pending_rad += tilt_rad;
        self.learn_bias(azimuth(self.attitude).conj() * tilt_rad, 0.25 / settings.time_constant_s);
        let gain = low_pass_gain(span_s, settings.time_constant_s);
        self.lag_rad += (tilt_from_acceleration(unexplained_m_s / span_s) - self.lag_rad) * gain;
        // Two loops estimate the bias. The variance decays with the time constant of the slower
        // loop, the one that follows the track.
        self.bias_variance_rad2_s2 -=
            self.bias_variance_rad2_s2 * low_pass_gain(span_s, settings.track_time_constant_s);
        if self.heading.known {
            let correction = self.heading.correct_by_acceleration(by_force_m_s, by_fixes_m_s, span_s, &settings);
            self.correct_heading(correction);
        }
    }

    /// Corrects the azimuth towards a track. Returns `true` for the first confirmed track, which
    /// sets the azimuth to true north.
    fn apply_track(&mut self, track: &Track, span_s: Option<f64>) -> bool {
        let (sin, cos) = libm::sincos(self.turn_rate_rad_s * track.age_s);
        let forward_at_fix = azimuth(self.attitude) * forward(self.attitude) * Complex::new(cos, sin);
        // The course is undefined if the nose points straight up or down.
        if forward_at_fix.norm_sqr() < 0.5 {
            return false;
        }
        if !self.heading.known && track.is_confirmed {
            let correction = self.heading.align_to_track(forward_at_fix, track.direction);
            self.correct_heading(correction);
            self.pending_rad = Complex::new(0.0, 0.0);
            self.aiding.interrupt();
            return true;
        }
        if let (true, Some(span_s)) = (self.heading.known, span_s) {
            let correction = self.heading.correct_by_track(forward_at_fix, track.direction, span_s, &self.settings);
            self.correct_heading(correction);
        }
        false
    }

    fn correct_heading(&mut self, correction: HeadingCorrection) {
        self.attitude.z_rad = wrapped_rad(self.attitude.z_rad - correction.azimuth_rad);
        self.add_bias(self.attitude.up.direction() * correction.bias_rad_s);
    }

    /// Attributes a fraction of a tilt correction to the gyro bias.
    fn learn_bias(&mut self, tilt_rad: Complex<f64>, share_per_s: f64) {
        self.add_bias(gyro_error_from_tilt(self.attitude, tilt_rad) * share_per_s);
    }

    fn add_bias(&mut self, increment_rad_s: Vector3<f64>) {
        self.bias_rad_s = limited(self.bias_rad_s + increment_rad_s, MAX_BIAS_RAD_S);
    }

    fn correct_tilt(&mut self, tilt_rad: Complex<f64>) {
        self.attitude = self.attitude.tilted(level_correction(tilt_rad)).attitude;
    }

    /// Corrects the level without a fix.
    ///
    /// If the bias is known, the correction uses the low-pass filtered force minus the centripetal
    /// acceleration V H', where V is the vehicle's last speed and H' its turn rate. Otherwise the
    /// correction follows S4's autonomous law.
    pub(super) fn level_without_fix(&mut self, force: LevelForce, turn_rate_rad_s: f64) {
        let settings = self.settings;
        let known = self.is_bias_known();
        let (time_constant_s, low_pass_s, speed_m_s, weight) = if known {
            let turn_ratio = self.turn_rate_rad_s / settings.gap_turn_deg_s.to_radians();
            let speed_m_s = self.aiding.speed_m_s().unwrap_or(0.0);
            (settings.gap_time_constant_s, settings.gap_low_pass_s, speed_m_s, 1.0 / (1.0 + turn_ratio * turn_ratio))
        } else {
            (settings.cold_time_constant_s, settings.cold_low_pass_s, 0.0, 1.0)
        };
        let axes = azimuth(self.attitude);
        let unexplained_m_s2 =
            axes * (force.level_m_s2 - vehicle_acceleration_m_s2(self.attitude, speed_m_s * turn_rate_rad_s, 0.0));
        let gain = averaging_gain(force.dt_s, low_pass_s, &mut self.averaging_deficit_s);
        self.low_pass_m_s2 += (unexplained_m_s2 - self.low_pass_m_s2) * gain;
        let gain = weight * low_pass_gain(force.dt_s, time_constant_s);
        let measured_rad = tilt_from_acceleration(self.low_pass_m_s2);
        let tilt_rad = axes.conj() * measured_rad * gain;
        self.lag_rad += (measured_rad - self.lag_rad) * gain;
        if known {
            self.learn_bias(tilt_rad, 1.0 / settings.gap_integral_s);
            // The random walk increases the variance. This decay prevents the increase from
            // making a known bias unknown.
            self.bias_variance_rad2_s2 -=
                self.bias_variance_rad2_s2 * low_pass_gain(force.dt_s, settings.gap_integral_s);
        }
        self.correct_tilt(tilt_rad);
    }

    /// Applies a part of the pending tilt correction, so that a fix does not cause a step.
    pub(super) fn apply_pending(&mut self, dt_s: f64) {
        let share_rad = self.pending_rad * low_pass_gain(dt_s, self.settings.feed_in_s);
        self.pending_rad -= share_rad;
        self.correct_tilt(azimuth(self.attitude).conj() * share_rad);
    }

    /// Updates the bias with the mean rate at standstill. Returns `true` if the body stands still.
    pub(super) fn update_standstill(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>, dt_s: f64) -> bool {
        let speed_m_s = self.aiding.speed_m_s();
        let (rate, force) = (limited(rate_rad_s, MAX_RATE_RAD_S), limited(force_m_s2, MAX_FORCE_M_S2));
        let Some(mean_rad_s) = self.standstill.step(rate, force, speed_m_s, dt_s) else { return false };
        self.bias_rad_s += (mean_rad_s - self.bias_rad_s) * low_pass_gain(dt_s, STANDSTILL_BIAS_TIME_CONSTANT_S);
        self.bias_variance_rad2_s2 =
            self.bias_variance_rad2_s2.min(STANDSTILL_BIAS_SD_RAD_S * STANDSTILL_BIAS_SD_RAD_S);
        true
    }
}

fn limited_norm(vector: Complex<f64>, limit: f64) -> Complex<f64> {
    let size = libm::sqrt(vector.norm_sqr());
    if size > limit { vector * (limit / size) } else { vector }
}
