//! Fuser stages, which combine motion, inclination, magnetic field and satellite velocity into one
//! attitude.
//!
//! Input: the [`FuserInput`] of a tick. Each sensor value may be missing.
//!
//! Output: [`Fused`], the attitude with gyro bias, innovation and standard deviations.
//!
//! Time: the interval of the motion.
//!
//! Failure: if there is no motion, the attitude is held; if there is no inclination, the attitude
//! follows the gyro. Non-finite numbers are treated as missing.
//!
//! | stage | method |
//! | --- | --- |
//! | [`multiple-model`](multiple_model::MultipleModel) | `wz` and `aided` on the same input, with a selection between them |
//! | [`wz`](wz::Wz) | levelled second-order low-pass, Möbius correction, gyro bias and scale; magnetic heading |
//! | [`wz-closed`](wz_closed::WzClosed) | w_c' = f(w_c, ω) + (w_acc − w_c)/T |
//! | [`wz-open`](wz_open::WzOpen) | HPF(w_gyro) + LPF(w_acc), as published |
//! | [`madgwick`](madgwick::Madgwick), `madgwick-improved` | gradient descent on the quaternion, with and without a normalised gradient |
//! | [`levelling`](levelling::Levelling) | platform levelled by the specific force less the acceleration derived from satellite velocity |
//! | [`levelling-unified`](levelling::LevellingUnified) | two such platforms, with and without satellite velocity, and a selection between them |
//! | [`levelling-pi`](levelling::LevellingPi) | platform levelled by matched velocity increments, with an estimate of the gyro bias |
//! | [`aided`](aided::Aided) | error-state filter with satellite velocity |
//! | [`vqf`](vqf::Vqf) | VQF, the reference for comparison |
//!
//! [`Fuser`] is the stage selected by a name. [`SupervisedFuser`] runs a stage and decides which
//! inputs it may use. Programs that pass on values of real sensors should use it instead of a bare
//! stage.

pub mod aided;
mod angle_uncertainty;
mod bias_handover;
mod compass;
mod estimate;
mod field;
mod finite;
mod first_order;
mod fused;
mod fuser_stage;
mod gyro_scale;
mod hard_iron;
mod input;
mod leaky_velocity;
pub mod levelling;
mod low_pass;
pub mod madgwick;
pub mod multiple_model;
mod registry;
mod rest;
pub mod supervised;
pub mod vqf;
pub mod wz;
pub mod wz_closed;
pub mod wz_open;

pub use estimate::{BIAS_WALK_RAD_S, Estimate};
pub use fused::{Corrections, Fused, innovation_rad};
pub use fuser_stage::FuserStage;
pub use gyro_scale::GyroScale;
pub use hard_iron::HardIron;
pub use input::FuserInput;
pub use leaky_velocity::LeakyVelocity;
pub use registry::Fuser;
pub use supervised::SupervisedFuser;
