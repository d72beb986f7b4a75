//! Why there is no score.

use std::{io, path::PathBuf};

use attitude::parameters::ParameterError;
use ingest::source::SourceError;
use launch::Service;
use pipeline::CollectorError;
use recording::RecordingError;
use runtime::RuntimeError;
use scenario::ScenarioError;

/// Why there is no score.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// A stage that is not there.
    #[error("choosing the stage of the slot `{slot}`: there is no `{found}`{}; there are {}", match near {
        Some(near) => format!(", did you mean `{near}`?"),
        None => String::new(),
    }, known.join(", "))]
    Stage {
        /// The slot.
        slot: Service,
        /// The name asked for.
        found: String,
        /// The stage of nearly that name.
        near: Option<&'static str>,
        /// All stages of the slot.
        known: &'static [&'static str],
    },
    /// The same stage twice.
    #[error("choosing fusers: `{name}` is named twice")]
    FuserTwice {
        /// The stage.
        name: String,
    },
    /// A parameter that no chosen stage has.
    #[error("setting {key}: no chosen stage has it{}; there are\n{known}", match near {
        Some(near) => format!(", did you mean `{near}`?"),
        None => String::new(),
    })]
    Key {
        /// The parameter asked for.
        key: String,
        /// The parameter of nearly that name.
        near: Option<&'static str>,
        /// Every parameter of the chosen stages, one a line.
        known: String,
    },
    /// A parameter with two values.
    #[error("setting {place}: it is set twice; keep one")]
    SetTwice {
        /// The parameter, as it was named.
        place: String,
    },
    /// Figures of a time without a sample.
    #[error("drawing {trial}: there is no sample from {from_s} s{}; it ends at {end_s:.3} s, so give another --from or --to", match to_s {
        Some(to_s) => format!(" to {to_s} s"),
        None => " on".into(),
    })]
    NothingToDraw {
        /// The trial.
        trial: String,
        /// From when on.
        from_s: f64,
        /// Until when.
        to_s: Option<f64>,
        /// The end.
        end_s: f64,
    },
    /// A parameter of more than one slot.
    #[error("setting {key}: more than one slot has it; say {}", places.join(" or "))]
    Ambiguous {
        /// The parameter.
        key: String,
        /// How to say which.
        places: Vec<String>,
    },
    /// A value that the stage refuses.
    #[error("setting {key} of `{stage}`: {cause}")]
    Value {
        /// The parameter.
        key: String,
        /// The stage.
        stage: String,
        /// Why not.
        cause: ParameterError,
    },
    /// One receiver for several recordings.
    #[error("naming the fixes: {} belongs to one recording, there are {trials}; score it alone, or use --gnss auto", fixes.display())]
    FixesOfOne {
        /// The file of fixes.
        fixes: PathBuf,
        /// How many trials there are.
        trials: usize,
    },
    /// Two trials whose files would be the same.
    #[error("naming the trials: two are called `{name}`, and what is written for one would replace the other's")]
    NameTwice {
        /// The name.
        name: String,
    },
    /// A range of seeds that is none.
    #[error("simulating {text}: expected seed=A..B with A at most B and at most {} seeds", crate::seeds::MAX_SEEDS)]
    Seeds {
        /// The simulation.
        text: String,
    },
    /// A recording that cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A simulation that is not there.
    #[error("simulating: {0}")]
    Scenario(#[from] ScenarioError),
    /// The attitudes could not be collected or written.
    #[error(transparent)]
    Collector(#[from] CollectorError),
    /// The attitude would be written over the recording.
    #[error("writing {path}: that is the recording itself; give --out or --csv another folder")]
    OutIsTrial {
        /// The file.
        path: PathBuf,
    },
    /// The page would be written over the recording.
    #[error("writing {path}: that is the recording itself; give --report another name")]
    ReportIsTrial {
        /// The file.
        path: PathBuf,
    },
    /// No error tells which value is best.
    #[error(
        "trying values of {key}: no trial has a reference that counts, so no value is better than another; --reference names one"
    )]
    NothingToTuneBy {
        /// The parameter.
        key: String,
    },
    /// There is nothing that a PNG's text could be drawn with.
    #[error("drawing PNGs: {why}, or draw SVGs with --format svg")]
    Typeface {
        /// What is missing, and the remedy.
        why: String,
    },
    /// A slot could not be filled.
    #[error(transparent)]
    Slot(#[from] RuntimeError),
    /// The source of the readings failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A file or folder could not be written.
    #[error("writing {}: {cause}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
}

impl ScoreError {
    /// The exit code of `plumb`: 3 when an input file is wrong, 2 when the command line is, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Stage { .. }
            | Self::FuserTwice { .. }
            | Self::SetTwice { .. }
            | Self::NothingToDraw { .. }
            | Self::Key { .. }
            | Self::Ambiguous { .. }
            | Self::Value { .. }
            | Self::Scenario(_)
            | Self::FixesOfOne { .. }
            | Self::NameTwice { .. }
            | Self::Seeds { .. }
            | Self::ReportIsTrial { .. }
            | Self::NothingToTuneBy { .. }
            | Self::OutIsTrial { .. } => 2,
            Self::Recording(RecordingError::Write { .. }) => 1,
            Self::Recording(_) => 3,
            Self::Collector(_) | Self::Slot(_) | Self::Source(_) | Self::Write { .. } | Self::Typeface { .. } => 1,
        }
    }
}
