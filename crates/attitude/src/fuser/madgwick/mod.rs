//! Gradient descent on the quaternion: the fusers `madgwick` and `madgwick-improved`.
//!
//! Madgwick's filter steps against the gradient of the squared difference between what a reference direction should look like in
//! body axes and what the sensor sees, normalised, so that the size of the step tells nothing of the size of the error. The improved
//! form leaves the gradient as it is and takes it where the gyro has led:
//!
//! - original: q(t) = q_g(t) − β dt ∇F(q(t−1))/|∇F|
//! - improved: q(t) = q_g(t) − β dt ∇F(q_g(t))
//!
//! F = q* ⊗ (0, d) ⊗ q − (0, s), ∇F = Jᵀ F — Improved orientation of a UAV by a MEMS inertial system on the basis of the Madgwick
//! filter, (1)–(4). With v = q* d q the gradient is 2 q ⊗ (|v|² − v·s, v × s), and of two directions the sum of both.
//!
//! d is ζ0 for the specific force. For the magnetic field it is (0, b_η, b_ζ) with the horizontal and vertical part of the field as
//! the last estimate sees it, so that no map of the field is needed and η0 is magnetic north — Madgwick, *An efficient orientation
//! filter for inertial and inertial/magnetic sensor arrays*, 2010, (45), (46).
//!
//! Here q_g is q(t−1) after the exact turn of the gyro slot. The paper's (1), one step of Euler, is that turn but for its third order.

mod gradient;

use super::{
    carried::Carried,
    estimate::Estimate,
    field::{field_direction, north_rad},
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    leaky_velocity::LeakyVelocity,
    spread::{BIAS_SD_RAD_S, Spread},
};
use crate::{
    Quaternion, Vector3,
    course::Reference,
    gyro::Motion,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    stage::{RestoreError, Stage},
    state::Attitude,
};
use gradient::{Seen, normalized};

/// Largest β dt of the improved form: beyond it a step overshoots the minimum of two directions at right angles to its axis.
const STEP_MAX: f64 = 0.125;

settings! {
    /// Settings of `madgwick`.
    pub struct OriginalSettings {
        /// Speed of the quaternion against the normalised gradient; half of that of the attitude.
        beta_rad_s: 0.08 in 0.0 .. 10.0, "rad/s";
    }
}

settings! {
    /// Settings of `madgwick-improved`.
    pub struct ImprovedSettings {
        /// Speed of the quaternion for a gradient of 1; a tilt is taken off with a time constant of 1/(4 β).
        beta_1_s: 0.2 in 0.0 .. 10.0, "1/s";
    }
}

/// How far to step against the gradient, and where it is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Descent {
    Original(OriginalSettings),
    Improved(ImprovedSettings),
}

/// A fuser by gradient descent: `madgwick` or `madgwick-improved`.
///
/// The defaults are the best gains on the ten trials of BROAD. The paper's own (0.021 rad/s and 0.029 1/s) are the best of its
/// simulation, whose gyro has no bias; a gain that low needs minutes to forget a wrong beginning.
#[derive(Debug, Clone, PartialEq)]
pub struct Madgwick {
    descent: Descent,
    quaternion: Quaternion<f64>,
    levelled: bool,
    magnetic: bool,
    /// Since the last field, s.
    since_field_s: f64,
    tilt: Spread,
    heading: Spread,
    carried: Carried,
}

impl Madgwick {
    /// `madgwick`.
    pub fn original() -> Self {
        Self::by(Descent::Original(OriginalSettings::default()))
    }

    /// `madgwick-improved`.
    pub fn improved() -> Self {
        Self::by(Descent::Improved(ImprovedSettings::default()))
    }

    fn by(descent: Descent) -> Self {
        Self {
            descent,
            quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0),
            levelled: false,
            magnetic: false,
            since_field_s: 0.0,
            tilt: Spread::UNKNOWN,
            heading: Spread::UNKNOWN,
            carried: Carried::default(),
        }
    }

    pub(super) fn realign(&mut self) {
        self.levelled = false;
    }

    /// One interval: the gyro's turn, then a step against the gradient of the directions that are there.
    fn descend(&mut self, motion: &Motion, seen: &Seen) {
        let before = self.quaternion;
        let led = before * motion.turn.quaternion();
        let next = match self.descent {
            Descent::Original(settings) => {
                let step = settings.beta_rad_s * motion.dt_s;
                normalized(seen.gradient(before, 1.0)).map_or(led, |gradient| led - gradient * step)
            }
            Descent::Improved(settings) => {
                let step = |interval_s: f64| (settings.beta_1_s * interval_s).min(STEP_MAX);
                let (step, field_step) = (step(motion.dt_s), step(self.since_field_s));
                // A field that comes at every n-th tick only counts n times.
                let weight = if step > 0.0 { field_step / step } else { 1.0 };
                led - seen.gradient(led, weight) * step
            }
        };
        self.quaternion = normalized(next).unwrap_or(before);
    }

    /// The share of an error that one interval takes off.
    fn gain(&self, spread: &Spread, dt_s: f64) -> f64 {
        match self.descent {
            // The attitude turns by 2 β dt whatever the error.
            Descent::Original(settings) => {
                let turned_rad = 2.0 * settings.beta_rad_s * dt_s;
                turned_rad / (turned_rad + spread.innovation_rms_rad())
            }
            Descent::Improved(settings) => 4.0 * (settings.beta_1_s * dt_s).min(STEP_MAX),
        }
    }

    fn level(&mut self, up: Point) {
        self.quaternion = Attitude::of_quaternion(self.quaternion).realigned(up).attitude.quaternion();
        self.levelled = true;
        self.tilt = Spread::FIRST;
    }

    fn set_heading(&mut self, field: Vector3<f64>) {
        let attitude = Attitude::of_quaternion(self.quaternion);
        let z_rad = attitude.z_rad + north_rad(attitude, field);
        self.quaternion = Attitude { z_rad, ..attitude }.quaternion();
        self.magnetic = true;
        self.since_field_s = 0.0;
        self.heading = Spread::FIRST;
    }

    fn reference(&self) -> Reference {
        if self.magnetic { Reference::Magnetic } else { Reference::Arbitrary }
    }
}

impl Stage for Madgwick {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

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

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        self.carried.observe(input);
        let field = input.field_ut.and_then(field_direction);
        let seen = Seen {
            up: input.inclination.filter(|_| self.levelled).map(|inclination| inclination.up.direction()),
            field: field.filter(|_| self.levelled && self.magnetic),
        };
        let mut innovation = 0.0;
        if let Some(motion) = &input.motion {
            let led = Attitude::of_quaternion(self.quaternion * motion.turn.quaternion());
            self.since_field_s += motion.dt_s;
            self.descend(motion, &seen);
            self.tilt.drift(BIAS_SD_RAD_S, motion.dt_s);
            self.heading.drift(BIAS_SD_RAD_S, motion.dt_s);
            if let (Some(inclination), Some(_)) = (&input.inclination, seen.up) {
                innovation = innovation_rad(inclination, led);
                self.tilt.corrected(innovation, self.gain(&self.tilt, motion.dt_s), motion.dt_s);
                corrections.tilt = true;
            }
            if let Some(field) = seen.field {
                let off_rad = north_rad(led, field);
                // The steeper the field, the less of its direction is heading.
                let gain = self.gain(&self.heading, self.since_field_s) * led.horizontal(field).norm_sqr();
                self.heading.corrected(off_rad, gain, self.since_field_s);
                self.since_field_s = 0.0;
                corrections.magnetic = true;
            }
        }
        if let (false, Some(inclination)) = (self.levelled, &input.inclination) {
            self.level(inclination.up);
            corrections.aligned = true;
        }
        if let (true, false, Some(field)) = (self.levelled, self.magnetic, field) {
            self.set_heading(field);
            corrections.aligned = true;
        }
        Fused {
            attitude: Attitude::of_quaternion(self.quaternion),
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.quaternion.visit(visit);
        self.levelled.visit(visit);
        self.magnetic.visit(visit);
        self.since_field_s.visit(visit);
        self.tilt.visit(visit);
        self.heading.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let off = libm::fabs(self.quaternion.norm_squared() - 1.0);
        let length = (off > 1e-6).then_some("a quaternion that is not of unit length");
        let time = (self.since_field_s < 0.0).then_some("a time below zero");
        length.or(time).or_else(|| self.tilt.flaw()).or_else(|| self.heading.flaw()).or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: Attitude::of_quaternion(self.quaternion),
            reference: self.reference(),
            bias_rad_s,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            bias_sd_rad_s,
            gyro_scale: self.carried.gyro_scale(),
            hard_iron: self.carried.hard_iron(),
            leaky_velocity: LeakyVelocity::UNKNOWN,
        }
    }

    /// A heading from true north is kept until the next field, which sets it anew.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.quaternion = common.attitude.quaternion();
        self.levelled = true;
        self.magnetic = common.reference == Reference::Magnetic;
        self.tilt = Spread::of(common.inclination_sd_rad);
        self.heading = Spread::of(common.heading_sd_rad);
        self.carried = Carried::of(common);
        Ok(())
    }
}
