//! Built-in stages of each slot, and their parameters.

use attitude::{
    accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage as _,
};
use graph::Slot;

/// Returns the names of the slot's built-in stages. The first is the default.
pub const fn built_in_stages(slot: Slot) -> &'static [&'static str] {
    match slot {
        Slot::Gyro => &Gyro::NAMES,
        Slot::Accel => &Accelerometer::NAMES,
        Slot::Fuser => &Fuser::NAMES,
        Slot::Course => &Course::NAMES,
    }
}

/// Returns the default stage of a slot.
pub(crate) const fn default_stage(slot: Slot) -> &'static str {
    built_in_stages(slot)[0]
}

/// Returns the parameters of a built-in stage; `None` if the slot has no built-in stage of this
/// name.
pub fn built_in_parameters(slot: Slot, stage: &str) -> Option<&'static [Parameter]> {
    match slot {
        Slot::Gyro => Some(Gyro::from_name(stage)?.parameters()),
        Slot::Accel => Some(Accelerometer::from_name(stage)?.parameters()),
        Slot::Fuser => Some(Fuser::from_name(stage)?.parameters()),
        Slot::Course => Some(Course::from_name(stage)?.parameters()),
    }
}
