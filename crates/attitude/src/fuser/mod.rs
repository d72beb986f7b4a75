//! Fuser stages: motion, inclination and, where they are there, the magnetic field and a velocity become one attitude.
//!
//! Input: what the slot is offered at a tick, any part of which may be missing. Output: the fused attitude with the bias of the
//! gyro, the innovation and standard deviations. Time: the motion's interval. Failure: without a motion the attitude is held,
//! without an inclination it follows the gyro; what is not a finite number is missing.
//!
//! | stage | what it is |
//! | --- | --- |
//! | [`multiple-model`](multiple_model::MultipleModel) | `wz` and `aided` on the same input, and a choice between them |
//! | [`wz`](wz::Wz) | levelled low-pass of second order, Möbius correction, gyro bias and scale; heading by the magnetic field |
//! | [`wz-closed`](wz_closed::WzClosed) | w_c' = f(w_c, ω) + (w_acc − w_c)/T |
//! | [`wz-open`](wz_open::WzOpen) | HPF(w_gyro) + LPF(w_acc) as published |
//! | [`madgwick`](madgwick::Madgwick), `madgwick-improved` | gradient descent on the quaternion, normalised or not |
//! | [`levelling`](levelling::Levelling) | a platform levelled by the specific force less the motion a receiver tells |
//! | [`levelling-unified`](levelling::LevellingUnified) | two such platforms, with a receiver's velocity and without, and a choice between them |
//! | [`levelling-pi`](levelling::LevellingPi) | the same by matched increments of velocity, with the gyro's bias |
//! | [`aided`](aided::Aided) | error-state filter with satellite velocity |
//! | [`vqf`](vqf::Vqf) | VQF, the yardstick |

pub mod aided;
mod carried;
mod compass;
mod estimate;
mod field;
mod finite;
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
mod spread;
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

use crate::{
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Stage},
};
use {
    aided::Aided,
    levelling::{Levelling, LevellingPi, LevellingUnified},
    madgwick::Madgwick,
    multiple_model::MultipleModel,
    vqf::Vqf,
    wz::Wz,
    wz_closed::WzClosed,
    wz_open::WzOpen,
};

macro_rules! fusers {
    ($($name:literal => $Variant:ident($Stage:ty) = $new:expr,)*) => {
        impl Fuser {
            /// The stages of this slot; the first is the default.
            pub const NAMES: [&'static str; [$($name),*].len()] = [$($name),*];

            /// The stage of that name.
            pub fn named(name: &str) -> Option<Self> {
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

/// A fuser stage.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one value per process, held by value because the crate has no allocator")]
pub enum Fuser {
    /// `multiple-model`
    MultipleModel(MultipleModel),
    /// `wz`
    Wz(Wz),
    /// `wz-closed`
    WzClosed(WzClosed),
    /// `wz-open`
    WzOpen(WzOpen),
    /// `madgwick`, `madgwick-improved`
    Madgwick(Madgwick),
    /// `levelling`
    Levelling(Levelling),
    /// `levelling-unified`
    LevellingUnified(LevellingUnified),
    /// `levelling-pi`
    LevellingPi(LevellingPi),
    /// `aided`
    Aided(Aided),
    /// `vqf`
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

/// A stage that the slot `fuser` takes.
pub trait FuserStage: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone {
    /// Sets the level anew by the next inclination, as after a gap in which the body may have turned anywhere; heading and gyro
    /// bias stay.
    fn realign(&mut self);

    /// Begins with what was known of the sensors before: bias, scale and hard iron. The attitude is as unknown as at any beginning, whatever
    /// `known` says of it. What cannot be taken over leaves the stage as it was.
    fn begin_with(&mut self, known: &Estimate) -> Result<(), RestoreError> {
        let Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, .. } = *known;
        self.adopt(&Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, ..Estimate::UNKNOWN })?;
        self.realign();
        Ok(())
    }
}

impl FuserStage for Fuser {
    fn realign(&mut self) {
        each!(self, stage => stage.realign());
    }
}

impl Stage for Fuser {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        each!(self, stage => stage.name())
    }

    fn parts(&self) -> &'static [&'static str] {
        each!(self, stage => stage.parts())
    }

    fn parameters(&self) -> &'static [Parameter] {
        each!(self, stage => stage.parameters())
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        each!(self, stage => stage.set(name, value))
    }

    // What the other stages made stays in registers on its way here.
    #[inline(always)]
    fn step(&mut self, input: &FuserInput) -> Fused {
        each!(self, stage => stage.step(input))
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        each!(self, stage => stage.visit_state(visit));
    }

    fn flaw(&self) -> Option<&'static str> {
        each!(self, stage => stage.flaw())
    }

    fn common(&self) -> Estimate {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(common))
    }
}
