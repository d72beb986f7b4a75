//! Platform levelling: the level follows the specific force minus the acceleration known from a
//! receiver.
//!
//! "S4" is *Orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8
//! helicopter*. Its platform is a horizontal frame with an arbitrary azimuth. The matrix C converts
//! body axes to platform axes:
//!
//! C' = C ω̂ − ω̂c C,  f_P = C f,  H = atan2(C12, C22)
//!
//! with ω the gyro's rate and ω_c the rate at which the platform is rotated back to level. In the
//! (w, z) parameters of this crate, C is Aᵀ, the platform is the reference frame, f_P = e^{jz} h(f)
//! with h the [horizontal part](crate::state::Attitude::horizontal) in the level frame, and −ω̂c C
//! is a [tilt](crate::state::Attitude::tilted) of the level frame. The axis of this tilt is
//! horizontal, so levelling does not change the course.
//!
//! In axes that follow the vehicle's heading, x to the right and y forward, a vehicle at ground
//! speed V that turns at H' (clockwise) accelerates by (V H', V'). The rest of the horizontal force
//! is attributed to tilt:
//!
//! gx = fx − V H',  gy = fy − V'                             aided — S4, (3), (4)
//! ωx = −K gy,  ωy = K gx,  K = 1/(g τ)
//!
//! Here (fx, fy) is the horizontal specific force, g the gravity and τ the time constant of
//! levelling. If V is unknown, the low-pass filtered f_P replaces (gx, gy), because over half a
//! minute a vehicle's accelerations average out in a frame that does not rotate with the vehicle.
//! For cruise, S4 reports RMS errors of roll and pitch of 0.2–0.5° aided and 0.3–1.0° autonomous.
//!
//! A loop with K alone converts the gyro bias b to a tilt of τ b: with 0.05 °/s it is 0.25° for τ =
//! 5 s, and 3° in a gap with τ = 60 s. With such a gyro the published law ([`Levelling`]) gives
//! about 0.5° aided and 2–4° autonomous. [`LevellingPi`] also estimates the bias, which accounts
//! for all of its advantage over the published law.
//!
//! In [`Levelling`] and in [`LevellingPi`] the aided and the autonomous law act on one attitude. At
//! the start and end of a gap only the rate of the attitude changes, so nothing jumps. Figure 7 of
//! S4 instead runs two platforms all the time and selects one of them. [`LevellingUnified`]
//! implements this figure.
//!
//! Both laws assume a vehicle that moves where its nose points. In wind, V H' is wrong by the wind
//! speed times H'. A wind of 10 m/s in a turn of 3 °/s, for example, looks like a tilt of 3° for
//! the duration of the turn. The laws do not hold for backward and sideways motion; use `aided` in
//! these cases.

mod geometry;
mod level_force;
mod limits;
mod pi;
mod platform;
mod published;
mod speed;
mod unified;

pub use pi::{LevellingPi, PiSettings};
pub use published::{Levelling, LevellingSettings};
pub use unified::{LevellingUnified, UnifiedSettings};
