//! Fusers `madgwick` and `madgwick-improved`: gradient descent on the quaternion.
//!
//! Madgwick's filter steps against the gradient of the squared difference between the expected and
//! the measured direction of a reference vector in body axes. The original form normalises the
//! gradient, so the size of the step is independent of the size of the error. The improved form
//! keeps the gradient as it is and evaluates it at the attitude predicted by the gyro:
//!
//! - original: q(t) = q_g(t) − β dt ∇F(q(t−1))/|∇F|
//! - improved: q(t) = q_g(t) − β dt ∇F(q_g(t))
//!
//! F = q* ⊗ (0, d) ⊗ q − (0, s), ∇F = Jᵀ F, with the expected direction d in the reference frame,
//! the measured direction s in body axes and the Jacobian J of F — Improved orientation of a UAV by
//! a MEMS inertial system on the basis of the Madgwick filter, (1)–(4). With v = q* d q the
//! gradient is 2 q ⊗ (|v|² − v·s, v × s). For two directions it is the sum of both gradients.
//!
//! For the specific force, d is ζ0. For the magnetic field, d is (0, b_η, b_ζ), where b_η and b_ζ
//! are the horizontal and the vertical part of the magnetic field in the frame of the last
//! estimate. No map of the magnetic field is needed, and η0 is magnetic north — Madgwick, *An
//! efficient orientation filter for inertial and inertial/magnetic sensor arrays*, 2010, (45),
//! (46).
//!
//! Here q_g is q(t−1) after the exact rotation from the gyro slot. The paper's (1), a single Euler
//! step, differs from it only in third order.

mod gradient;

use super::{
    angle_uncertainty::{ASSUMED_BIAS_SD_RAD_S, AngleUncertainty},
    bias_handover::HandedOverBias,
    estimate::Estimate,
    field::{field_direction, heading_correction_rad},
    finite::fuser_items,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
};
use crate::{
    Quaternion, Vector3,
    course::CourseReference,
    gyro::Motion,
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    scalars::visit_fields,
    stage::Stage,
    state::Attitude,
};
use gradient::{ReferenceDirections, normalized};

/// Largest β dt of the improved form. A larger step overshoots the minimum if both reference
/// directions, up and magnetic field, are at right angles to the axis of the step.
const MAX_STEP: f64 = 0.125;

settings! {
    /// Settings of `madgwick`.
    pub struct OriginalSettings {
        /// Rate at which the quaternion moves against the normalised gradient. The attitude rotates
        /// at twice this rate.
        beta_rad_s: 0.08 in 0.0 .. 10.0, "rad/s";
    }
}

settings! {
    /// Settings of `madgwick-improved`.
    pub struct ImprovedSettings {
        /// Rate at which the quaternion moves for a gradient of 1. A tilt error decays with the
        /// time constant 1/(4 β).
        beta_1_s: 0.2 in 0.0 .. 10.0, "1/s";
    }
}

/// Kind of gradient step.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Descent {
    Original(OriginalSettings),
    Improved(ImprovedSettings),
}

/// Fuser stage `madgwick` or `madgwick-improved`: gradient descent on the quaternion.
///
/// The defaults are the best gains on the ten trials of BROAD. The paper's own gains (0.021 rad/s
/// and 0.029 1/s) are the best in its simulation, whose gyro has no bias. With gains that low, the
/// error of a wrong initial attitude takes minutes to decay.
#[derive(Debug, Clone, PartialEq)]
pub struct Madgwick {
    descent: Descent,
    quaternion: Quaternion<f64>,
    levelled: bool,
    magnetic: bool,
    /// Time since the last magnetic field sample, s.
    since_field_s: f64,
    tilt: AngleUncertainty,
    heading: AngleUncertainty,
    bias_handover: HandedOverBias,
}

impl Madgwick {
    /// Creates the stage `madgwick`.
    pub fn original() -> Self {
        Self::with_descent(Descent::Original(OriginalSettings::default()))
    }

    /// Creates the stage `madgwick-improved`.
    pub fn improved() -> Self {
        Self::with_descent(Descent::Improved(ImprovedSettings::default()))
    }

    fn with_descent(descent: Descent) -> Self {
        Self {
            descent,
            quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0),
            levelled: false,
            magnetic: false,
            since_field_s: 0.0,
            tilt: AngleUncertainty::UNKNOWN,
            heading: AngleUncertainty::UNKNOWN,
            bias_handover: HandedOverBias::default(),
        }
    }

    pub(super) fn realign(&mut self) {
        self.levelled = false;
    }

    /// Applies the gyro rotation of one interval, then one step of gradient descent towards the
    /// given directions.
    fn descend(&mut self, motion: &Motion, directions: &ReferenceDirections) {
        let previous = self.quaternion;
        let predicted = previous * motion.rotation.quaternion();
        let next = match self.descent {
            Descent::Original(settings) => {
                let step = settings.beta_rad_s * motion.dt_s;
                normalized(directions.gradient(previous, 1.0)).map_or(predicted, |gradient| predicted - gradient * step)
            }
            Descent::Improved(settings) => {
                let step = |interval_s: f64| (settings.beta_1_s * interval_s).min(MAX_STEP);
                let (step, field_step) = (step(motion.dt_s), step(self.since_field_s));
                // A magnetic field that arrives only at every nth tick gets n times the weight.
                let weight = if step > 0.0 { field_step / step } else { 1.0 };
                predicted - directions.gradient(predicted, weight) * step
            }
        };
        self.quaternion = normalized(next).unwrap_or(previous);
    }

    /// Returns the fraction of an angle error that is corrected in an interval of `dt_s`.
    fn gain(&self, uncertainty: &AngleUncertainty, dt_s: f64) -> f64 {
        match self.descent {
            // The attitude rotates by 2 β dt, however large the error is.
            Descent::Original(settings) => {
                let rotation_rad = 2.0 * settings.beta_rad_s * dt_s;
                rotation_rad / (rotation_rad + uncertainty.innovation_rms_rad())
            }
            Descent::Improved(settings) => 4.0 * (settings.beta_1_s * dt_s).min(MAX_STEP),
        }
    }

    fn align_level(&mut self, up: Point) {
        self.quaternion = Attitude::from_quaternion(self.quaternion).realigned(up).attitude.quaternion();
        self.levelled = true;
        self.tilt = AngleUncertainty::INITIAL;
    }

    fn set_heading(&mut self, field: Vector3<f64>) {
        let attitude = Attitude::from_quaternion(self.quaternion);
        let z_rad = attitude.z_rad + heading_correction_rad(attitude, field);
        self.quaternion = Attitude { z_rad, ..attitude }.quaternion();
        self.magnetic = true;
        self.since_field_s = 0.0;
        self.heading = AngleUncertainty::INITIAL;
    }

    fn reference(&self) -> CourseReference {
        if self.magnetic { CourseReference::Magnetic } else { CourseReference::Arbitrary }
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        self.bias_handover.observe(input);
        let field = input.field_ut.and_then(field_direction);
        let directions = ReferenceDirections {
            up: input.inclination.filter(|_| self.levelled).map(|inclination| inclination.up.direction()),
            field: field.filter(|_| self.levelled && self.magnetic),
        };
        let mut innovation = 0.0;
        if let Some(motion) = &input.motion {
            let predicted = Attitude::from_quaternion(self.quaternion * motion.rotation.quaternion());
            self.since_field_s += motion.dt_s;
            self.descend(motion, &directions);
            self.tilt.drift(ASSUMED_BIAS_SD_RAD_S, motion.dt_s);
            self.heading.drift(ASSUMED_BIAS_SD_RAD_S, motion.dt_s);
            if let (Some(inclination), Some(_)) = (&input.inclination, directions.up) {
                innovation = innovation_rad(inclination, predicted);
                self.tilt.record_correction(innovation, self.gain(&self.tilt, motion.dt_s), motion.dt_s);
                corrections.tilt = true;
            }
            if let Some(field) = directions.field {
                let error_rad = heading_correction_rad(predicted, field);
                // The steeper the magnetic field, the less its direction depends on the heading, so
                // the gain is reduced.
                let gain = self.gain(&self.heading, self.since_field_s) * predicted.horizontal(field).norm_sqr();
                self.heading.record_correction(error_rad, gain, self.since_field_s);
                self.since_field_s = 0.0;
                corrections.magnetic = true;
            }
        }
        if let (false, Some(inclination)) = (self.levelled, &input.inclination) {
            self.align_level(inclination.up);
            corrections.aligned = true;
        }
        if let (true, false, Some(field)) = (self.levelled, self.magnetic, field) {
            self.set_heading(field);
            corrections.aligned = true;
        }
        Fused {
            attitude: Attitude::from_quaternion(self.quaternion),
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    /// Continues from the handed-over state. A heading that refers to true north is kept until the
    /// next magnetic field sample, which resets it.
    fn continue_from(&mut self, common: &Estimate) {
        self.quaternion = common.attitude.quaternion();
        self.levelled = true;
        self.magnetic = common.reference == CourseReference::Magnetic;
        self.tilt = AngleUncertainty::from_sd(common.inclination_sd_rad);
        self.heading = AngleUncertainty::from_sd(common.heading_sd_rad);
        self.bias_handover = HandedOverBias::from_estimate(common);
    }
}

impl Stage for Madgwick {
    fuser_items!();

    fn name(&self) -> &'static str {
        match self.descent {
            Descent::Original(_) => "madgwick",
            Descent::Improved(_) => "madgwick-improved",
        }
    }

    fn parameters(&self) -> &'static [Parameter] {
        match self.descent {
            Descent::Original(_) => OriginalSettings::TABLE,
            Descent::Improved(_) => ImprovedSettings::TABLE,
        }
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        match &mut self.descent {
            Descent::Original(settings) => settings.set(name, value),
            Descent::Improved(settings) => settings.set(name, value),
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            quaternion, levelled, magnetic, since_field_s, tilt, heading, bias_handover; without descent
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        let deviation = libm::fabs(self.quaternion.norm_squared() - 1.0);
        let length = (deviation > 1e-6).then_some("a quaternion that is not of unit length");
        let time = (self.since_field_s < 0.0).then_some("a negative time");
        length
            .or(time)
            .or_else(|| self.tilt.validation_error())
            .or_else(|| self.heading.validation_error())
            .or_else(|| self.bias_handover.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: Attitude::from_quaternion(self.quaternion),
            reference: self.reference(),
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            ..self.bias_handover.sensor_errors()
        }
    }
}
