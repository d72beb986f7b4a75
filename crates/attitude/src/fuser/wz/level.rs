//! Attitude and leaky velocity of the levelling loop.
//!
//! Horizontal quantities are kept in the frame of fixed azimuth, which is the level frame rotated
//! back by z. Rotations about the vertical leave this frame unchanged. It differs from the
//! reference frame only by the azimuth at the start.

use core::ops::{Add, Mul, Sub};

use super::{
    correction_smoothing,
    time_constants::{MotionObservation, T1_S, TiltTimeConstant},
};
use crate::{
    Complex, GRAVITY_M_S2,
    fuser::leaky_velocity::LeakyVelocity,
    point::Point,
    rotation::Rotation,
    scalars::scalars,
    stage::attitude_validation_error,
    state::{Attitude, AttitudeUpdate, BodyAxes},
};

/// Largest correction that is applied gradually, rad (0.5°). A larger one is a flagged jump.
const MAX_SMOOTHED_RAD: f64 = 0.008_726_646;

/// State of the levelling loop.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    attitude: Attitude,
    /// e^{jz}, the rotation from the level frame to the frame of fixed azimuth.
    azimuth: Complex<f64>,
    velocity_m_s: Complex<f64>,
    /// Velocity at the last [`Level::take_tilt_correction`].
    last_velocity_m_s: Complex<f64>,
    /// Known tilt error in the frame of fixed azimuth that is still to be corrected, rad.
    pending_rad: Complex<f64>,
    started: bool,
    time_constant: TiltTimeConstant,
}

/// Error of the levelling loop: tilt error and velocity error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct LoopError {
    /// Tilt error, rad. It equals the horizontal force that it causes, divided by g.
    pub(super) tilt: Complex<f64>,
    /// Velocity error divided by g, s.
    pub(super) velocity: Complex<f64>,
}

impl core::ops::Add for LoopError {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { tilt: self.tilt + other.tilt, velocity: self.velocity + other.velocity }
    }
}

/// Evolution of the loop's error over an interval: E' = −W/(T1 T2), W' = E − W/T1. E is the tilt
/// error, and W is the velocity error divided by g.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LoopResponse {
    c0: f64,
    c1: f64,
    /// Stiffness of the loop, 1/(T1 T2), 1/s².
    stiffness: f64,
}

impl LoopResponse {
    const DECAY: f64 = 1.0 / T1_S;

    /// Computes e^{At} = c0 + c1 A (Cayley–Hamilton theorem), to third order in t. A is the system
    /// matrix of the loop's error, and t is the interval.
    pub(super) fn new(interval_s: f64, t2_s: f64) -> Self {
        const B: f64 = LoopResponse::DECAY;
        let (t, a) = (interval_s, 1.0 / (T1_S * t2_s));
        let c0 = 1.0 - t * t * (a / 2.0 - t * (a * B / 6.0));
        let c1 = t * (1.0 - t * (B / 2.0 - t * ((B * B - a) / 6.0)));
        Self { c0, c1, stiffness: a }
    }

    /// Returns the tilt error and the velocity error at the end of the interval.
    ///
    /// The velocity error is divided by g.
    pub(super) fn apply<T>(self, tilt: T, velocity: T) -> [T; 2]
    where
        T: Copy + Mul<f64, Output = T> + Add<Output = T> + Sub<Output = T>,
    {
        let Self { c0, c1, stiffness } = self;
        [tilt * c0 - velocity * (stiffness * c1), tilt * c1 + velocity * (c0 - Self::DECAY * c1)]
    }
}

impl Level {
    /// Creates a level that waits for the first inclination.
    pub(super) fn new() -> Self {
        Self { started: false, ..Self::from_attitude(Attitude::default(), Complex::new(0.0, 0.0)) }
    }

    /// Creates a level from an attitude and the leaky velocity of the previous loop.
    pub(super) fn from_attitude(attitude: Attitude, velocity_m_s: Complex<f64>) -> Self {
        let (sin, cos) = libm::sincos(attitude.z_rad);
        let zero = Complex::new(0.0, 0.0);
        Self {
            attitude,
            azimuth: Complex::new(cos, sin),
            velocity_m_s,
            last_velocity_m_s: velocity_m_s,
            pending_rad: zero,
            started: true,
            time_constant: TiltTimeConstant::default(),
        }
    }

    pub(super) fn attitude(&self) -> Attitude {
        self.attitude
    }

    /// Returns e^{jz}, the rotation from the level frame to the frame of fixed azimuth.
    #[inline]
    pub(super) fn azimuth(&self) -> Complex<f64> {
        self.azimuth
    }

    /// Returns the leaky velocity for an attitude with heading `z_rad`.
    ///
    /// `remaining_sd_m_s` is the standard deviation of the error that remains from the loop's
    /// initial velocity.
    pub(super) fn leaky_velocity(&self, z_rad: f64, remaining_sd_m_s: f64) -> LeakyVelocity {
        if !self.started {
            return LeakyVelocity::UNKNOWN;
        }
        LeakyVelocity::from_loop(self.velocity_m_s * self.azimuth.conj(), remaining_sd_m_s).rotated(z_rad)
    }

    /// Returns the leaky velocity divided by g, s.
    pub(super) fn velocity_s(&self) -> Complex<f64> {
        self.velocity_m_s / GRAVITY_M_S2
    }

    /// Returns the time constant of the tilt, s.
    pub(super) fn t2_s(&self) -> f64 {
        self.time_constant.t2_s()
    }

    /// Returns the factor from the leaky velocity (m/s) to half the tilt rate (rad/s).
    #[inline]
    fn half_tilt_rate_per_velocity(&self) -> f64 {
        0.5 / (GRAVITY_M_S2 * T1_S * self.time_constant.t2_s())
    }

    /// Resets the time constant of the tilt, because the level is uncertain.
    pub(super) fn restart_time_constant(&mut self) {
        self.time_constant = TiltTimeConstant::default();
    }

    /// Adapts the time constant of the tilt to the motion (see `time_constants`).
    pub(super) fn adapt(&mut self, observation: &MotionObservation) {
        self.time_constant.update(observation);
    }

    /// Returns `true` once an inclination has set the level.
    pub(super) fn is_started(&self) -> bool {
        self.started
    }

    /// Clears the velocity, because it was integrated on another level.
    #[cold]
    pub(super) fn reset_velocity(&mut self) {
        (self.velocity_m_s, self.last_velocity_m_s) = (Complex::new(0.0, 0.0), Complex::new(0.0, 0.0));
    }

    /// Makes the next inclination re-initialise the level.
    pub(super) fn restart(&mut self) {
        *self = Self { started: false, ..Self::from_attitude(self.attitude, Complex::new(0.0, 0.0)) };
    }

    /// Rotates the body over `dt_s` and tilts the level by the leaky velocity and the pending
    /// correction.
    ///
    /// The leaky velocity acts for `levelling_s`. Returns the body axes in the frame of fixed
    /// azimuth.
    #[inline]
    pub(super) fn propagate(&mut self, rotation: Rotation, dt_s: f64, levelling_s: f64) -> BodyAxes {
        let smoothed_rad = self.pending_rad * correction_smoothing::fraction(self.pending_rad.norm_sqr(), dt_s);
        self.pending_rad -= smoothed_rad;
        let tilt = smoothed_rad * 0.5 + self.velocity_m_s * (self.half_tilt_rate_per_velocity() * levelling_s);
        self.attitude.rotate_and_tilt(rotation, tilt * self.azimuth.conj(), &mut self.azimuth)
    }

    /// Returns the horizontal force with the pending tilt correction applied. `up_m_s2` is the
    /// vertical force.
    #[inline]
    pub(super) fn corrected_force(&self, horizontal_m_s2: Complex<f64>, up_m_s2: f64) -> Complex<f64> {
        horizontal_m_s2 - self.pending_rad * up_m_s2
    }

    /// Applies the shortest rotation of the level that makes `up` vertical.
    #[cold]
    pub(super) fn align(&mut self, up: Point) {
        self.set_attitude(self.attitude.realigned(up));
        self.started = true;
    }

    /// Updates the leaky velocity, V' = h − V/T1, with `force_dt_m_s` = h dt.
    #[inline]
    pub(super) fn update_velocity(&mut self, force_dt_m_s: Complex<f64>, dt_s: f64) {
        self.velocity_m_s = self.velocity_m_s * (1.0 - dt_s * (1.0 / T1_S)) + force_dt_m_s;
    }

    /// Returns the tilt applied by the leaky velocity since the last call, rad.
    ///
    /// The tilt follows from the integral of V, which is T1 (∫h dt − ΔV). The call also normalises
    /// the azimuth.
    pub(super) fn take_tilt_correction(&mut self, force_dt_m_s: Complex<f64>) -> Complex<f64> {
        self.azimuth *= 1.5 - 0.5 * self.azimuth.norm_sqr();
        let change_m_s = self.velocity_m_s - self.last_velocity_m_s;
        self.last_velocity_m_s = self.velocity_m_s;
        (force_dt_m_s - change_m_s) * (2.0 * self.half_tilt_rate_per_velocity() * T1_S)
    }

    /// Corrects a known error of the loop. Returns `true` if the level jumps.
    ///
    /// The velocity is corrected immediately. The tilt is corrected gradually, or immediately if
    /// its error is too large.
    pub(super) fn apply_correction(&mut self, error: LoopError) -> bool {
        self.velocity_m_s -= error.velocity * GRAVITY_M_S2;
        self.last_velocity_m_s = self.velocity_m_s;
        self.pending_rad += error.tilt;
        let jumps = self.pending_rad.norm_sqr() > MAX_SMOOTHED_RAD * MAX_SMOOTHED_RAD;
        if jumps {
            let tilt = core::mem::take(&mut self.pending_rad) * 0.5;
            self.set_attitude(self.attitude.tilted(tilt * self.azimuth.conj()));
        }
        jumps
    }

    fn set_attitude(&mut self, update: AttitudeUpdate) {
        self.attitude = update.attitude;
        self.azimuth *= update.level_frame_rotation.conj();
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let (sin, cos) = libm::sincos(self.attitude.z_rad);
        let mismatch = (self.azimuth - Complex::new(cos, sin)).norm_sqr();
        attitude_validation_error(self.attitude)
            .or((mismatch > 1e-6).then_some("an azimuth that does not match the attitude"))
            .or_else(|| self.time_constant.validation_error())
    }
}

scalars!(LoopError: tilt, velocity);

scalars!(Level: attitude, azimuth, velocity_m_s, last_velocity_m_s, pending_rad, started, time_constant);
