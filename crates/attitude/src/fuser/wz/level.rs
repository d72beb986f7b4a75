//! The level: the attitude, and the leaky velocity by which it leans.
//!
//! What is horizontal is kept in the frame of fixed azimuth: the level frame turned back by z, so that turns about the vertical
//! leave it where it is. It is one with the reference frame but for the azimuth at which it began.

use super::{T1_S, T2_S};
use crate::{
    Complex, GRAVITY_M_S2,
    accel::Inclination,
    point::Point,
    stage::{Numbers, attitude_flaw},
    state::{Attitude, Moved},
    turn::Turn,
};

/// From the velocity, m/s, to half the tilt rate, rad/s.
const HALF_TILT_RATE: f64 = 0.5 / (GRAVITY_M_S2 * T1_S * T2_S);

/// The attitude and the velocity of the levelling loop.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    attitude: Attitude,
    /// e^{jz}: takes what is in the level frame to the frame of fixed azimuth.
    azimuth: Complex<f64>,
    velocity_m_s: Complex<f64>,
    /// Half the sum of the leans since it was last taken.
    leaned: Complex<f64>,
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

impl Default for Level {
    fn default() -> Self {
        Self { started: false, ..Self::of(Attitude::default()) }
    }
}

impl Level {
    /// Goes on from an attitude.
    pub(super) fn of(attitude: Attitude) -> Self {
        let (sin, cos) = libm::sincos(attitude.z_rad);
        let zero = Complex::new(0.0, 0.0);
        Self { attitude, azimuth: Complex::new(cos, sin), velocity_m_s: zero, leaned: zero, started: true }
    }

    pub(super) fn attitude(&self) -> Attitude {
        self.attitude
    }

    /// An inclination has been seen.
    pub(super) fn started(&self) -> bool {
        self.started
    }

    /// The next inclination sets the level anew.
    pub(super) fn restart(&mut self) {
        *self = Self { started: false, ..Self::of(self.attitude) };
    }

    /// The body turns while the level leans, for `dt_s`, as the velocity tells; the horizontal parts of the body's axes.
    #[inline]
    pub(super) fn turn(&mut self, turn: Turn, dt_s: f64) -> [Complex<f64>; 3] {
        let lean = self.velocity_m_s * (HALF_TILT_RATE * dt_s);
        self.leaned += lean;
        self.moved(self.attitude.turned_and_leaned(turn, lean * self.azimuth.conj()));
        self.attitude.horizontal_axes().map(|axis| axis * self.azimuth)
    }

    /// The shortest turn of the level that brings `up` up.
    #[cold]
    pub(super) fn align(&mut self, up: Point) {
        self.moved(self.attitude.realigned(up));
        self.started = true;
    }

    /// V' = h − V/T1.
    #[inline]
    pub(super) fn follow(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        self.velocity_m_s += (force_m_s2 - self.velocity_m_s * (1.0 / T1_S)) * dt_s;
    }

    /// Angle between the accelerometer's up and the attitude's, of a force whose horizontal part is given.
    ///
    /// By the first terms of its series in the chord: to 1e-3 of itself up to 60°, to 1 % up to 90°.
    #[inline]
    pub(super) fn innovation_rad(&self, inclination: &Inclination, force_m_s2: Complex<f64>) -> f64 {
        let norm_m_s2 = inclination.norm_m_s2;
        let up_m_s2 = self.attitude.up.direction().dot(&inclination.force_m_s2);
        // 2 (1 − cos) = 2 sin² / (1 + cos), and 4 upside down.
        let chord2 = 2.0 * force_m_s2.norm_sqr() / (norm_m_s2 * (norm_m_s2 + up_m_s2)).max(f64::MIN_POSITIVE);
        let chord2 = chord2.min(4.0);
        libm::sqrt(chord2) * (1.0 + chord2 * (1.0 / 24.0 + chord2 * (3.0 / 640.0)))
    }

    /// The sum of the leans since the last call, rad. Restores the length of the azimuth.
    pub(super) fn take_leaned(&mut self) -> Complex<f64> {
        self.azimuth *= 1.5 - 0.5 * self.azimuth.norm_sqr();
        core::mem::take(&mut self.leaned) * 2.0
    }

    /// Takes a known error back.
    pub(super) fn take_back(&mut self, error: Error) {
        self.velocity_m_s -= error.velocity * GRAVITY_M_S2;
        self.moved(self.attitude.leaned(error.tilt * 0.5 * self.azimuth.conj()));
    }

    #[inline]
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
        self.leaned.visit(visit);
        self.started.visit(visit);
    }
}
