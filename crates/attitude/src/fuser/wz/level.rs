//! The level: the attitude, and the leaky velocity by which it leans.
//!
//! What is horizontal is kept in the frame of fixed azimuth: the level frame turned back by z, so that turns about the vertical
//! leave it where it is. It is one with the reference frame but for the azimuth at which it began.

use core::ops::{Add, Mul, Sub};

use super::{
    ease,
    time_constants::{T1_S, T2_S},
};
use crate::{
    Complex, GRAVITY_M_S2,
    fuser::leaky_velocity::LeakyVelocity,
    numbers::Numbers,
    point::Point,
    stage::attitude_flaw,
    state::{Attitude, Axes, Moved},
    turn::Turn,
};

/// From the velocity, m/s, to half the tilt rate, rad/s.
const HALF_TILT_RATE: f64 = 0.5 / (GRAVITY_M_S2 * T1_S * T2_S);

/// More is not taken back by and by, rad: 0.5°.
const JUMP_RAD: f64 = 0.008_726_646;

/// The attitude and the velocity of the levelling loop.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    attitude: Attitude,
    /// e^{jz}: takes what is in the level frame to the frame of fixed azimuth.
    azimuth: Complex<f64>,
    velocity_m_s: Complex<f64>,
    /// At the last [`Level::take_leaned`].
    velocity_before_m_s: Complex<f64>,
    /// What is known of the tilt and not yet taken back, rad, in the frame of fixed azimuth.
    left_rad: Complex<f64>,
    started: bool,
}

/// A tilt error and the velocity that goes with it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Error {
    /// rad: the horizontal force it causes, over g.
    pub(super) tilt: Complex<f64>,
    /// Over g, s.
    pub(super) velocity: Complex<f64>,
}

/// What the loop makes of its own error over an interval: E' = −W/(T1 T2), W' = E − W/T1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Response {
    c0: f64,
    c1: f64,
}

impl Response {
    const A: f64 = 1.0 / (T1_S * T2_S);
    const B: f64 = 1.0 / T1_S;

    /// e^{At} by Cayley and Hamilton, to the third order.
    pub(super) fn over(interval_s: f64) -> Self {
        const A: f64 = Response::A;
        const B: f64 = Response::B;
        let t = interval_s;
        let c0 = 1.0 - t * t * (A / 2.0 - t * (A * B / 6.0));
        let c1 = t * (1.0 - t * (B / 2.0 - t * ((B * B - A) / 6.0)));
        Self { c0, c1 }
    }

    /// A tilt and a velocity over g, after the interval.
    pub(super) fn after<T>(self, tilt: T, velocity: T) -> [T; 2]
    where
        T: Copy + Mul<f64, Output = T> + Add<Output = T> + Sub<Output = T>,
    {
        let Self { c0, c1 } = self;
        [tilt * c0 - velocity * (Self::A * c1), tilt * c1 + velocity * (c0 - Self::B * c1)]
    }
}

impl Level {
    /// Waits for the first inclination.
    pub(super) fn new() -> Self {
        Self { started: false, ..Self::of(Attitude::default(), Complex::new(0.0, 0.0)) }
    }

    /// Goes on from an attitude and the velocity by which a loop before it leaned.
    pub(super) fn of(attitude: Attitude, velocity_m_s: Complex<f64>) -> Self {
        let (sin, cos) = libm::sincos(attitude.z_rad);
        let zero = Complex::new(0.0, 0.0);
        Self {
            attitude,
            azimuth: Complex::new(cos, sin),
            velocity_m_s,
            velocity_before_m_s: velocity_m_s,
            left_rad: zero,
            started: true,
        }
    }

    pub(super) fn attitude(&self) -> Attitude {
        self.attitude
    }

    /// e^{jz}.
    #[inline]
    pub(super) fn azimuth(&self) -> Complex<f64> {
        self.azimuth
    }

    /// The leaky velocity in the frame in which this is the turn of the level; of its first one this deviation is left.
    pub(super) fn leaky_velocity(&self, z_rad: f64, left_sd_m_s: f64) -> LeakyVelocity {
        if !self.started {
            return LeakyVelocity::UNKNOWN;
        }
        LeakyVelocity::of_loop(self.velocity_m_s * self.azimuth.conj(), left_sd_m_s).turned(z_rad)
    }

    /// The leaky velocity over g, s.
    pub(super) fn velocity_s(&self) -> Complex<f64> {
        self.velocity_m_s / GRAVITY_M_S2
    }

    /// An inclination has been seen.
    pub(super) fn started(&self) -> bool {
        self.started
    }

    /// What the velocity was gathered on is no longer the level.
    #[cold]
    pub(super) fn forget_velocity(&mut self) {
        (self.velocity_m_s, self.velocity_before_m_s) = (Complex::new(0.0, 0.0), Complex::new(0.0, 0.0));
    }

    /// The next inclination sets the level anew.
    pub(super) fn restart(&mut self) {
        *self = Self { started: false, ..Self::of(self.attitude, Complex::new(0.0, 0.0)) };
    }

    /// The body turns for `dt_s`, while the level leans as the velocity tells for `lean_s` of it, and takes back what is left of a known
    /// error; the body's axes in the frame of fixed azimuth.
    #[inline]
    pub(super) fn turn(&mut self, turn: Turn, dt_s: f64, lean_s: f64) -> Axes {
        let back_rad = self.left_rad * ease::share(self.left_rad.norm_sqr(), dt_s);
        self.left_rad -= back_rad;
        let lean = back_rad * 0.5 + self.velocity_m_s * (HALF_TILT_RATE * lean_s);
        self.attitude.turn_and_lean(turn, lean * self.azimuth.conj(), &mut self.azimuth)
    }

    /// The horizontal part of a force as it is where nothing is left to be taken back; `up_m_s2` is its vertical part.
    #[inline]
    pub(super) fn corrected(&self, horizontal_m_s2: Complex<f64>, up_m_s2: f64) -> Complex<f64> {
        horizontal_m_s2 - self.left_rad * up_m_s2
    }

    /// The shortest turn of the level that brings `up` up.
    #[cold]
    pub(super) fn align(&mut self, up: Point) {
        self.moved(self.attitude.realigned(up));
        self.started = true;
    }

    /// V' = h − V/T1; h dt is given.
    #[inline]
    pub(super) fn follow(&mut self, force_dt_m_s: Complex<f64>, dt_s: f64) {
        self.velocity_m_s = self.velocity_m_s * (1.0 - dt_s * (1.0 / T1_S)) + force_dt_m_s;
    }

    /// What the level has leaned by since the last call, rad, as the velocity told: T1 (∫h dt − ΔV) of the integral of V.
    /// Restores the length of the azimuth.
    pub(super) fn take_leaned(&mut self, force_dt_m_s: Complex<f64>) -> Complex<f64> {
        self.azimuth *= 1.5 - 0.5 * self.azimuth.norm_sqr();
        let change_m_s = self.velocity_m_s - self.velocity_before_m_s;
        self.velocity_before_m_s = self.velocity_m_s;
        (force_dt_m_s - change_m_s) * (2.0 * HALF_TILT_RATE * T1_S)
    }

    /// Takes a known error back, the tilt by and by, or at once where that is a jump, which is told.
    pub(super) fn take_back(&mut self, error: Error) -> bool {
        self.velocity_m_s -= error.velocity * GRAVITY_M_S2;
        self.velocity_before_m_s = self.velocity_m_s;
        self.left_rad += error.tilt;
        let jumps = self.left_rad.norm_sqr() > JUMP_RAD * JUMP_RAD;
        if jumps {
            let lean = core::mem::take(&mut self.left_rad) * 0.5;
            self.moved(self.attitude.leaned(lean * self.azimuth.conj()));
        }
        jumps
    }

    fn moved(&mut self, moved: Moved) {
        self.attitude = moved.attitude;
        self.azimuth *= moved.swing.conj();
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let (sin, cos) = libm::sincos(self.attitude.z_rad);
        let apart = (self.azimuth - Complex::new(cos, sin)).norm_sqr();
        attitude_flaw(self.attitude).or((apart > 1e-6).then_some("an azimuth that is not that of the attitude"))
    }
}

impl Numbers for Level {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.azimuth.visit(visit);
        self.velocity_m_s.visit(visit);
        self.velocity_before_m_s.visit(visit);
        self.left_rad.visit(visit);
        self.started.visit(visit);
    }
}
