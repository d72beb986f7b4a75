//! What there is to choose from: slots, their stages, and the numbers by which these can be set.

use std::{collections::BTreeMap, fmt};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter, stage::Stage};
use host::HostableStage;
use launch::{Launch, Service};
use runtime::{RuntimeError, stage::build_stage};
use serde::Serialize;

/// Every slot with the stages that can fill it.
#[derive(Debug, Clone, Serialize)]
pub struct Catalogue {
    slots: Vec<Slot>,
}

#[derive(Debug, Clone, Serialize)]
struct Slot {
    slot: &'static str,
    stages: Vec<Entry>,
}

#[derive(Debug, Clone, Serialize)]
struct Entry {
    name: &'static str,
    /// It runs where nothing is said.
    is_default: bool,
    /// The stages it consists of; none for one that stands by itself.
    parts: &'static [&'static str],
    #[serde(serialize_with = "parameters")]
    parameters: &'static [Parameter],
}

impl Catalogue {
    /// All that there is: what this executable has, and the programs of a launch file, which are started to tell.
    pub fn new(launch: &Launch) -> Result<Self, RuntimeError> {
        let slots = vec![
            slot(Service::Gyro, launch, &Gyro::NAMES, Gyro::from_name)?,
            slot(Service::Accel, launch, &Accelerometer::NAMES, Accelerometer::from_name)?,
            slot(Service::Fuser, launch, &Fuser::NAMES, Fuser::from_name)?,
            slot(Service::Course, launch, &Course::NAMES, Course::from_name)?,
        ];
        Ok(Self { slots })
    }

    /// The catalogue for scripts: one object on one line.
    pub fn json(&self) -> String {
        // Numbers, strings and lists always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

fn slot<B: HostableStage + Clone>(
    slot: Service,
    launch: &Launch,
    names: &'static [&'static str],
    named: fn(&str) -> Option<B>,
) -> Result<Slot, RuntimeError> {
    let programs = launch.stages.iter().filter(|(_, program)| program.slot == slot).map(|(name, _)| name.as_str());
    let entry = |(index, name): (usize, &str)| {
        let mut launch = launch.clone();
        if let Some(filling) = launch.stage_mut(slot) {
            *filling = launch::StageConfig { stage: name.into(), set: BTreeMap::new() };
        }
        let stage = build_stage(slot, &launch, named)?;
        Ok(Entry { name: stage.name(), is_default: index == 0, parts: stage.parts(), parameters: stage.parameters() })
    };
    let stages = names.iter().copied().chain(programs).enumerate().map(entry).collect::<Result<_, RuntimeError>>()?;
    Ok(Slot { slot: slot.name(), stages })
}

fn parameters<S: serde::Serializer>(of: &&'static [Parameter], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(of.iter().map(|parameter| {
        let Parameter { name, unit, default, min: least, max: most, description: about } = parameter;
        serde_json::json!({
            "name": name, "unit": unit, "default": default, "least": least, "most": most, "about": about,
        })
    }))
}

impl fmt::Display for Catalogue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, Slot { slot, stages }) in self.slots.iter().enumerate() {
            write!(f, "{}{slot}", if index == 0 { "" } else { "\n" })?;
            for Entry { name, is_default, parts, parameters } in stages {
                write!(f, "\n  {name}{}", if *is_default { " (default)" } else { "" })?;
                if !parts.is_empty() {
                    write!(f, "\n    parts: {}", parts.join(" + "))?;
                }
                parameters
                    .iter()
                    .try_for_each(|parameter| write!(f, "\n    {}: {}", parameter.name, Told(parameter)))?;
            }
        }
        Ok(())
    }
}

/// A parameter's range, unit, default and meaning, on one line.
pub(crate) struct Told<'a>(pub(crate) &'a Parameter);

impl fmt::Display for Told<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Parameter { unit, default, min: least, max: most, description: about, .. } = self.0;
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        write!(f, "{least} to {most}{unit}, default {default}. {about}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_catalogue_has_every_stage_and_every_number_by_which_it_can_be_set() {
        let json: serde_json::Value =
            serde_json::from_str(&Catalogue::new(&Launch::default()).unwrap().json()).unwrap();
        let course = json.pointer("/slots/3").unwrap();
        assert_eq!(course.pointer("/stages/0/parameters/0/unit").unwrap(), "°");
        let fusers = json.pointer("/slots/2/stages").unwrap().as_array().unwrap();
        assert_eq!(fusers.len(), Fuser::NAMES.len());
        assert_eq!(fusers[0].pointer("/name").unwrap(), Launch::default().fuser.stage.as_str());
        assert_eq!(fusers[0].pointer("/parts").unwrap(), &serde_json::json!(["wz", "aided"]));
        assert_eq!(fusers[1].pointer("/parts").unwrap(), &serde_json::json!([]));
        let people = Catalogue::new(&Launch::default()).unwrap().to_string();
        assert!(people.contains("  multiple-model (default)\n    parts: wz + aided\n"), "{people}");
        assert!(people.contains("    declination_deg: -180 to 180 °, default 0. Magnetic declination"), "{people}");
    }
}
