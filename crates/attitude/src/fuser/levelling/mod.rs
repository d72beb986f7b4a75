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
//! The two laws of [`Levelling`] and of [`LevellingPi`], aided and autonomous, act on one attitude: at the edges of a gap only its
//! rate changes, so nothing jumps. S4's figure 7 has two platforms that run all the time, and a choice between them:
//! [`LevellingUnified`].
//!
//! Both need a vehicle that moves where it points. In wind V H' is wrong by wind times H': 10 m/s in a turn of 3 °/s is 3° of
//! apparent tilt for as long as the turn lasts. Backwards and sideways the law does not hold; for that there is `aided`.

mod geometry;
mod limits;
mod pi;
mod platform;
mod printed;
mod pull;
mod speed;
mod unified;

pub use pi::{LevellingPi, PiSettings};
pub use printed::{Levelling, PrintedSettings};
pub use unified::{LevellingUnified, UnifiedSettings};
