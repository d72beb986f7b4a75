//! Platform levelling: the level follows the specific force less the motion that a receiver tells.
//!
//! "S4" is *Orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter*. Its platform is a horizontal
//! frame free in azimuth; C takes body to platform:
//!
//! C' = C ω̂ − ω̂c C,  f_P = C f,  H = atan2(C12, C22)
//!
//! with ω the gyro's rate and ω_c the rate at which the platform is turned back to level. In the (w, z) of this crate C is Aᵀ, the
//! platform is the reference frame, f_P = e^{jz} h(f) with h the [horizontal part](crate::state::Attitude::horizontal) in the level
//! frame, and −ω̂c C is a [lean](crate::state::Attitude::leaned) of the level frame: about a horizontal axis, so that levelling
//! does not turn the course.
//!
//! In the vehicle's heading, x to the right and y forward, a vehicle at ground speed V that turns at H' (clockwise) accelerates by
//! (V H', V'). What is left of the force is tilt:
//!
//! gx = fx − V H',  gy = fy − V'                             aided — S4, (3), (4)
//! ωx = −K gy,  ωy = K gx,  K = 1/(g τ)
//!
//! Without V the low-passed f_P takes the place of (gx, gy): what a vehicle does for half a minute has a mean of nearly nothing in a
//! frame that does not turn with it. S4 reports 0.2–0.5° RMS of roll and pitch aided and 0.3–1.0° autonomous, in cruise.
//!
//! A loop with K alone carries the gyro's bias as a tilt of τ b: with τ = 5 s and 0.05 °/s 0.25°, in a gap with τ = 60 s 3°. With
//! such a gyro the law as printed gives about 0.5° aided and 2–4° autonomous. [`Levelling`] is that law; [`LevellingPi`] estimates
//! the bias, which is the whole of the difference.
//!
//! The two laws of a stage, aided and autonomous, act on one attitude: at the edges of a gap only its rate changes, so nothing
//! jumps.
//!
//! Both need a vehicle that moves where it points. In wind V H' is wrong by wind times H': 10 m/s in a turn of 3 °/s is 3° of
//! apparent tilt for as long as the turn lasts. Backwards and sideways the law does not hold; for that there is `aided`.

mod pi;
mod printed;

pub use pi::{LevellingPi, PiSettings};
pub use printed::{Levelling, PrintedSettings};

use super::low_pass_gain;
use crate::{Complex, GRAVITY_M_S2, J, Vector3, accel::Inclination, gnss::Fix, gyro::Motion, state::Attitude};

/// A force, an acceleration beyond this is no vehicle's, m/s².
const FORCE_LIMIT_M_S2: f64 = 500.0;
/// A rate beyond this is no vehicle's, rad/s.
const RATE_LIMIT_RAD_S: f64 = 100.0;
/// A speed beyond this is no vehicle's, m/s.
const SPEED_LIMIT_M_S: f64 = 3000.0;
/// Longest time for which one force stands, s; over a longer one nothing is levelled.
const FORCE_HOLD_S: f64 = 1.0;
/// The tilt that the bias of a consumer accelerometer makes, 0.02 m/s²; no levelling can see it, rad.
const FLOOR_RAD: f64 = 0.002;

/// The length of the tick's interval, s.
fn interval_s(motion: Option<&Motion>) -> f64 {
    motion.map_or(0.0, |motion| motion.dt_s.clamp(0.0, 1.0))
}

/// The fix, if its velocity can be one.
fn credible(fix: Option<&Fix>) -> Option<&Fix> {
    fix.filter(|fix| fix.velocity_m_s.amax() <= SPEED_LIMIT_M_S)
}

/// A vector whose components are at most `limit`, in its own direction.
fn bounded(vector: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let size = vector.amax();
    if size > limit { vector * (limit / size) } else { vector }
}

/// The turn rate H' about the vertical, rad/s, clockwise from above.
fn turn_rate_rad_s(attitude: Attitude, rate_rad_s: Vector3<f64>) -> f64 {
    -bounded(rate_rad_s, RATE_LIMIT_RAD_S).dot(&attitude.up.direction())
}

/// The level frame in the axes of the platform, that is of the reference frame: e^{jz}.
fn azimuth(attitude: Attitude) -> Complex<f64> {
    let (sin, cos) = libm::sincos(attitude.z_rad);
    Complex::new(cos, sin)
}

/// Forward in the level frame, of unit length; zero where the body points straight up or down.
fn forward(attitude: Attitude) -> Complex<f64> {
    let [_, axis, _] = attitude.axes(Complex::new(1.0, 0.0)).horizontal;
    let size = libm::sqrt(axis.norm_sqr());
    if size > 1e-3 { axis / size } else { Complex::new(0.0, 0.0) }
}

/// The acceleration (V H', V') of a vehicle that moves where it points, in the level frame, m/s².
fn carried(attitude: Attitude, centripetal_m_s2: f64, along_m_s2: f64) -> Complex<f64> {
    let bounded = |x: f64| x.clamp(-FORCE_LIMIT_M_S2, FORCE_LIMIT_M_S2);
    // Right of forward is forward turned by −90°.
    forward(attitude) * Complex::new(bounded(along_m_s2), -bounded(centripetal_m_s2))
}

/// What one force says, over the time for which it stands.
#[derive(Debug, Clone, Copy)]
struct Pull {
    /// Horizontal part in the level frame, m/s².
    level_m_s2: Complex<f64>,
    /// For how long, s; zero over a time that is too long for one force.
    dt_s: f64,
}

impl Pull {
    fn of(attitude: Attitude, inclination: &Inclination, unlevelled_s: f64) -> Self {
        let dt_s = if unlevelled_s > FORCE_HOLD_S { 0.0 } else { unlevelled_s };
        Self { level_m_s2: attitude.horizontal(bounded(inclination.force_m_s2, FORCE_LIMIT_M_S2)), dt_s }
    }
}

/// The gain of a low-pass of which `unaveraged_s` of its time constant is yet to come: a mean of what there was so far.
fn averaging_gain(dt_s: f64, time_constant_s: f64, unaveraged_s: &mut f64) -> f64 {
    let gain = low_pass_gain(dt_s, time_constant_s);
    if *unaveraged_s <= 0.0 || dt_s <= 0.0 {
        return gain;
    }
    let averaged_s = (time_constant_s - *unaveraged_s).max(0.0) + dt_s;
    *unaveraged_s = (*unaveraged_s - dt_s).max(0.0);
    gain.max(dt_s / averaged_s)
}

/// The lean that takes a tilt away: the level-frame point that half of the tilt's tangent is.
fn lean_of(tilt_rad: Complex<f64>) -> Complex<f64> {
    tilt_rad * 0.5
}

/// The tilt that an unexplained acceleration is, rad.
fn tilt_of(unexplained_m_s2: Complex<f64>) -> Complex<f64> {
    unexplained_m_s2 / GRAVITY_M_S2
}

/// The rotation of the body, in its own axes, whose horizontal part in the level frame is j times the tilt: what a gyro has turned too
/// much when the level leans by `tilt_rad`.
fn turned_too_much(attitude: Attitude, tilt_rad: Complex<f64>) -> Vector3<f64> {
    let turned = J * tilt_rad;
    Vector3::from(
        attitude.axes(Complex::new(1.0, 0.0)).horizontal.map(|axis| axis.re * turned.re + axis.im * turned.im),
    )
}
