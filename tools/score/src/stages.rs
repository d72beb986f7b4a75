//! Selection of stages and their settings.
//!
//! Input: names and settings from the command line.
//!
//! Output: one launch configuration per fuser.
//!
//! Failure: an unknown stage or parameter is rejected with a list of the known ones.

use std::{collections::BTreeMap, str::FromStr};

use attitude::parameters::Parameter;
use launch::{Launch, Slot};
use mapping::names::nearest;

use crate::{ScoreError, catalogue::ParameterSummary, chain::StageChain};

/// Selected stages. Slots without a selection keep the stage of the launch file.
#[derive(Debug, Clone, Default)]
pub struct StageSelection {
    /// Stage of the slot `gyro`.
    pub gyro: Option<String>,
    /// Stage of the slot `accel`.
    pub accel: Option<String>,
    /// Stage of the slot `course`.
    pub course: Option<String>,
    /// Stages of the slot `fuser` to compare.
    pub fusers: Vec<String>,
    /// Base configuration: calibration, mounting, limits, default stages with their settings, and
    /// external stages.
    pub launch: Launch,
    /// Parameters that override those of the base configuration.
    pub settings: Vec<Setting>,
}

/// A parameter and its value, written as `key=value`, `slot.key=value` or `stage.key=value`.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Slot or stage to which the setting applies; `None` for any stage that has the parameter.
    pub target: Option<String>,
    /// Name of the parameter.
    pub key: String,
    /// Value in the unit of the parameter.
    pub value: f64,
}

impl Setting {
    /// Returns the key as written in the setting, including the slot or stage, if any.
    fn qualified_key(&self) -> String {
        self.target.as_ref().map_or_else(|| self.key.clone(), |target| format!("{target}.{}", self.key))
    }
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text.split_once('=').ok_or("expected key=value, as in beta=0.1")?;
        let value = value.trim().parse().map_err(|_| format!("expected a number after =, found {value:?}"))?;
        let (target, key) = match name.trim().split_once('.') {
            Some((target, key)) => (Some(target.into()), key),
            None => (None, name.trim()),
        };
        Ok(Self { target, key: key.into(), value })
    }
}

/// Returns one launch configuration per selected fuser, with the settings applied.
///
/// # Errors
///
/// Returns an error for an unknown stage, a fuser given twice, and a setting that is unknown,
/// ambiguous, out of range or given twice.
pub fn launches(selection: &StageSelection) -> Result<Vec<Launch>, ScoreError> {
    let mut common = selection.launch.clone();
    select_stage(&mut common, Slot::Gyro, selection.gyro.as_deref())?;
    select_stage(&mut common, Slot::Accel, selection.accel.as_deref())?;
    select_stage(&mut common, Slot::Course, selection.course.as_deref())?;
    let mut launches = vec![common.clone()];
    if !selection.fusers.is_empty() {
        launches.clear();
        for fuser in &selection.fusers {
            if launches.iter().any(|launch| launch.fuser.stage == *fuser) {
                return Err(ScoreError::DuplicateFuser { name: fuser.clone() });
            }
            let mut launch = common.clone();
            select_stage(&mut launch, Slot::Fuser, Some(fuser))?;
            launches.push(launch);
        }
    }
    let mut set = Vec::new();
    for setting in &selection.settings {
        for (launch, slot) in apply(setting, &mut launches)? {
            if set.contains(&(launch, slot, &setting.key)) {
                return Err(ScoreError::DuplicateSetting { key: setting.qualified_key() });
            }
            set.push((launch, slot, &setting.key));
        }
    }
    Ok(launches)
}

fn select_stage(launch: &mut Launch, slot: Slot, requested: Option<&str>) -> Result<(), ScoreError> {
    let Some(name) = requested else { return Ok(()) };
    launch.validate_stage(slot, name)?;
    let config = launch.stage_mut(slot);
    if config.stage != name {
        *config = launch::StageConfig { stage: name.into(), set: BTreeMap::new() };
    }
    Ok(())
}

/// Applies a setting to every launch configuration in which a stage has the parameter.
///
/// Returns the index and the slot of each changed configuration.
///
/// # Errors
///
/// Returns an error if no stage has the parameter, if several slots have it, or if the value is out
/// of range.
pub(crate) fn apply(setting: &Setting, launches: &mut [Launch]) -> Result<Vec<(usize, Slot)>, ScoreError> {
    let Setting { target, key, value } = setting;
    let is_target =
        |slot: Slot, stage: &str| target.as_ref().is_none_or(|target| target == slot.name() || target == stage);
    let (mut slots, mut applied): (Vec<Slot>, Vec<_>) = Default::default();
    let (mut known, mut others): (Vec<(Slot, &str, &Parameter)>, Vec<_>) = Default::default();
    for (index, launch) in launches.iter_mut().enumerate() {
        let mut stages = StageChain::from_launch(launch)?;
        for (slot, stage, parameters) in stages.parameters() {
            let list = if is_target(slot, stage) { &mut known } else { &mut others };
            for parameter in parameters {
                if !list.contains(&(slot, stage, parameter)) {
                    list.push((slot, stage, parameter));
                }
            }
            if !is_target(slot, stage) || !parameters.iter().any(|parameter| parameter.name == key) {
                continue;
            }
            let invalid_value = |cause| ScoreError::InvalidValue { key: key.clone(), stage: stage.into(), cause };
            stages.set(slot, key, *value).map_err(invalid_value)?;
            launch.stage_mut(slot).set.insert(key.clone(), *value);
            applied.push((index, slot));
            if !slots.contains(&slot) {
                slots.push(slot);
            }
        }
    }
    match slots.len() {
        1 => Ok(applied),
        0 => {
            // If no selected stage matches the prefix of the key, the parameters of all selected
            // stages are listed.
            let known = if known.is_empty() { others } else { known };
            let closest = nearest(key, known.iter().map(|(_, _, parameter)| parameter.name).filter(|name| name != key));
            Err(ScoreError::UnknownKey { key: setting.qualified_key(), closest, known: format_parameters(&known) })
        }
        _ => Err(ScoreError::AmbiguousKey {
            key: key.clone(),
            candidates: slots.iter().map(|slot| format!("{slot}.{key}")).collect(),
        }),
    }
}

fn format_parameters(known: &[(Slot, &str, &Parameter)]) -> String {
    if known.is_empty() {
        return "  none".into();
    }
    let line = |(slot, stage, parameter): &(Slot, &str, &Parameter)| {
        format!("  {slot}.{} of {stage}: {}", parameter.name, ParameterSummary(parameter))
    };
    known.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selection(fusers: &[&str], settings: &[&str]) -> StageSelection {
        StageSelection {
            fusers: fusers.iter().map(ToString::to_string).collect(),
            settings: settings.iter().map(|text| text.parse().unwrap()).collect(),
            ..StageSelection::default()
        }
    }

    #[test]
    fn empty_selection_is_default_launch() {
        assert_eq!(launches(&StageSelection::default()).unwrap(), [Launch::default()]);
    }

    #[test]
    fn setting_applies_to_exactly_the_stages_that_have_it() {
        let selected = launches(&selection(&["wz-closed", "wz"], &["declination_deg=11"])).unwrap();
        for launch in &selected {
            assert_eq!(launch.course.set.get("declination_deg"), Some(&11.0));
            assert!(launch.fuser.set.is_empty() && launch.gyro.set.is_empty());
        }
        for target in ["course", "angles"] {
            assert_eq!(
                launches(&selection(&["wz-closed", "wz"], &[&format!("{target}.declination_deg=11")])).unwrap(),
                selected
            );
        }
    }

    #[test]
    fn unknown_setting_is_rejected_with_known_ones() {
        for text in ["declination=11", "fuser.declination_deg=1", "gyro.declination_deg=1"] {
            let error = launches(&selection(&[], &[text])).unwrap_err();
            assert!(matches!(error, ScoreError::UnknownKey { .. }), "{error}");
            assert_eq!(error.exit_code(), 2);
        }
        let message = launches(&selection(&[], &["declination=11"])).unwrap_err().to_string();
        for words in ["did you mean `declination_deg`?", "course.declination_deg of angles: -180 to 180 °, default 0."]
        {
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn out_of_range_value_is_rejected_with_range() {
        let message = launches(&selection(&[], &["declination_deg=400"])).unwrap_err().to_string();
        assert!(message.contains("`angles`") && message.contains("expected -180 to 180 °, found 400"), "{message}");
    }

    #[test]
    fn misspelt_stage_is_rejected_with_suggestion() {
        let message = launches(&selection(&["wz-clsed"], &[])).unwrap_err().to_string();
        assert!(message.contains("no stage named `wz-clsed`; did you mean `wz-closed`?"), "{message}");
        assert!(message.contains("stages of the slot `fuser`: multiple-model, wz, wz-closed"), "{message}");
        let twice = launches(&selection(&["wz", "wz"], &[])).unwrap_err();
        assert_eq!(twice.exit_code(), 2);
    }

    #[test]
    fn setting_is_parsed() {
        let setting =
            |target: Option<&str>, key: &str, value| Setting { target: target.map(Into::into), key: key.into(), value };
        assert_eq!("fuser.beta=1e-2".parse(), Ok(setting(Some("fuser"), "beta", 0.01)));
        assert_eq!("beta = 3".parse(), Ok(setting(None, "beta", 3.0)));
        for bad in ["beta", "beta=", "beta=x"] {
            assert!(bad.parse::<Setting>().is_err(), "{bad}");
        }
    }
}
