//! Steps of the estimation, and the built-in stages that perform them.

use core::fmt;

use crate::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage as _};

/// Step of the estimation that a stage performs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Slot {
    /// Integrates the angular rate.
    Gyro,
    /// Estimates the up direction from the specific force.
    Accel,
    /// Fuses gyro, accelerometer and other sensors into an attitude.
    Fuser,
    /// Computes angles and course from the attitude.
    Course,
}

impl Slot {
    /// All slots, in the order of the data flow.
    pub const ALL: [Self; 4] = [Self::Gyro, Self::Accel, Self::Fuser, Self::Course];

    /// Returns the name used in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gyro => "gyro",
            Self::Accel => "accel",
            Self::Fuser => "fuser",
            Self::Course => "course",
        }
    }

    /// Returns the slot called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|slot| slot.name() == name)
    }

    /// Returns the names of the built-in stages. The first is the default.
    pub const fn stages(self) -> &'static [&'static str] {
        match self {
            Self::Gyro => &Gyro::NAMES,
            Self::Accel => &Accelerometer::NAMES,
            Self::Fuser => &Fuser::NAMES,
            Self::Course => &Course::NAMES,
        }
    }

    /// Returns the name of the default stage.
    pub const fn default_stage(self) -> &'static str {
        self.stages()[0]
    }

    /// Returns the parameters of a built-in stage, or `None` if the slot has no stage of this name.
    pub fn parameters(self, stage: &str) -> Option<&'static [Parameter]> {
        match self {
            Self::Gyro => Some(Gyro::from_name(stage)?.parameters()),
            Self::Accel => Some(Accelerometer::from_name(stage)?.parameters()),
            Self::Fuser => Some(Fuser::from_name(stage)?.parameters()),
            Self::Course => Some(Course::from_name(stage)?.parameters()),
        }
    }
}

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
