//! What may fill a slot, and how it may be set.
//!
//! Input: a slot and the name of a stage, in a launch file or asked for while the system runs. Output: whether it may fill the slot.
//! Time: none. Failure: a name that is none of the slot's is refused with those that are.

use std::{collections::BTreeMap, fmt};

use attitude::{
    accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage as _,
};

use crate::{Launch, Program, Service, Stage, problem::nearest, walk::Section};

impl Launch {
    /// Whether a stage of that name may fill the slot: one of Plumbline's, or of the user's own.
    pub fn may_fill(&self, slot: Service, stage: &str) -> Result<(), UnknownStage> {
        let stages = stages(slot, &self.stages);
        if stages.contains(&stage) {
            return Ok(());
        }
        let fills = |other: &Service| self::stages(*other, &self.stages).contains(&stage);
        Err(UnknownStage {
            slot,
            stage: stage.into(),
            fills: Service::SLOTS.into_iter().find(fills),
            nearest: nearest(stage, &stages).map(str::to_owned),
            stages: stages.join(", "),
        })
    }
}

/// No stage of the slot has this name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownStage {
    slot: Service,
    stage: String,
    /// The slot that it fills.
    fills: Option<Service>,
    nearest: Option<String>,
    stages: String,
}

impl fmt::Display for UnknownStage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { slot, stage, fills, nearest, stages } = self;
        match (fills, nearest) {
            (Some(other), _) => write!(f, "`{stage}` fills the slot `{other}`, not `{slot}`")?,
            (None, Some(nearest)) => write!(f, "there is no stage `{stage}`; did you mean `{nearest}`?")?,
            (None, None) => write!(f, "there is no stage `{stage}`")?,
        }
        let end = if fills.is_none() && nearest.is_some() { "" } else { ";" };
        write!(f, "{end} for the slot `{slot}` there are {stages}")
    }
}

impl std::error::Error for UnknownStage {}

/// What fills a slot: the keys `stage` and `set`.
pub(crate) fn filling(
    section: &mut Section<'_, '_>,
    slot: Service,
    programs: &BTreeMap<String, Program>,
    out: &mut Stage,
) -> bool {
    let allowed: Vec<_> = stages(slot, programs).into_iter().map(|name| (name, name.to_owned())).collect();
    let taken = section.choice("stage", allowed, &mut out.stage);
    section.section("set", |section| {
        let Some(parameters) = parameters(slot, &out.stage) else { return section.numbers(&mut out.set) };
        for Parameter { name, least, most, default, .. } in parameters {
            let mut value = *default;
            if section.number(name, *least..=*most, &mut value) && section.span(name).is_some() {
                out.set.insert((*name).into(), value);
            }
        }
    });
    taken
}

impl Launch {
    /// The names of the stages that may fill a slot: Plumbline's, then the user's own.
    pub fn stages_of(&self, slot: Service) -> Vec<&str> {
        stages(slot, &self.stages)
    }
}

/// Plumbline's stages for a slot, then the user's own.
fn stages(slot: Service, programs: &BTreeMap<String, Program>) -> Vec<&str> {
    let built_in: &[&str] = match slot {
        Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => &[],
        Service::Gyro => &Gyro::NAMES,
        Service::Accel => &Accelerometer::NAMES,
        Service::Fuser => &Fuser::NAMES,
        Service::Course => &Course::NAMES,
    };
    let own = programs.iter().filter(|(_, program)| program.slot == slot).map(|(name, _)| name.as_str());
    built_in.iter().copied().chain(own).collect()
}

fn parameters(slot: Service, stage: &str) -> Option<&'static [Parameter]> {
    match slot {
        Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => None,
        Service::Gyro => Some(Gyro::named(stage)?.parameters()),
        Service::Accel => Some(Accelerometer::named(stage)?.parameters()),
        Service::Fuser => Some(Fuser::named(stage)?.parameters()),
        Service::Course => Some(Course::named(stage)?.parameters()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_is_none_of_the_slots_is_refused_with_those_that_are() {
        let own = "[stages.my-fuser]\nslot = \"fuser\"\ncommand = [\"my_fuser\"]";
        let launch = Launch::parse("launch.toml", own).unwrap();
        let refused = |slot, stage| launch.may_fill(slot, stage).unwrap_err().to_string();
        for stage in ["wz", "vqf", "my-fuser"] {
            assert_eq!(launch.may_fill(Service::Fuser, stage), Ok(()));
        }
        assert_eq!(
            refused(Service::Course, "angels"),
            "there is no stage `angels`; did you mean `angles`? for the slot `course` there are angles, track"
        );
        assert_eq!(
            refused(Service::Course, "kalman"),
            "there is no stage `kalman`; for the slot `course` there are angles, track"
        );
        assert_eq!(
            refused(Service::Course, "my-fuser"),
            "`my-fuser` fills the slot `fuser`, not `course`; for the slot `course` there are angles, track"
        );
        assert!(refused(Service::Fuser, "my-fuse").contains("did you mean `my-fuser`?"));
    }
}
