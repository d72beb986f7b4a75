//! Stages allowed in a slot, and their parameters.
//!
//! Input: a slot and the name of a stage, from a launch file or a request at run time.
//!
//! Output: whether the stage may run in the slot.
//!
//! Failure: an unknown name is rejected with the list of valid names.

use std::{collections::BTreeMap, fmt};

use mapping::names::nearest;
use toml::de::DeValue;

use crate::{
    ExternalStage, Slot, StageConfig,
    description::Key,
    keys::{Kind, keys},
    kind::{By, one_of, read_parameters},
    toml_reader::{Section, Values},
};

/// Slot of a promotion rule without the key `slot`.
pub(crate) const DEFAULT_RULE_SLOT: Slot = Slot::Fuser;

keys! {
    /// Keys of a slot's stage.
    struct StageKeys {
        /// Name of a built-in stage, or of a user-defined one in `[stages.NAME]`. `plumb stage
        /// list` shows all stages and their parameters.
        stage: String = String::new(), By(stage_name), example r#""aided""#;
        /// Parameters that differ from their defaults, by name.
        set: BTreeMap<String, f64> = BTreeMap::new(), By(stage_parameters);
    }
}

/// Reads the keys of a slot's stage.
pub(crate) fn read_keys(config: &mut StageConfig, section: &mut Section<'_, '_>) {
    let StageConfig { stage, set } = config.clone();
    let mut keys = StageKeys { stage, set };
    keys.read_keys(section);
    *config = StageConfig { stage: keys.stage, set: keys.set };
}

/// Checks that the slot has a stage of this name, built-in or external.
pub(crate) fn validate(
    slot: Slot,
    stage: &str,
    external: &BTreeMap<String, ExternalStage>,
) -> Result<(), UnknownStage> {
    let stages = stage_names(slot, external);
    if stages.contains(&stage) {
        return Ok(());
    }
    let accepts = |other: &Slot| stage_names(*other, external).contains(&stage);
    Err(UnknownStage {
        slot,
        stage: stage.into(),
        other_slot: Slot::ALL.into_iter().find(accepts),
        nearest: nearest(stage, stages.iter().copied()).map(str::to_owned),
        stages: stages.join(", "),
    })
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

/// Reads the key `stage` of a slot's section or of a promotion rule.
fn stage_name(section: &mut Section<'_, '_>, key: Key, out: &mut String) {
    let Some(slot) = slot(section) else {
        return section.typed(key, "a string", |name| name.as_str().map(str::to_owned), None, out);
    };
    let names = allowed_stages(section, slot).into_iter().map(|name| (name, name.to_owned()));
    one_of(names).read(section, key, out);
}

/// Reads the key `set`, a table of the stage's parameters.
fn stage_parameters(section: &mut Section<'_, '_>, key: Key, out: &mut BTreeMap<String, f64>) {
    if section.is_description() {
        return section.value(key, Values::new("table of numbers", None), out, |_, _| None);
    }
    let parameters = slot(section).and_then(|slot| {
        let chosen = section.peek("stage").filter(|stage| allowed_stages(section, slot).contains(stage));
        slot.parameters(chosen.unwrap_or(slot.default_stage()))
    });
    section.section(key, |section| {
        let Some(parameters) = parameters else {
            return section.numbers(|name, value| {
                out.insert(name.into(), value);
            });
        };
        read_parameters(section, parameters, |name, value| {
            out.insert(name.into(), value);
        });
    });
}

/// Returns the slot named by the key `slot`, or else by the section itself.
///
/// Returns `None` if the key `slot` is invalid. Nothing that depends on the slot is then checked,
/// because the key itself has a problem already.
fn slot(section: &Section<'_, '_>) -> Option<Slot> {
    let name = match section.path() {
        _ if section.has("slot") => section.peek("slot")?,
        "watch" => return Some(DEFAULT_RULE_SLOT),
        path => path,
    };
    Slot::ALL.into_iter().find(|slot| slot.name() == name)
}

/// Returns the names of the stages that may run in a slot: the built-in ones and the external
/// stages declared in the file being read.
fn allowed_stages<'t>(section: &Section<'t, '_>, slot: Slot) -> Vec<&'t str> {
    let own = section.root().get("stages").and_then(|stages| stages.get_ref().as_table());
    let is_for_slot = |stage: &DeValue<'_>| {
        let name = stage.as_table().and_then(|stage| stage.get("slot")?.get_ref().as_str());
        name == Some(slot.name())
    };
    let own = own.into_iter().flat_map(|stages| stages.iter());
    let own = own.filter(|(_, stage)| is_for_slot(stage.get_ref())).map(|(name, _)| name.get_ref().as_ref());
    slot.stages().iter().copied().chain(own).collect()
}

/// Returns the names of the slot's stages: first built-in, then external ones.
pub(crate) fn stage_names(slot: Slot, external: &BTreeMap<String, ExternalStage>) -> Vec<&str> {
    let external_names = external.iter().filter(|(_, stage)| stage.slot == slot).map(|(name, _)| name.as_str());
    slot.stages().iter().copied().chain(external_names).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

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
