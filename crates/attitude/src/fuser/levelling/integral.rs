//! The fuser stage `levelling-pi`: levelling by matched increments of velocity, with an estimate of the gyro's bias.

use super::{
    FLOOR_RAD, FORCE_LIMIT_M_S2, Pull, RATE_LIMIT_RAD_S, aiding::Aiding, azimuth, bounded, carried, credible,
    interval_s, lean_of, still::Still, tilt_of, turn_rate_rad_s, turned_too_much,
};
use crate::{
    Complex, Vector3,
    course::Reference,
    fuser::{Corrections, Estimate, Fused, FuserInput, innovation_rad, low_pass_gain},
    gnss::Fix,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{Numbers, RestoreError, Stage, attitude_flaw, bias_flaw},
    state::{Attitude, arg, wrapped_rad},
    turn::Turn,
};
use core::f64::consts::PI;

settings! {
    /// Settings of `levelling-pi`.
    pub struct PiSettings {
        /// Time constant of levelling with satellite velocity; the gyro's bias follows with twice that.
        time_constant_s: 20.0 in 1.0 .. 1000.0, "s";
        /// Time constant of the course with a track over ground; the bias about the vertical follows with twice that.
        course_time_constant_s: 50.0 in 5.0 .. 10000.0, "s";
        /// Ground speed below which a track says nothing about the course.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
        /// How old a velocity is on arrival where the receiver does not tell.
        latency_s: 0.2 in 0.0 .. 0.8, "s";
        /// A fix of a larger standard deviation is none.
        velocity_sd_max_m_s: 1.0 in 0.01 .. 100.0, "m/s";
        /// Time over which a correction is fed in.
        feed_in_s: 0.3 in 0.0 .. 5.0, "s";
        /// Time after the last fix from which levelling is autonomous.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Time constant of levelling in a gap.
        gap_time_constant_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of what is left of the specific force in a gap.
        gap_low_pass_s: 30.0 in 0.0 .. 1000.0, "s";
        /// Integral time of the gyro's bias in a gap.
        gap_integral_s: 4000.0 in 100.0 .. 1000000.0, "s";
        /// Turn rate at which the force counts for half in a gap.
        gap_turn_deg_s: 1.0 in 0.01 .. 1000.0, "°/s";
        /// Time constant of levelling while the gyro's bias is unknown and there is no satellite velocity.
        cold_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of the specific force then.
        cold_low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
    }
}

/// Standard deviation of a bias of which nothing is known, rad/s: 0.1 °/s.
const BIAS_SD_RAD_S: f64 = 0.1 * PI / 180.0;
/// Standard deviation up to which the bias counts as known, rad/s.
const BIAS_KNOWN_SD_RAD_S: f64 = 0.05 * PI / 180.0;
/// Standard deviation of a bias found at standstill, rad/s.
const BIAS_STILL_SD_RAD_S: f64 = 0.01 * PI / 180.0;
/// Random walk of the bias, rad/s/√s: 0.0005 °/s/√s.
const BIAS_WALK_RAD_S: f64 = 0.0005 * PI / 180.0;
/// Time constant at which the bias follows the mean rate at standstill, s.
const BIAS_STILL_S: f64 = 5.0;
/// Largest component of the bias, rad/s: 5 °/s. A loop that asks for more is not following a bias.
const BIAS_MAX_RAD_S: f64 = 5.0 * PI / 180.0;
/// Wind across the track that is usual, m/s.
const CRAB_M_S: f64 = 6.0;
/// Time over which the turn rate is averaged that decides how much the force counts, s.
const TURN_MEAN_S: f64 = 1.0;

/// The fuser stage `levelling-pi`.
///
/// | | tilt | bias |
/// | --- | --- | --- |
/// | fix | (∫ f_P dt − ΔV)/(g τ) over the interval between the moments at which the fixes were valid, τ = 20 s | its integral in body axes over 4 τ |
/// | track | azimuth by (H − H_track)/T, T = 50 s | about the vertical, over 4 T |
/// | gap | low-pass of f_P less V H' of the remembered speed, over 100 s, less in a turn | its integral over 4000 s |
/// | cold | low-pass of f_P over 60 s, as S4 | none |
/// | standstill | as in a gap | the mean rate |
///
/// An increment of velocity counts once; after a lost interval the next two fixes begin a new one. The first track turns the platform
/// to north, and the heading is true from then on; a crab angle remains in it.
#[derive(Debug, Clone, PartialEq)]
pub struct LevellingPi {
    settings: PiSettings,
    attitude: Attitude,
    started: bool,
    /// Time since the last force, s.
    unlevelled_s: f64,
    bias_rad_s: Vector3<f64>,
    bias_variance_rad2_s2: f64,
    /// H', averaged.
    turn_rate_rad_s: f64,
    aiding: Aiding,
    /// Tilt that is still to be taken away, platform, rad.
    pending_rad: Complex<f64>,
    /// What is left of the force in a gap, low-passed, platform, m/s².
    low_pass_m_s2: Complex<f64>,
    /// What levelling took for tilt, low-passed over its own time constant, platform, rad.
    lag_rad: Complex<f64>,
    /// Of the heading less the crab angle; π while there is no course.
    drift_sd_rad: f64,
    still: Still,
}

impl Default for LevellingPi {
    fn default() -> Self {
        let none = Complex::new(0.0, 0.0);
        Self {
            settings: PiSettings::default(),
            attitude: Attitude::default(),
            started: false,
            unlevelled_s: 0.0,
            bias_rad_s: Vector3::zeros(),
            bias_variance_rad2_s2: BIAS_SD_RAD_S * BIAS_SD_RAD_S,
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            pending_rad: none,
            low_pass_m_s2: none,
            lag_rad: none,
            drift_sd_rad: PI,
            still: Still::default(),
        }
    }
}

impl LevellingPi {
    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
        self.begin();
    }

    /// What was followed belongs to another attitude.
    fn begin(&mut self) {
        let none = Complex::new(0.0, 0.0);
        (self.pending_rad, self.low_pass_m_s2, self.lag_rad) = (none, none, none);
        self.aiding.interrupt();
        self.still.interrupt();
    }

    fn bias_known(&self) -> bool {
        self.bias_variance_rad2_s2 < BIAS_KNOWN_SD_RAD_S * BIAS_KNOWN_SD_RAD_S
    }

    /// A tilt that levelling takes away has come from a bias, of which an integral time keeps `share`.
    fn learn(&mut self, tilt_rad: Complex<f64>, share_per_s: f64) {
        let bias_rad_s = self.bias_rad_s + turned_too_much(self.attitude, tilt_rad) * share_per_s;
        self.bias_rad_s = bounded(bias_rad_s, BIAS_MAX_RAD_S);
    }

    fn lean(&mut self, tilt_rad: Complex<f64>) {
        self.attitude = self.attitude.leaned(lean_of(tilt_rad)).attitude;
    }

    /// A fix: what levelling has to explain, and the track.
    fn take(&mut self, fix: &Fix) -> Corrections {
        let word = self.aiding.take(fix, &self.settings);
        let settings = self.settings;
        let axes = azimuth(self.attitude);
        let mut corrections = Corrections { velocity: true, ..Corrections::default() };
        if let Some((unexplained_m_s, span_s)) = word.unexplained {
            let tilt_rad = tilt_of(unexplained_m_s) / settings.time_constant_s;
            self.pending_rad += tilt_rad;
            self.learn(axes.conj() * tilt_rad, 0.25 / settings.time_constant_s);
            let gain = low_pass_gain(span_s, settings.time_constant_s);
            self.lag_rad += (tilt_of(unexplained_m_s / span_s) - self.lag_rad) * gain;
            let gain = low_pass_gain(span_s, settings.course_time_constant_s);
            self.bias_variance_rad2_s2 -= self.bias_variance_rad2_s2 * gain;
            (corrections.tilt, corrections.bias) = (true, true);
        }
        if let Some((track, age_s)) = word.track {
            corrections.aligned = word.first;
            let span_s = word.unexplained.map_or(0.0, |(_, span_s)| span_s);
            self.steer(axes, track, age_s, if word.first { None } else { Some(span_s) });
        }
        corrections
    }

    /// The azimuth moves towards the track over `span_s`; all the way without it.
    fn steer(&mut self, axes: Complex<f64>, track: Complex<f64>, age_s: f64, span_s: Option<f64>) {
        let forward = axes * super::forward(self.attitude);
        if forward.norm_sqr() < 0.5 {
            return;
        }
        // Where the body pointed when the track was valid, less the track; counter-clockwise.
        let (sin, cos) = libm::sincos(self.turn_rate_rad_s * age_s);
        let astray_rad = arg(forward * Complex::new(cos, sin) * track.conj());
        let turn_rad = match span_s {
            None => {
                self.pending_rad = Complex::new(0.0, 0.0);
                self.drift_sd_rad = 0.0;
                astray_rad
            }
            Some(span_s) => {
                let time_constant_s = self.settings.course_time_constant_s;
                let share_per_s2 = 0.25 / (time_constant_s * time_constant_s);
                let bias_rad_s = self.attitude.up.direction() * (astray_rad * share_per_s2 * span_s);
                self.bias_rad_s = bounded(self.bias_rad_s + bias_rad_s, BIAS_MAX_RAD_S);
                let gain = low_pass_gain(span_s, time_constant_s);
                self.drift_sd_rad -= self.drift_sd_rad * gain;
                astray_rad * gain
            }
        };
        self.attitude.z_rad = wrapped_rad(self.attitude.z_rad - turn_rad);
    }

    /// Levelling without a fix.
    fn coast(&mut self, pull: Pull, axes: Complex<f64>, turn_rate_rad_s: f64) {
        let settings = self.settings;
        let (time_constant_s, low_pass_s, speed_m_s, weight) = if self.bias_known() {
            let turns = self.turn_rate_rad_s / settings.gap_turn_deg_s.to_radians();
            let weight = 1.0 / (1.0 + turns * turns);
            (settings.gap_time_constant_s, settings.gap_low_pass_s, self.aiding.speed_m_s(), weight)
        } else {
            (settings.cold_time_constant_s, settings.cold_low_pass_s, 0.0, 1.0)
        };
        let left_m_s2 = pull.level_m_s2 - carried(self.attitude, speed_m_s * turn_rate_rad_s, 0.0);
        self.low_pass_m_s2 += (axes * left_m_s2 - self.low_pass_m_s2) * low_pass_gain(pull.dt_s, low_pass_s);
        let gain = weight * low_pass_gain(pull.dt_s, time_constant_s);
        let seen_rad = tilt_of(self.low_pass_m_s2);
        let tilt_rad = axes.conj() * seen_rad * gain;
        self.lag_rad += (seen_rad - self.lag_rad) * gain;
        if self.bias_known() {
            self.learn(tilt_rad, 1.0 / settings.gap_integral_s);
        }
        self.lean(tilt_rad);
    }

    /// What time does: biases walk, the heading drifts by what is not known of them, a correction is fed in.
    fn pass(&mut self, dt_s: f64) {
        let variance = self.bias_variance_rad2_s2 + BIAS_WALK_RAD_S * BIAS_WALK_RAD_S * dt_s;
        self.bias_variance_rad2_s2 = variance.min(BIAS_SD_RAD_S * BIAS_SD_RAD_S);
        self.drift_sd_rad = (self.drift_sd_rad + libm::sqrt(self.bias_variance_rad2_s2) * dt_s).min(PI);
        self.aiding.since_fix_s += dt_s;
        self.unlevelled_s += dt_s;
    }

    fn feed_in(&mut self, axes: Complex<f64>, dt_s: f64) {
        let share_rad = self.pending_rad * low_pass_gain(dt_s, self.settings.feed_in_s);
        self.pending_rad -= share_rad;
        self.lean(axes.conj() * share_rad);
    }

    /// At standstill the bias is what the gyro reads.
    fn stand(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>, dt_s: f64) -> bool {
        let speed_m_s = self.aiding.seen.then(|| self.aiding.speed_m_s());
        let (rate, force) = (bounded(rate_rad_s, RATE_LIMIT_RAD_S), bounded(force_m_s2, FORCE_LIMIT_M_S2));
        let Some(mean_rad_s) = self.still.step(rate, force, speed_m_s, dt_s) else { return false };
        self.bias_rad_s += (mean_rad_s - self.bias_rad_s) * low_pass_gain(dt_s, BIAS_STILL_S);
        self.bias_variance_rad2_s2 = self.bias_variance_rad2_s2.min(BIAS_STILL_SD_RAD_S * BIAS_STILL_SD_RAD_S);
        true
    }

    /// What levelling lags by, and in a gap what an unknown bias has done since.
    fn inclination_sd_rad(&self) -> f64 {
        let gap_s = if self.aiding.is_aided(self.settings.gap_s) { 0.0 } else { self.aiding.since_fix_s };
        let drifted_s = gap_s.min(self.settings.gap_time_constant_s);
        let drift_rad = libm::sqrt(self.bias_variance_rad2_s2) * drifted_s;
        libm::sqrt(self.lag_rad.norm_sqr() + drift_rad * drift_rad + FLOOR_RAD * FLOOR_RAD)
    }

    /// The drift and a crab angle in a wind that is usual.
    fn heading_sd_rad(&self) -> f64 {
        if !self.aiding.course_known {
            return PI;
        }
        let crab_rad = libm::atan2(CRAB_M_S, self.aiding.speed_m_s());
        libm::hypot(self.drift_sd_rad, crab_rad).min(PI)
    }

    fn reference(&self) -> Reference {
        if self.aiding.course_known { Reference::True } else { Reference::Arbitrary }
    }
}

impl Stage for LevellingPi {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "levelling-pi"
    }

    fn parameters(&self) -> &'static [Parameter] {
        PiSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let sensed_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        if let Some(motion) = &input.motion {
            let bias_turn = Turn::of_rotation_vector(self.bias_rad_s * -dt_s);
            self.attitude = self.attitude.turned(motion.turn.then(bias_turn)).attitude;
        }
        self.pass(dt_s);
        let turn_rate_rad_s = turn_rate_rad_s(self.attitude, sensed_rad_s - self.bias_rad_s);
        self.turn_rate_rad_s += (turn_rate_rad_s - self.turn_rate_rad_s) * low_pass_gain(dt_s, TURN_MEAN_S);
        let axes = azimuth(self.attitude);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                let pull = Pull::of(self.attitude, inclination, self.unlevelled_s);
                if self.unlevelled_s > pull.dt_s {
                    self.aiding.interrupt();
                }
                self.aiding.push(axes * pull.level_m_s2, pull.dt_s);
                if self.aiding.is_aided(self.settings.gap_s) {
                    self.low_pass_m_s2 = Complex::new(0.0, 0.0);
                } else {
                    self.coast(pull, axes, turn_rate_rad_s);
                    corrections.tilt = true;
                }
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.begin();
                self.started = true;
                corrections.aligned = true;
            }
            self.unlevelled_s = 0.0;
        }
        let fix = credible(input.fix.as_ref())
            .filter(|fix| fix.sd_m_s.is_none_or(|sd| sd <= self.settings.velocity_sd_max_m_s));
        if let (true, Some(fix)) = (self.started, fix) {
            let taken = self.take(fix);
            corrections = Corrections {
                tilt: corrections.tilt || taken.tilt,
                aligned: corrections.aligned || taken.aligned,
                ..taken
            };
        }
        self.feed_in(azimuth(self.attitude), dt_s);
        match (&input.motion, &input.inclination) {
            (Some(_), Some(inclination)) if input.rest_credible => {
                corrections.rest = self.stand(sensed_rad_s, inclination.force_m_s2, dt_s);
                corrections.bias |= corrections.rest;
            }
            _ => self.still.interrupt(),
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: sensed_rad_s - self.bias_rad_s,
            bias_rad_s: self.bias_rad_s,
            innovation_rad: innovation,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.unlevelled_s.visit(visit);
        self.bias_rad_s.visit(visit);
        self.bias_variance_rad2_s2.visit(visit);
        self.turn_rate_rad_s.visit(visit);
        self.aiding.visit(visit);
        self.pending_rad.visit(visit);
        self.low_pass_m_s2.visit(visit);
        self.lag_rad.visit(visit);
        self.drift_sd_rad.visit(visit);
        self.still.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let negative = self.bias_variance_rad2_s2 < 0.0 || self.drift_sd_rad < 0.0 || self.unlevelled_s < 0.0;
        attitude_flaw(self.attitude)
            .or(bias_flaw(self.bias_rad_s))
            .or(negative.then_some("a variance or a time below zero"))
            .or(self.aiding.flaw())
            .or(self.still.flaw())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            reference: self.reference(),
            bias_rad_s: self.bias_rad_s,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            bias_sd_rad_s: libm::sqrt(self.bias_variance_rad2_s2),
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        let mut adopted = Self { settings: self.settings, attitude: common.attitude, started: true, ..Self::default() };
        if common.bias_sd_rad_s.is_finite() {
            adopted.bias_rad_s = bounded(common.bias_rad_s, BIAS_MAX_RAD_S);
            let variance = common.bias_sd_rad_s * common.bias_sd_rad_s;
            adopted.bias_variance_rad2_s2 = variance.min(adopted.bias_variance_rad2_s2);
        }
        if common.reference == Reference::True {
            adopted.aiding.course_known = true;
            adopted.drift_sd_rad = common.heading_sd_rad.min(PI);
        }
        *self = adopted;
        Ok(())
    }
}
