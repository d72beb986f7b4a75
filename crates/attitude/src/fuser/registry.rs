//! Registry of the fusers: names, type and constructors of each built-in stage.

use super::{
    Estimate, Fused, FuserInput, FuserStage,
    aided::Aided,
    levelling::{Levelling, LevellingPi, LevellingUnified},
    madgwick::Madgwick,
    multiple_model::{AidedModel, MultipleModel, WzModel},
    vqf::Vqf,
    wz::Wz,
    wz_closed::WzClosed,
    wz_open::WzOpen,
};
use crate::stage::{Stage, forward_stage};

/// Defines [`Fuser`] from the rows of the registry.
///
/// A row is `Type: "name" = constructor, …;`. A type that implements several methods has a name for
/// each of them.
macro_rules! fusers {
    ($($(#[$doc:meta])* $Stage:ident: $($name:literal = $new:expr),+;)*) => {
        /// Fuser stage, selected by name.
        #[derive(Debug, Clone, PartialEq)]
        #[allow(clippy::large_enum_variant, reason = "one value per process, held by value because the crate has no allocator")]
        pub enum Fuser {
            $($(#[$doc])* $Stage($Stage),)*
        }

        impl Fuser {
            /// Names of the stages of this slot. The first is the default.
            pub const NAMES: [&'static str; [$($($name),+),*].len()] = [$($($name),+),*];

            /// Returns the stage called `name`, or `None` if there is no such stage.
            pub fn from_name(name: &str) -> Option<Self> {
                match name {
                    $($($name => Some(Self::$Stage($new)),)+)*
                    _ => None,
                }
            }
        }
    };
}

fusers! {
    /// `wz` and `aided` on the same input, with a selection between them.
    MultipleModel: "multiple-model" = MultipleModel::default();
    /// Levelled second-order low-pass, with gyro bias, gyro scale and magnetic heading.
    Wz: "wz" = Wz::default();
    /// Gyro integration with a first-order correction by the accelerometer.
    WzClosed: "wz-closed" = WzClosed::default();
    /// High-pass filtered gyro plus low-pass filtered accelerometer, as published.
    WzOpen: "wz-open" = WzOpen::default();
    /// Gradient descent: `madgwick` or `madgwick-improved`.
    Madgwick: "madgwick" = Madgwick::original(), "madgwick-improved" = Madgwick::improved();
    /// Platform levelling as published.
    Levelling: "levelling" = Levelling::default();
    /// Two platforms with a selection between them.
    LevellingUnified: "levelling-unified" = LevellingUnified::default();
    /// Platform levelling by matched velocity increments.
    LevellingPi: "levelling-pi" = LevellingPi::default();
    /// Error-state filter with satellite velocity.
    Aided: "aided" = Aided::default();
    /// VQF, the reference for comparison.
    Vqf: "vqf" = Vqf::default();
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
