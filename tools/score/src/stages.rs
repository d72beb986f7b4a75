//! Which stages run, and how they are set.
//!
//! Input: names and settings as a person writes them. Output: a launch for each fuser, which the slots are filled by. Time: none.
//! Failure: a stage or parameter that does not exist is refused with those that do.

use std::{collections::BTreeMap, str::FromStr};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro, parameters::Parameter};
use launch::{Launch, Service};

use crate::{ScoreError, catalogue::Told, chain::Stages};

/// Jaro-Winkler similarity from which a name is another one misspelt.
const NEAR: f64 = 0.8;

/// The stages asked for. What is not named is as the launch has it.
#[derive(Debug, Clone, Default)]
pub struct Choice {
    /// Of the slot `gyro`.
    pub gyro: Option<String>,
    /// Of the slot `accel`.
    pub accel: Option<String>,
    /// Of the slot `course`.
    pub course: Option<String>,
    /// Of the slot `fuser`, side by side.
    pub fusers: Vec<String>,
    /// Calibration, mounting and limits, the usual stages with their settings, and the stages that are programs of their own.
    pub launch: Launch,
    /// Parameters that are to differ.
    pub settings: Vec<Setting>,
}

/// A parameter and its value, as `key=value`, `slot.key=value` or `stage.key=value`.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// The slot or stage that is meant, where it is said.
    pub of: Option<String>,
    /// The parameter's name.
    pub key: String,
    /// Its value, in the parameter's unit.
    pub value: f64,
}

impl Setting {
    /// As it was named.
    fn place(&self) -> String {
        self.of.as_ref().map_or_else(|| self.key.clone(), |of| format!("{of}.{}", self.key))
    }
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (place, value) = text.split_once('=').ok_or("expected key=value, as in beta=0.1")?;
        let value = value.trim().parse().map_err(|_| format!("expected a number after =, found {value:?}"))?;
        let (of, key) = match place.trim().split_once('.') {
            Some((of, key)) => (Some(of.into()), key),
            None => (None, place.trim()),
        };
        Ok(Self { of, key: key.into(), value })
    }
}

/// One launch for each fuser asked for, with the default limits of the source.
pub fn launches(choice: &Choice) -> Result<Vec<Launch>, ScoreError> {
    let mut common = choice.launch.clone();
    name(&mut common, Service::Gyro, choice.gyro.as_deref(), &Gyro::NAMES)?;
    name(&mut common, Service::Accel, choice.accel.as_deref(), &Accelerometer::NAMES)?;
    name(&mut common, Service::Course, choice.course.as_deref(), &Course::NAMES)?;
    let mut launches = vec![common.clone()];
    if !choice.fusers.is_empty() {
        launches.clear();
        for fuser in &choice.fusers {
            if launches.iter().any(|launch| launch.fuser.stage == *fuser) {
                return Err(ScoreError::FuserTwice { name: fuser.clone() });
            }
            let mut launch = common.clone();
            name(&mut launch, Service::Fuser, Some(fuser), &Fuser::NAMES)?;
            launches.push(launch);
        }
    }
    let mut set = Vec::new();
    for setting in &choice.settings {
        for (launch, slot) in apply(setting, &mut launches)? {
            if set.contains(&(launch, slot, &setting.key)) {
                return Err(ScoreError::SetTwice { place: setting.place() });
            }
            set.push((launch, slot, &setting.key));
        }
    }
    Ok(launches)
}

fn name(
    launch: &mut Launch,
    slot: Service,
    asked: Option<&str>,
    known: &'static [&'static str],
) -> Result<(), ScoreError> {
    let Some(found) = asked else { return Ok(()) };
    let is_program = launch.stages.get(found).is_some_and(|program| program.slot == slot);
    if !is_program && !known.contains(&found) {
        return Err(ScoreError::Stage { slot, found: found.into(), near: near(found, known.iter().copied()), known });
    }
    let filling = filling(launch, slot);
    if filling.stage != found {
        *filling = launch::StageConfig { stage: found.into(), set: BTreeMap::new() };
    }
    Ok(())
}

/// Gives the setting to every launch with a stage that has the parameter; which launches, and which slots of theirs, have it now.
pub(crate) fn apply(setting: &Setting, launches: &mut [Launch]) -> Result<Vec<(usize, Service)>, ScoreError> {
    let Setting { of, key, value } = setting;
    let meant = |slot: Service, stage: &str| of.as_ref().is_none_or(|of| of == slot.name() || of == stage);
    let (mut places, mut given): (Vec<Service>, Vec<_>) = Default::default();
    let (mut known, mut others): (Vec<(Service, &str, &Parameter)>, Vec<_>) = Default::default();
    for (index, launch) in launches.iter_mut().enumerate() {
        let mut stages = Stages::of(launch)?;
        for (slot, stage, parameters) in stages.parameters() {
            let list = if meant(slot, stage) { &mut known } else { &mut others };
            for parameter in parameters {
                if !list.contains(&(slot, stage, parameter)) {
                    list.push((slot, stage, parameter));
                }
            }
            if !meant(slot, stage) || !parameters.iter().any(|parameter| parameter.name == key) {
                continue;
            }
            let value_refused = |cause| ScoreError::Value { key: key.clone(), stage: stage.into(), cause };
            stages.set(slot, key, *value).map_err(value_refused)?;
            filling(launch, slot).set.insert(key.clone(), *value);
            given.push((index, slot));
            if !places.contains(&slot) {
                places.push(slot);
            }
        }
    }
    match places.len() {
        1 => Ok(given),
        0 => {
            // Where no chosen stage is of that name, all of them are told.
            let known = if known.is_empty() { others } else { known };
            let near = near(key, known.iter().map(|(_, _, parameter)| parameter.name).filter(|name| name != key));
            Err(ScoreError::Key { key: setting.place(), near, known: listed(&known) })
        }
        _ => Err(ScoreError::Ambiguous {
            key: key.clone(),
            places: places.iter().map(|slot| format!("{slot}.{key}")).collect(),
        }),
    }
}

fn filling(launch: &mut Launch, slot: Service) -> &mut launch::StageConfig {
    match slot {
        Service::Gyro => &mut launch.gyro,
        Service::Accel => &mut launch.accel,
        Service::Course => &mut launch.course,
        Service::Fuser | Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => &mut launch.fuser,
    }
}

fn listed(known: &[(Service, &str, &Parameter)]) -> String {
    if known.is_empty() {
        return "  none".into();
    }
    let line = |(slot, stage, parameter): &(Service, &str, &Parameter)| {
        format!("  {slot}.{} of {stage}: {}", parameter.name, Told(parameter))
    };
    known.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn near(found: &str, known: impl Iterator<Item = &'static str>) -> Option<&'static str> {
    known
        .map(|known| (strsim::jaro_winkler(found, known), known))
        .filter(|(similarity, _)| *similarity >= NEAR)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, known)| known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(fusers: &[&str], settings: &[&str]) -> Choice {
        Choice {
            fusers: fusers.iter().map(ToString::to_string).collect(),
            settings: settings.iter().map(|text| text.parse().unwrap()).collect(),
            ..Choice::default()
        }
    }

    #[test]
    fn nothing_asked_for_is_the_default_of_every_slot() {
        assert_eq!(launches(&Choice::default()).unwrap(), [Launch::default()]);
    }

    #[test]
    fn a_setting_goes_to_every_stage_that_has_it_and_to_no_other() {
        let chosen = launches(&choice(&["wz-closed", "wz"], &["declination_deg=11"])).unwrap();
        for launch in &chosen {
            assert_eq!(launch.course.set.get("declination_deg"), Some(&11.0));
            assert!(launch.fuser.set.is_empty() && launch.gyro.set.is_empty());
        }
        for of in ["course", "angles"] {
            assert_eq!(
                launches(&choice(&["wz-closed", "wz"], &[&format!("{of}.declination_deg=11")])).unwrap(),
                chosen
            );
        }
    }

    #[test]
    fn what_no_chosen_stage_has_is_refused_with_what_there_is() {
        for text in ["declination=11", "fuser.declination_deg=1", "gyro.declination_deg=1"] {
            let error = launches(&choice(&[], &[text])).unwrap_err();
            assert!(matches!(error, ScoreError::Key { .. }), "{error}");
            assert_eq!(error.exit_code(), 2);
        }
        let said = launches(&choice(&[], &["declination=11"])).unwrap_err().to_string();
        for words in ["did you mean `declination_deg`?", "course.declination_deg of angles: -180 to 180 °, default 0."]
        {
            assert!(said.contains(words), "{said}");
        }
    }

    #[test]
    fn a_value_out_of_range_is_refused_with_the_range() {
        let said = launches(&choice(&[], &["declination_deg=400"])).unwrap_err().to_string();
        assert_eq!(said, "setting declination_deg of `angles`: declination_deg: expected -180 to 180 °, found 400");
    }

    #[test]
    fn a_stage_misspelt_is_refused_with_the_one_meant() {
        let said = launches(&choice(&["wz-clsed"], &[])).unwrap_err().to_string();
        assert!(
            said.contains("no `wz-clsed`, did you mean `wz-closed`?; there are multiple-model, wz, wz-closed"),
            "{said}"
        );
        let twice = launches(&choice(&["wz", "wz"], &[])).unwrap_err();
        assert_eq!(twice.exit_code(), 2);
    }

    #[test]
    fn settings_are_read_as_people_write_them() {
        let setting = |of: Option<&str>, key: &str, value| Setting { of: of.map(Into::into), key: key.into(), value };
        assert_eq!("fuser.beta=1e-2".parse(), Ok(setting(Some("fuser"), "beta", 0.01)));
        assert_eq!("beta = 3".parse(), Ok(setting(None, "beta", 3.0)));
        for bad in ["beta", "beta=", "beta=x"] {
            assert!(bad.parse::<Setting>().is_err(), "{bad}");
        }
    }
}
