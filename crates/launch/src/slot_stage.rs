//! Stages allowed in a slot, and their parameters.
//!
//! Input: a slot and the name of a stage, from a launch file or a request at run time.
//!
//! Output: whether the stage may run in the slot.
//!
//! Failure: an unknown name is rejected with the list of valid names.

use std::{collections::BTreeMap, fmt};

use attitude::{
    accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage as _,
};

use crate::{ExternalStage, Launch, Slot, StageConfig, problem::nearest, toml_reader::Section};

impl Launch {
    /// Checks that the slot has a stage of this name, built-in or external.
    ///
    /// # Errors
    ///
    /// Returns an error with the slot's stages if the name is unknown or belongs to another slot.
    pub fn validate_stage(&self, slot: Slot, stage: &str) -> Result<(), UnknownStage> {
        let stages = stages(slot, &self.stages);
        if stages.contains(&stage) {
            return Ok(());
        }
        let accepts = |other: &Slot| self::stages(*other, &self.stages).contains(&stage);
        Err(UnknownStage {
            slot,
            stage: stage.into(),
            other_slot: Slot::ALL.into_iter().find(accepts),
            nearest: nearest(stage, &stages).map(str::to_owned),
            stages: stages.join(", "),
        })
    }
}

/// The slot has no stage of this name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownStage {
    slot: Slot,
    stage: String,
    /// Other slot that has a stage of this name.
    other_slot: Option<Slot>,
    nearest: Option<String>,
    stages: String,
}

impl fmt::Display for UnknownStage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { slot, stage, other_slot, nearest, stages } = self;
        match (other_slot, nearest) {
            (Some(other), _) => write!(f, "the stage `{stage}` belongs to the slot `{other}`, not `{slot}`")?,
            (None, Some(nearest)) => write!(f, "no stage named `{stage}`; did you mean `{nearest}`?")?,
            (None, None) => write!(f, "no stage named `{stage}`")?,
        }
        let end = if other_slot.is_none() && nearest.is_some() { "" } else { ";" };
        write!(f, "{end} stages of the slot `{slot}`: {stages}")
    }
}

impl std::error::Error for UnknownStage {}

/// Reads the stage of a slot from the keys `stage` and `set`.
pub(crate) fn stage_config(
    section: &mut Section<'_, '_>,
    slot: Slot,
    external: &BTreeMap<String, ExternalStage>,
    out: &mut StageConfig,
) -> bool {
    let allowed: Vec<_> = stages(slot, external).into_iter().map(|name| (name, name.to_owned())).collect();
    let valid = section.choice("stage", allowed, &mut out.stage);
    section.section("set", |section| {
        let Some(parameters) = parameters(slot, &out.stage) else { return section.numbers(&mut out.set) };
        for Parameter { name, min, max, default, .. } in parameters {
            let mut value = *default;
            if section.number(name, *min..=*max, &mut value) && section.span(name).is_some() {
                out.set.insert((*name).into(), value);
            }
        }
    });
    valid
}

impl Launch {
    /// Returns the names of the slot's stages: first built-in, then external ones.
    pub fn stage_names(&self, slot: Slot) -> Vec<&str> {
        stages(slot, &self.stages)
    }
}

fn stages(slot: Slot, external: &BTreeMap<String, ExternalStage>) -> Vec<&str> {
    let built_in: &[&str] = match slot {
        Slot::Gyro => &Gyro::NAMES,
        Slot::Accel => &Accelerometer::NAMES,
        Slot::Fuser => &Fuser::NAMES,
        Slot::Course => &Course::NAMES,
    };
    let external_names = external.iter().filter(|(_, stage)| stage.slot == slot).map(|(name, _)| name.as_str());
    built_in.iter().copied().chain(external_names).collect()
}

fn parameters(slot: Slot, stage: &str) -> Option<&'static [Parameter]> {
    match slot {
        Slot::Gyro => Some(Gyro::from_name(stage)?.parameters()),
        Slot::Accel => Some(Accelerometer::from_name(stage)?.parameters()),
        Slot::Fuser => Some(Fuser::from_name(stage)?.parameters()),
        Slot::Course => Some(Course::from_name(stage)?.parameters()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_stage_is_rejected_with_the_slots_stages() {
        let external_names = "[stages.my-fuser]\nslot = \"fuser\"\ncommand = [\"my_fuser\"]";
        let launch = Launch::parse("launch.toml", external_names).unwrap();
        let error = |slot, stage| launch.validate_stage(slot, stage).unwrap_err().to_string();
        for stage in ["wz", "vqf", "my-fuser"] {
            assert_eq!(launch.validate_stage(Slot::Fuser, stage), Ok(()));
        }
        assert_eq!(
            error(Slot::Course, "angels"),
            "no stage named `angels`; did you mean `angles`? stages of the slot `course`: angles, track"
        );
        assert_eq!(
            error(Slot::Course, "kalman"),
            "no stage named `kalman`; stages of the slot `course`: angles, track"
        );
        assert_eq!(
            error(Slot::Course, "my-fuser"),
            "the stage `my-fuser` belongs to the slot `fuser`, not `course`; stages of the slot `course`: angles, track"
        );
        assert!(error(Slot::Fuser, "my-fuse").contains("did you mean `my-fuser`?"));
    }
}
