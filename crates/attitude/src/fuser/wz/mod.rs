//! Fuser stage `wz`: second-order levelled low-pass with Möbius correction and estimated gyro
//! errors.
//!
//! Real accelerations last for seconds, but their mean over a movement is zero. The specific force
//! is therefore low-pass filtered without any gating. This is done in a horizontal frame, in which
//! gravity is constant. Per tick:
//!
//! 1. w is propagated exactly with the rate, from which gyro bias and scale error have been
//!    removed. At the same time the level is tilted by κ dt (`Level`).
//! 2. The horizontal part h of the force updates the leaky velocity V, with V' = h − V/T1. The tilt
//!    rate is κ = V/(g T1 T2).
//!
//! The transfer function from the accelerometer to the tilt is 1/(T1 T2 s² + T2 s + 1). The stage
//! extends the complementary filter of Matveev 2025, fig. 9, to second order. It replaces the "+"
//! of that filter by a Möbius map and moves its low-pass to the horizontal frame.
//!
//! | file | content |
//! | --- | --- |
//! | `level` | attitude and leaky velocity of the levelling loop |
//! | `time_constants` | time constant of the tilt, adapted to the motion |
//! | `gyro_errors` | Kalman filter of gyro bias and scale |
//! | `wide_bias` | second filter, for a large bias |
//! | `noise` | noise of the filter's measurements, from its innovations |
//! | `tilt_fault` | detection of a wrong level |
//! | `initial_velocity` | correction of an adopted leaky velocity |
//! | `heading` | heading from the magnetic field |
//! | `correction_smoothing` | gradual application of corrections |
//! | `reported_sd` | standard deviations of the output |

mod correction_smoothing;
mod gyro_errors;
mod heading;
mod initial_velocity;
mod level;
mod noise;
mod reported_sd;
mod settings;
mod tilt_fault;
mod time_constants;
mod wide_bias;

use core::f64::consts::PI;

use super::{
    estimate::Estimate,
    finite::fuser_items,
    fused::{Corrections, Fused},
    input::FuserInput,
    rest::{RestDetector, RestInput},
};

use crate::{
    Complex, Vector3,
    accel::MAX_PLAUSIBLE_FORCE_M_S2,
    parameters::{Parameter, Parameters, parameters_of},
    rotation::Rotation,
    scalars::visit_fields,
    stage::Stage,
};
pub(super) use settings::SHARED_WITH_AIDED;
use {
    gyro_errors::{GyroErrorFilter, UpdateInput, UpdateOutcome},
    heading::{Heading, HeadingInput},
    level::{Level, LoopError},
    settings::Settings,
    time_constants::MotionObservation,
    wide_bias::{UNKNOWN_BIAS_SD_RAD_S, WideBiasFilter},
};

/// Longest interval over which one rate sample may be integrated, s. The motion of a body over a
/// longer interval is unpredictable.
const MAX_INTEGRATION_INTERVAL_S: f64 = 0.1;

/// Fuser stage `wz`: levelled second-order low-pass with estimated gyro errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Wz {
    settings: Settings,
    level: Level,
    gyro_errors: GyroErrorFilter,
    wide_bias: WideBiasFilter,
    rest: RestDetector,
    heading: Heading,
    /// Duration of the last motion with a positive interval, s. A tick without a motion is assumed
    /// to have the same duration.
    last_interval_s: f64,
    /// Duration of the current gyro outage, s. It is limited to 1 s.
    gyro_outage_s: f64,
}

impl Default for Wz {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            level: Level::new(),
            gyro_errors: GyroErrorFilter::default(),
            wide_bias: WideBiasFilter::default(),
            rest: RestDetector::default(),
            heading: Heading::default(),
            last_interval_s: 0.0,
            gyro_outage_s: 0.0,
        }
    }
}

impl Wz {
    /// Table of the stage's parameters.
    pub(super) const PARAMETERS: &'static [Parameter] = Settings::TABLE;

    /// Returns the estimated hard iron in body axes, µT.
    ///
    /// If it exceeds 3 µT, the magnetometer should be calibrated.
    pub fn hard_iron_ut(&self) -> Vector3<f64> {
        self.heading.hard_iron().field_ut
    }

    /// Returns the estimated delay of the magnetometer relative to the gyro, s.
    pub fn magnetometer_delay_s(&self) -> f64 {
        self.heading.delay_s()
    }

    pub(super) fn realign(&mut self) {
        self.level.restart();
        self.gyro_errors.restart(true);
        self.wide_bias.restart();
        self.rest = RestDetector::default();
        self.heading.realign();
    }

    /// Returns the standard deviation of the tilt about one axis, rad.
    ///
    /// A bias that is suspected, but not removed, tilts the level by its horizontal part times T2.
    fn tilt_sd_rad(&self) -> f64 {
        let suspected_rad = self.wide_bias.suspected_rad_s() * self.level.t2_s();
        libm::hypot(self.gyro_errors.tilt_sd_rad(), suspected_rad).min(PI)
    }

    /// Returns the standard deviation of the heading, rad, before the allowances of `reported_sd`.
    ///
    /// The magnetic field shows the effect of a suspected bias about as late as the force does,
    /// after T2.
    fn heading_sd_rad(&self) -> f64 {
        let suspected_rad_s = self.wide_bias.suspected_rad_s();
        if suspected_rad_s == 0.0 {
            return self.heading.credible_sd_rad();
        }
        libm::hypot(self.heading.credible_sd_rad(), suspected_rad_s * self.level.t2_s()).min(PI)
    }

    /// Re-initialises the uncertainty of the level after a gyro outage. Bias and scale are kept.
    #[inline]
    fn reinit_after_outage(&mut self, gyro_outage_s: f64) {
        if gyro_outage_s > 0.0 {
            self.gyro_outage_s = (self.gyro_outage_s + gyro_outage_s).min(1.0);
        } else if core::mem::take(&mut self.gyro_outage_s) > MAX_INTEGRATION_INTERVAL_S {
            self.gyro_errors.restart(false);
            self.wide_bias.restart();
            self.level.reset_velocity();
            self.level.restart_time_constant();
        }
    }

    /// Returns the time within the tick during which the rotation was not observed, s.
    #[inline]
    fn tick_outage_s(&mut self, input: &FuserInput) -> f64 {
        let Some(motion) = &input.motion else { return self.last_interval_s };
        if motion.dt_s > 0.0 {
            self.last_interval_s = motion.dt_s.min(MAX_INTEGRATION_INTERVAL_S);
        }
        if input.rate_credible && motion.dt_s <= MAX_INTEGRATION_INTERVAL_S { 0.0 } else { motion.dt_s }
    }

    /// Updates the gyro errors and corrects the level. Returns `true` if the level jumps.
    #[inline(never)]
    fn update(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>) -> bool {
        let (interval_s, force_dt_m_s) = self.gyro_errors.accumulated();
        let tilt_correction_rad = self.level.take_tilt_correction(force_dt_m_s);
        let known_bias_rad_s = self.wide_bias.is_bias_known().then_some(self.gyro_errors.bias_rad_s());
        self.rest.update(&RestInput { force_m_s2, known_bias_rad_s, interval_s });
        let input = UpdateInput {
            rate_rad_s,
            tilt_correction_rad,
            bias_at_rest: self.rest.bias_rad_s(),
            loop_velocity_s: self.level.velocity_s(),
            t2_s: self.level.t2_s(),
        };
        let samples = self.gyro_errors.samples();
        let UpdateOutcome { mut error, acceleration, is_restarted } = self.gyro_errors.update(&input, &self.settings);
        if is_restarted {
            if input.bias_at_rest.is_some() || !self.wide_bias.explains(error.tilt) {
                self.wide_bias.restart();
            }
            self.level.restart_time_constant();
            if input.bias_at_rest.is_some() {
                self.heading.invalidate_at_rest();
            }
        }
        let found = self.wide_bias.update(&self.gyro_errors, &samples, &input, error.tilt, &self.settings);
        if let Some(found) = found {
            self.gyro_errors = found;
            let remaining = self.gyro_errors.take_over(input.loop_velocity_s - error.velocity);
            error = error + remaining;
            if known_bias_rad_s.is_some() {
                let up = self.level.attitude().up.direction();
                self.heading.invalidate_by_drift(self.gyro_errors.bias_sd_about(up));
            } else {
                self.heading.restart_after_drift(UNKNOWN_BIAS_SD_RAD_S, &self.settings);
                self.heading.expect_local_fields();
            }
        }
        error = error + self.observe_vertical_bias();
        self.level.adapt(&MotionObservation {
            acceleration,
            tilt_error_rad: self.gyro_errors.tilt_error_rad(),
            rate2_rad2_s2: rate_rad_s.norm_squared(),
            bias_sd_rad_s: self.gyro_errors.horizontal_bias_sd_rad_s(),
            interval_s,
        });
        self.level.apply_correction(error)
    }

    /// Corrects the bias about the vertical with the drift of the gyro heading.
    ///
    /// The force does not show this component of the bias. The correction applies only to a bias
    /// that was found in motion. Returns the error of the loop.
    fn observe_vertical_bias(&mut self) -> LoopError {
        if !self.gyro_errors.has_wide_prior() || self.wide_bias.is_bias_known() {
            return LoopError::default();
        }
        if self.gyro_errors.is_bias_known_about(self.level.attitude().up.direction()) {
            self.heading.accept_drift();
        }
        let observed = self.heading.drift().and_then(|drift| self.gyro_errors.observe_vertical_bias(&drift));
        let Some((change_rad_s, error)) = observed else { return LoopError::default() };
        self.heading.subtract_drift(change_rad_s);
        self.wide_bias.restart();
        error
    }

    /// Handles a large drift of the heading, which shows a large bias about the vertical.
    #[cold]
    fn search_vertical_bias(&mut self) {
        if self.gyro_errors.has_wide_prior() || self.wide_bias.is_bias_known() {
            return;
        }
        self.gyro_errors.widen_prior(UNKNOWN_BIAS_SD_RAD_S);
        self.heading.restart_after_drift(UNKNOWN_BIAS_SD_RAD_S, &self.settings);
    }

    #[inline(always)]
    pub(in crate::fuser) fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let (rotation, rate_rad_s, dt_s) = match &input.motion {
            Some(motion) => (motion.rotation, motion.rate_rad_s, motion.dt_s),
            None => (Rotation::IDENTITY, Vector3::zeros(), 0.0),
        };
        let gyro_outage_s = self.tick_outage_s(input);
        self.reinit_after_outage(gyro_outage_s);
        self.gyro_errors.add_outage(gyro_outage_s);
        let inclination =
            input.inclination.as_ref().filter(|inclination| inclination.norm_m_s2 <= MAX_PLAUSIBLE_FORCE_M_S2);
        let levelling = self.level.is_started() && inclination.is_some();
        let levelling_s = if levelling { dt_s } else { 0.0 };
        let axes = self.level.propagate(self.gyro_errors.corrected_rotation(rotation, dt_s), dt_s, levelling_s);
        self.gyro_errors.accumulate_drift(&axes, rotation, dt_s);

        let (mut innovation_rad, mut force_m_s2) = (0.0, Complex::new(0.0, 0.0));
        if let Some(inclination) = inclination {
            if levelling {
                let up_m_s2 = axes.up.dot(&inclination.force_m_s2);
                let horizontal_m_s2 = axes.horizontal(inclination.force_m_s2);
                innovation_rad = angle_rad(inclination.norm_m_s2, up_m_s2, horizontal_m_s2);
                force_m_s2 = self.level.corrected_force(horizontal_m_s2, up_m_s2);
                let force_dt_m_s = force_m_s2 * dt_s;
                self.level.update_velocity(force_dt_m_s, dt_s);
                self.gyro_errors.accumulate_force(force_dt_m_s, inclination.norm_m_s2, dt_s);
                self.rest.observe(rate_rad_s, input.field_ut, dt_s);
                corrections.tilt = true;
            } else {
                self.level.align(inclination.up);
                corrections.aligned = true;
            }
        }
        if !(levelling && input.motion.is_some() && input.rest_credible) {
            self.rest.interrupt();
        }
        if let (Some(inclination), true) = (inclination, self.gyro_errors.is_update_due()) {
            corrections.aligned |= self.update(rate_rad_s, inclination.force_m_s2);
            corrections.bias = true;
        }
        corrections.rest = self.rest.is_detected();
        let has_motion = input.motion.is_some();
        let rate_rad_s = if has_motion { self.gyro_errors.corrected_rate_rad_s(rate_rad_s) } else { Vector3::zeros() };
        let input = HeadingInput {
            attitude: self.level.attitude(),
            azimuth: self.level.azimuth(),
            rate_rad_s,
            horizontal_force_m_s2: force_m_s2,
            force_norm_m_s2: inclination.map(|inclination| inclination.norm_m_s2),
            scale_variance: self.gyro_errors.scale_variance(),
            vertical_bias_variance: self.gyro_errors.vertical_bias_variance(),
            field_ut: input.field_ut,
            at_rest: corrections.rest,
            dt_s,
            gyro_outage_s,
        };
        let heading_update = self.heading.step(&input, &self.settings);
        if heading_update.drifts {
            self.search_vertical_bias();
        }
        corrections.magnetic = heading_update.magnetic;
        corrections.aligned |= heading_update.aligned;
        corrections.disturbed = self.heading.is_disturbed();
        Fused {
            attitude: self.heading.with_heading(self.level.attitude()),
            rate_rad_s,
            bias_rad_s: self.gyro_errors.bias_rad_s(),
            innovation_rad,
            inclination_sd_rad: reported_sd::inclination_sd_rad(
                self.tilt_sd_rad(),
                rate_rad_s.norm_squared(),
                &self.settings,
            ),
            heading_sd_rad: reported_sd::heading_sd_rad(self.heading_sd_rad()),
            reference: self.heading.reference(),
            corrections,
        }
    }

    pub(in crate::fuser) fn continue_from(&mut self, common: &Estimate) {
        self.heading = Heading::from_estimate(&self.settings, common);
        self.level = Level::from_attitude(common.attitude, common.leaky_velocity.initial_m_s());
        self.gyro_errors = GyroErrorFilter::from_estimate(common);
        self.wide_bias = WideBiasFilter::after_hand_over(common.bias_sd_rad_s.is_finite());
        self.rest = RestDetector::default();
    }
}

impl Stage for Wz {
    fuser_items!();

    fn name(&self) -> &'static str {
        "wz"
    }

    parameters_of!(Settings in settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            level, gyro_errors, wide_bias, rest, heading, last_interval_s, gyro_outage_s; without settings
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        let interval = (self.last_interval_s < 0.0 || self.gyro_outage_s < 0.0).then_some("an interval below zero");
        let parts = self
            .level
            .validation_error()
            .or_else(|| self.gyro_errors.validation_error())
            .or_else(|| self.wide_bias.validation_error())
            .or_else(|| self.rest.validation_error());
        parts.or_else(|| self.heading.validation_error()).or(interval)
    }

    fn common(&self) -> Estimate {
        let attitude = self.heading.with_heading(self.level.attitude());
        Estimate {
            attitude,
            reference: self.heading.reference(),
            bias_rad_s: self.gyro_errors.bias_rad_s(),
            inclination_sd_rad: self.tilt_sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            bias_sd_rad_s: self.gyro_errors.bias_sd_rad_s(),
            gyro_scale: self.gyro_errors.scale(),
            hard_iron: self.heading.hard_iron(),
            leaky_velocity: self.level.leaky_velocity(attitude.z_rad, self.gyro_errors.initial_velocity_sd_m_s()),
        }
    }
}

/// Returns the angle between the up vectors of accelerometer and attitude, rad.
///
/// The force is given by its norm and its vertical and horizontal parts. A series in the chord is
/// used, with a relative error of 1e-3 up to 60° and 1 % up to 90°.
#[inline]
fn angle_rad(norm_m_s2: f64, up_m_s2: f64, horizontal_m_s2: Complex<f64>) -> f64 {
    // Square of the chord: 2 (1 − cos) = 2 sin²/(1 + cos). It is 4 for opposite vectors.
    let below = (norm_m_s2 * (norm_m_s2 + up_m_s2)).max(f64::MIN_POSITIVE);
    let chord2 = (2.0 * horizontal_m_s2.norm_sqr() / below).min(4.0);
    libm::sqrt(chord2) * (1.0 + chord2 * (1.0 / 24.0 + chord2 * (3.0 / 640.0)))
}
