//! Configuration of the stage in a slot.

use std::collections::BTreeMap;

/// Stage of a slot with its parameters.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StageConfig {
    /// Name of the stage: one of the slot's `NAMES` in `attitude`, or an external stage of the
    /// launch file.
    pub stage: String,
    /// Parameters that differ from their defaults, by name.
    pub set: BTreeMap<String, f64>,
}

impl StageConfig {
    /// Creates the stage of this name with its default parameters.
    pub fn new(stage: &str) -> Self {
        Self { stage: stage.into(), set: BTreeMap::new() }
    }
}
