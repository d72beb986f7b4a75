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
//! [`SupervisedFuser`] runs a stage and decides which inputs it may use. Programs that pass on
//! values of real sensors should use it instead of a bare stage.

pub mod aided;
mod angle_uncertainty;
mod bias_handover;
mod compass;
mod estimate;
mod field;
mod finite;
mod first_order;
mod fused;
mod gyro_scale;
mod hard_iron;
mod input;
mod leaky_velocity;
pub mod levelling;
mod low_pass;
pub mod madgwick;
pub mod multiple_model;
mod rest;
pub mod supervised;
pub mod vqf;
pub mod wz;
pub mod wz_closed;
pub mod wz_open;

pub use estimate::{BIAS_WALK_RAD_S, Estimate};
pub use fused::{Corrections, Fused, innovation_rad};
pub use gyro_scale::GyroScale;
pub use hard_iron::HardIron;
pub use input::FuserInput;
pub use leaky_velocity::LeakyVelocity;
pub use supervised::SupervisedFuser;

use crate::stage::{RestoreError, Stage, forward_stage};
use {
    aided::Aided,
    levelling::{Levelling, LevellingPi, LevellingUnified},
    madgwick::Madgwick,
    multiple_model::{AidedModel, MultipleModel, WzModel},
    vqf::Vqf,
    wz::Wz,
    wz_closed::WzClosed,
    wz_open::WzOpen,
};

macro_rules! fusers {
    ($($name:literal => $Variant:ident($Stage:ty) = $new:expr,)*) => {
        impl Fuser {
            /// Names of the stages of this slot. The first is the default.
            pub const NAMES: [&'static str; [$($name),*].len()] = [$($name),*];

            /// Returns the stage called `name`, or `None` if there is no such stage.
            pub fn from_name(name: &str) -> Option<Self> {
                match name {
                    $($name => Some(Self::$Variant($new)),)*
                    _ => None,
                }
            }
        }
    };
}

fusers! {
    "multiple-model" => MultipleModel(MultipleModel) = MultipleModel::default(),
    "wz" => Wz(Wz) = Wz::default(),
    "wz-closed" => WzClosed(WzClosed) = WzClosed::default(),
    "wz-open" => WzOpen(WzOpen) = WzOpen::default(),
    "madgwick" => Madgwick(Madgwick) = Madgwick::original(),
    "madgwick-improved" => Madgwick(Madgwick) = Madgwick::improved(),
    "levelling" => Levelling(Levelling) = Levelling::default(),
    "levelling-unified" => LevellingUnified(LevellingUnified) = LevellingUnified::default(),
    "levelling-pi" => LevellingPi(LevellingPi) = LevellingPi::default(),
    "aided" => Aided(Aided) = Aided::default(),
    "vqf" => Vqf(Vqf) = Vqf::default(),
}

/// Fuser stage, selected by name.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one value per process, held by value because the crate has no allocator")]
pub enum Fuser {
    /// `wz` and `aided` on the same input, with a selection between them.
    MultipleModel(MultipleModel),
    /// Levelled second-order low-pass, with gyro bias, gyro scale and magnetic heading.
    Wz(Wz),
    /// Gyro integration with a first-order correction by the accelerometer.
    WzClosed(WzClosed),
    /// High-pass filtered gyro plus low-pass filtered accelerometer, as published.
    WzOpen(WzOpen),
    /// Gradient descent: `madgwick` or `madgwick-improved`.
    Madgwick(Madgwick),
    /// Platform levelling as published.
    Levelling(Levelling),
    /// Two platforms with a selection between them.
    LevellingUnified(LevellingUnified),
    /// Platform levelling by matched velocity increments.
    LevellingPi(LevellingPi),
    /// Error-state filter with satellite velocity.
    Aided(Aided),
    /// VQF, the reference for comparison.
    Vqf(Vqf),
}

macro_rules! each {
    ($fuser:expr, $stage:ident => $do:expr) => {
        match $fuser {
            Fuser::MultipleModel($stage) => $do,
            Fuser::Wz($stage) => $do,
            Fuser::WzClosed($stage) => $do,
            Fuser::WzOpen($stage) => $do,
            Fuser::Madgwick($stage) => $do,
            Fuser::Levelling($stage) => $do,
            Fuser::LevellingUnified($stage) => $do,
            Fuser::LevellingPi($stage) => $do,
            Fuser::Aided($stage) => $do,
            Fuser::Vqf($stage) => $do,
        }
    };
}

/// Stage that can fill the slot `fuser`.
pub trait FuserStage: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone {
    /// Lets the next inclination re-initialise the level. Needed after a gap in which the body may
    /// have rotated arbitrarily. Heading and gyro bias are kept.
    fn realign(&mut self);

    /// Starts with sensor errors known from an earlier run: gyro bias, gyro scale and hard iron.
    ///
    /// The attitude stays unknown, whatever `prior` contains.
    ///
    /// # Errors
    ///
    /// Returns [`RestoreError`] if `prior` is invalid. The stage is then unchanged.
    fn seed_sensor_errors(&mut self, prior: &Estimate) -> Result<(), RestoreError> {
        let Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, .. } = *prior;
        self.adopt(&Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, ..Estimate::UNKNOWN })?;
        self.realign();
        Ok(())
    }

    /// Returns the two models of the stage `multiple-model`; `None` for any other stage.
    fn models(&mut self) -> Option<(&mut AidedModel, &mut WzModel)> {
        None
    }
}

/// Implements [`FuserStage`] by the stage's own method `realign`.
macro_rules! fuser_stages {
    ($($Stage:ident)+) => {
        $(impl FuserStage for $Stage {
            fn realign(&mut self) {
                $Stage::realign(self);
            }
        })+
    };
}

fuser_stages! { Wz WzClosed WzOpen Madgwick Levelling LevellingUnified LevellingPi Aided Vqf }

impl FuserStage for MultipleModel {
    fn realign(&mut self) {
        Self::realign(self);
    }

    fn models(&mut self) -> Option<(&mut AidedModel, &mut WzModel)> {
        Some(Self::models(self))
    }
}

impl FuserStage for Fuser {
    fn realign(&mut self) {
        each!(self, stage => stage.realign());
    }

    fn models(&mut self) -> Option<(&mut AidedModel, &mut WzModel)> {
        each!(self, stage => FuserStage::models(stage))
    }
}

impl Stage for Fuser {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    // Inlined so that the outputs of the upstream stages reach this one in registers.
    forward_stage!(each, #[inline(always)]);
}
