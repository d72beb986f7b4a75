//! Catalogue of the stages of every slot and their parameters.

use std::{collections::BTreeMap, fmt};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage};
use host::HostableStage;
use launch::{Launch, Slot};
use runtime::{RuntimeError, stage::build_stage};
use serde::Serialize;

/// Every slot with the stages available for it.
#[derive(Debug, Clone, Serialize)]
pub struct Catalogue {
    slots: Vec<SlotEntry>,
}

#[derive(Debug, Clone, Serialize)]
struct SlotEntry {
    slot: Slot,
    stages: Vec<StageEntry>,
}

#[derive(Debug, Clone, Serialize)]
struct StageEntry {
    name: &'static str,
    /// `true` for the stage that runs if no stage is selected.
    is_default: bool,
    /// Names of the stages that this stage combines; empty if it combines none.
    parts: &'static [&'static str],
    #[serde(serialize_with = "serialize_parameters")]
    parameters: &'static [Parameter],
}

impl Catalogue {
    /// Lists the built-in stages and the external stages of a launch file.
    ///
    /// External stages are started to query their parameters.
    ///
    /// # Errors
    ///
    /// Returns an error if an external stage cannot be started or queried.
    pub fn new(launch: &Launch) -> Result<Self, RuntimeError> {
        let slots = vec![
            slot_entry(Slot::Gyro, launch, Gyro::from_name)?,
            slot_entry(Slot::Accel, launch, Accelerometer::from_name)?,
            slot_entry(Slot::Fuser, launch, Fuser::from_name)?,
            slot_entry(Slot::Course, launch, Course::from_name)?,
        ];
        Ok(Self { slots })
    }

    /// Returns the catalogue as one line of JSON.
    pub fn json(&self) -> String {
        // Serialisation of numbers, strings and lists cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

fn slot_entry<B: HostableStage + Clone>(
    slot: Slot,
    launch: &Launch,
    from_name: fn(&str) -> Option<B>,
) -> Result<SlotEntry, RuntimeError> {
    let external = launch.stages.iter().filter(|(_, program)| program.slot == slot).map(|(name, _)| name.as_str());
    let entry = |(index, name): (usize, &str)| {
        let mut launch = launch.clone();
        *launch.stage_mut(slot) = launch::StageConfig { stage: name.into(), set: BTreeMap::new() };
        let stage = build_stage(slot, &launch, from_name)?;
        Ok(StageEntry {
            name: stage.name(),
            is_default: index == 0,
            parts: stage.parts(),
            parameters: stage.parameters(),
        })
    };
    let stages =
        slot.stages().iter().copied().chain(external).enumerate().map(entry).collect::<Result<_, RuntimeError>>()?;
    Ok(SlotEntry { slot, stages })
}

fn serialize_parameters<S: serde::Serializer>(
    parameters: &&'static [Parameter],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(parameters.iter().map(|parameter| {
        let Parameter { name, unit, default, min, max, description } = parameter;
        serde_json::json!({
            "name": name, "unit": unit, "default": default, "min": min, "max": max, "description": description,
        })
    }))
}

impl fmt::Display for Catalogue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, SlotEntry { slot, stages }) in self.slots.iter().enumerate() {
            write!(f, "{}{slot}", if index == 0 { "" } else { "\n" })?;
            for StageEntry { name, is_default, parts, parameters } in stages {
                write!(f, "\n  {name}{}", if *is_default { " (default)" } else { "" })?;
                if !parts.is_empty() {
                    write!(f, "\n    parts: {}", parts.join(" + "))?;
                }
                parameters
                    .iter()
                    .try_for_each(|parameter| write!(f, "\n    {}: {}", parameter.name, ParameterSummary(parameter)))?;
            }
        }
        Ok(())
    }
}

/// One-line summary of a parameter: range, unit, default and description.
pub(crate) struct ParameterSummary<'a>(pub(crate) &'a Parameter);

impl fmt::Display for ParameterSummary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Parameter { unit, default, min, max, description, .. } = self.0;
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        write!(f, "{min} to {max}{unit}, default {default}. {description}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn catalogue_lists_every_stage_and_parameter() {
        let json: serde_json::Value =
            serde_json::from_str(&Catalogue::new(&Launch::default()).unwrap().json()).unwrap();
        let course = json.pointer("/slots/3").unwrap();
        assert_eq!(course.pointer("/stages/0/parameters/0/unit").unwrap(), "°");
        let fusers = json.pointer("/slots/2/stages").unwrap().as_array().unwrap();
        assert_eq!(fusers.len(), Fuser::NAMES.len());
        assert_eq!(fusers[0].pointer("/name").unwrap(), Launch::default().fuser.stage.as_str());
        assert_eq!(fusers[0].pointer("/parts").unwrap(), &serde_json::json!(["wz", "aided"]));
        assert_eq!(fusers[1].pointer("/parts").unwrap(), &serde_json::json!([]));
        let text = Catalogue::new(&Launch::default()).unwrap().to_string();
        assert!(text.contains("  multiple-model (default)\n    parts: wz + aided\n"), "{text}");
        assert!(text.contains("    declination_deg: -180 to 180 °, default 0. Magnetic declination"), "{text}");
    }
}
