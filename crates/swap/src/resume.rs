//! State from which a service resumes.

use messages::Checkpoint;
use serde::{Deserialize, Serialize};

/// State from which a restarted service or a candidate resumes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Resume {
    /// There is no checkpoint. The service starts with the oldest messages of its inputs.
    Fresh,
    /// State of an earlier incarnation or of another stage.
    #[serde(with = "checkpoint_words")]
    Checkpoint(Box<Checkpoint>),
    /// Position of a source.
    Source {
        /// Next tick to publish.
        next_tick: u64,
        /// Time on CLOCK_MONOTONIC, in ns, at which the first tick was due; 0 if no tick has been
        /// due yet.
        start_ns: u64,
        /// Timestamp of a published sample minus the sensor's own timestamp, ns.
        offset_ns: i64,
    },
}

impl Resume {
    /// Returns the checkpoint, or `None` for a fresh start or the position of a source.
    pub fn checkpoint(&self) -> Option<&Checkpoint> {
        match self {
            Self::Checkpoint(checkpoint) => Some(checkpoint),
            Self::Fresh | Self::Source { .. } => None,
        }
    }

    /// Returns the next tick, or `None` for a fresh start.
    pub fn next_tick(&self) -> Option<u64> {
        match self {
            Self::Fresh => None,
            Self::Checkpoint(checkpoint) => Some(checkpoint.next_tick),
            Self::Source { next_tick, .. } => Some(*next_tick),
        }
    }
}

/// Serialises a checkpoint as a list of words.
mod checkpoint_words {
    use messages::Checkpoint;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(checkpoint: &Checkpoint, serializer: S) -> Result<S::Ok, S::Error> {
        bytemuck::cast_slice::<Checkpoint, u64>(std::slice::from_ref(checkpoint)).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Box<Checkpoint>, D::Error> {
        let words = Vec::<u64>::deserialize(deserializer)?;
        match bytemuck::try_cast_slice::<u64, Checkpoint>(&words) {
            Ok([checkpoint]) => Ok(Box::new(*checkpoint)),
            Ok(_) | Err(_) => {
                let expected = format!("a checkpoint of {} words", size_of::<Checkpoint>() / size_of::<u64>());
                Err(D::Error::invalid_length(words.len(), &expected.as_str()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checkpoint_is_serialised_as_its_words() {
        let mut checkpoint: Checkpoint = bytemuck::Zeroable::zeroed();
        (checkpoint.next_tick, checkpoint.incarnation) = (u64::MAX, 7);
        let resume = Resume::Checkpoint(Box::new(checkpoint));
        let text = serde_json::to_string(&resume).unwrap();
        assert!(text.starts_with("{\"Checkpoint\":[18446744073709551615,"), "{}", &text[..60]);
        assert_eq!(serde_json::from_str::<Resume>(&text).unwrap(), resume);
        let truncated = serde_json::from_str::<Resume>("{\"Checkpoint\":[1,2]}").unwrap_err().to_string();
        assert!(truncated.contains("expected a checkpoint of "), "{truncated}");
    }
}
