//! The law of `levelling-pi`: what each input does to the level, the azimuth and the bias.

use core::f64::consts::PI;

use super::{
    aiding::{Both, Track},
    filter::{BIAS_KNOWN_SD_RAD_S, BIAS_MAX_RAD_S, BIAS_SD_RAD_S, LevellingPi},
    heading::Steer,
};
use crate::{
    Complex, Vector3,
    fuser::{
        fused::Corrections,
        levelling::{
            geometry::{azimuth, carried, forward, lean_of, tilt_of, turned_too_much},
            limits::{FORCE_LIMIT_M_S2, RATE_LIMIT_RAD_S, bounded},
            pull::Pull,
        },
        low_pass::{averaging_gain, low_pass_gain},
    },
    gnss::Fix,
    state::wrapped_rad,
};

/// Standard deviation of a bias found at standstill, rad/s.
const BIAS_STILL_SD_RAD_S: f64 = 0.01 * PI / 180.0;
/// Random walk of the bias, rad/s/√s: 0.0005 °/s/√s.
const BIAS_WALK_RAD_S: f64 = 0.0005 * PI / 180.0;
/// Time constant at which the bias follows the mean rate at standstill, s.
const BIAS_STILL_S: f64 = 5.0;
/// Largest part of an increment that levelling is to explain, m/s and m/s²: an outlier keeps a bounded pull.
const UNEXPLAINED_M_S: f64 = 0.5;
const UNEXPLAINED_M_S2: f64 = 2.0;

impl LevellingPi {
    /// What time does: the bias walks, and what is not known of it turns the azimuth.
    pub(super) fn pass(&mut self, dt_s: f64) {
        let variance = self.bias_variance_rad2_s2 + BIAS_WALK_RAD_S * BIAS_WALK_RAD_S * dt_s;
        self.bias_variance_rad2_s2 = variance.min(BIAS_SD_RAD_S * BIAS_SD_RAD_S);
        self.heading.pass(self.bias_sd_rad_s(), dt_s);
        self.aiding.pass(dt_s);
        self.unlevelled_s += dt_s;
    }

    pub(super) fn bias_sd_rad_s(&self) -> f64 {
        libm::sqrt(self.bias_variance_rad2_s2)
    }

    pub(super) fn bias_known(&self) -> bool {
        self.bias_sd_rad_s() < BIAS_KNOWN_SD_RAD_S
    }

    /// A fix: an increment to level by, and a track.
    pub(super) fn take(&mut self, fix: &Fix) -> Corrections {
        let (both, track) = self.aiding.take(fix, self.heading.known, &self.settings);
        let mut corrections = Corrections { velocity: true, ..Corrections::default() };
        if let Some(both) = both {
            self.explain(&both);
            (corrections.tilt, corrections.bias) = (true, true);
        }
        if let Some(track) = track {
            corrections.aligned = self.point(&track, both.map(|both| both.span_s));
        }
        corrections
    }

    /// Levels by what the force has and the fixes have not: tilt (∫ f_P dt − ΔV)/(g τ), and the bias by its integral over 4 τ.
    fn explain(&mut self, both: &Both) {
        let settings = self.settings;
        let Both { by_force_m_s, by_fixes_m_s, span_s } = *both;
        let unexplained_m_s = shortened(by_force_m_s - by_fixes_m_s, UNEXPLAINED_M_S + UNEXPLAINED_M_S2 * span_s);
        let tilt_rad = tilt_of(unexplained_m_s) / settings.time_constant_s;
        self.pending_rad += tilt_rad;
        self.learn(azimuth(self.attitude).conj() * tilt_rad, 0.25 / settings.time_constant_s);
        let gain = low_pass_gain(span_s, settings.time_constant_s);
        self.lag_rad += (tilt_of(unexplained_m_s / span_s) - self.lag_rad) * gain;
        // The slower of the two loops that find the bias.
        self.bias_variance_rad2_s2 -=
            self.bias_variance_rad2_s2 * low_pass_gain(span_s, settings.track_time_constant_s);
        if self.heading.known {
            let steer = self.heading.by_acceleration(by_force_m_s, by_fixes_m_s, span_s, &settings);
            self.steer(steer);
        }
    }

    /// Draws the azimuth to a track; the first sets it, and that is true.
    fn point(&mut self, track: &Track, span_s: Option<f64>) -> bool {
        let (sin, cos) = libm::sincos(self.turn_rate_rad_s * track.age_s);
        let pointed = azimuth(self.attitude) * forward(self.attitude) * Complex::new(cos, sin);
        // Straight up or down there is no course.
        if pointed.norm_sqr() < 0.5 {
            return false;
        }
        if !self.heading.known && track.sure {
            let steer = self.heading.set(pointed, track.direction);
            self.steer(steer);
            self.pending_rad = Complex::new(0.0, 0.0);
            self.aiding.interrupt();
            return true;
        }
        if let (true, Some(span_s)) = (self.heading.known, span_s) {
            let steer = self.heading.by_track(pointed, track.direction, span_s, &self.settings);
            self.steer(steer);
        }
        false
    }

    fn steer(&mut self, steer: Steer) {
        self.attitude.z_rad = wrapped_rad(self.attitude.z_rad - steer.turn_rad);
        self.add_bias(self.attitude.up.direction() * steer.bias_rad_s);
    }

    /// A tilt that levelling takes away has come from a bias, which keeps `share_per_s` of it.
    fn learn(&mut self, tilt_rad: Complex<f64>, share_per_s: f64) {
        self.add_bias(turned_too_much(self.attitude, tilt_rad) * share_per_s);
    }

    fn add_bias(&mut self, more_rad_s: Vector3<f64>) {
        self.bias_rad_s = bounded(self.bias_rad_s + more_rad_s, BIAS_MAX_RAD_S);
    }

    fn correct_tilt(&mut self, tilt_rad: Complex<f64>) {
        self.attitude = self.attitude.leaned(lean_of(tilt_rad)).attitude;
    }

    /// Levels without a fix: by the low-passed force less V H' of the remembered speed where the bias is known, else as S4.
    pub(super) fn coast(&mut self, pull: Pull, turn_rate_rad_s: f64) {
        let settings = self.settings;
        let known = self.bias_known();
        let (time_constant_s, low_pass_s, speed_m_s, weight) = if known {
            let turns = self.turn_rate_rad_s / settings.gap_turn_deg_s.to_radians();
            let speed_m_s = self.aiding.speed_m_s().unwrap_or(0.0);
            (settings.gap_time_constant_s, settings.gap_low_pass_s, speed_m_s, 1.0 / (1.0 + turns * turns))
        } else {
            (settings.cold_time_constant_s, settings.cold_low_pass_s, 0.0, 1.0)
        };
        let axes = azimuth(self.attitude);
        let left_m_s2 = axes * (pull.level_m_s2 - carried(self.attitude, speed_m_s * turn_rate_rad_s, 0.0));
        let gain = averaging_gain(pull.dt_s, low_pass_s, &mut self.unaveraged_s);
        self.low_pass_m_s2 += (left_m_s2 - self.low_pass_m_s2) * gain;
        let gain = weight * low_pass_gain(pull.dt_s, time_constant_s);
        let seen_rad = tilt_of(self.low_pass_m_s2);
        let tilt_rad = axes.conj() * seen_rad * gain;
        self.lag_rad += (seen_rad - self.lag_rad) * gain;
        if known {
            self.learn(tilt_rad, 1.0 / settings.gap_integral_s);
            // What has walked off is found again: a bias that was known once stays so.
            self.bias_variance_rad2_s2 -=
                self.bias_variance_rad2_s2 * low_pass_gain(pull.dt_s, settings.gap_integral_s);
        }
        self.correct_tilt(tilt_rad);
    }

    /// Feeds in what is pending, so that a fix does not show as a step.
    pub(super) fn feed_in(&mut self, dt_s: f64) {
        let share_rad = self.pending_rad * low_pass_gain(dt_s, self.settings.feed_in_s);
        self.pending_rad -= share_rad;
        self.correct_tilt(azimuth(self.attitude).conj() * share_rad);
    }

    /// At standstill the bias is what the gyro reads.
    pub(super) fn stand(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>, dt_s: f64) -> bool {
        let speed_m_s = self.aiding.speed_m_s();
        let (rate, force) = (bounded(rate_rad_s, RATE_LIMIT_RAD_S), bounded(force_m_s2, FORCE_LIMIT_M_S2));
        let Some(mean_rad_s) = self.still.step(rate, force, speed_m_s, dt_s) else { return false };
        self.bias_rad_s += (mean_rad_s - self.bias_rad_s) * low_pass_gain(dt_s, BIAS_STILL_S);
        self.bias_variance_rad2_s2 = self.bias_variance_rad2_s2.min(BIAS_STILL_SD_RAD_S * BIAS_STILL_SD_RAD_S);
        true
    }
}

fn shortened(vector: Complex<f64>, limit: f64) -> Complex<f64> {
    let size = libm::sqrt(vector.norm_sqr());
    if size > limit { vector * (limit / size) } else { vector }
}
