//! Errors of a scoring run.

use std::{io, path::PathBuf};

use attitude::parameters::ParameterError;
use foreign::ForeignText;
use launch::UnknownStage;
use pipeline::CollectorError;
use readings::source::SourceError;
use recording::RecordingError;
use runtime::RuntimeError;
use scenario::ScenarioError;

/// Error of a scoring run.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// The slot has no stage of this name.
    #[error(transparent)]
    UnknownStage(#[from] UnknownStage),
    /// A fuser is selected twice.
    #[error("fuser `{name}` is given twice; remove one")]
    DuplicateFuser {
        /// Name of the fuser.
        name: String,
    },
    /// An estimate has the name of a selected fuser or of another estimate.
    #[error(
        "estimate `{name}` has the name of a fuser or of another estimate; choose another NAME in --estimate NAME=FILE"
    )]
    DuplicateEstimate {
        /// Name of the estimate.
        name: String,
    },
    /// The name of an estimate cannot name a folder.
    #[error(
        "estimate {name:?}: the name is empty, begins with a dot, or contains a slash or a control character; choose another NAME in --estimate NAME=FILE"
    )]
    InvalidEstimateName {
        /// Name of the estimate.
        name: String,
    },
    /// An estimate is given for several trials.
    #[error("estimate `{name}` belongs to one recording, but there are {trials} trials; score it alone")]
    EstimateForSeveralTrials {
        /// Name of the estimate.
        name: String,
        /// Number of trials.
        trials: usize,
    },
    /// No selected stage has the parameter.
    #[error("no selected stage has a parameter `{key}`{}\navailable:\n{known}", match closest {
        Some(name) => format!("; did you mean `{name}`?"),
        None => String::new(),
    })]
    UnknownKey {
        /// Requested parameter.
        key: String,
        /// Parameter with the most similar name.
        closest: Option<&'static str>,
        /// All parameters of the selected stages, one per line.
        known: String,
    },
    /// A parameter is set twice.
    #[error("parameter {key} is set twice; keep one of the values")]
    DuplicateSetting {
        /// Parameter, as written by the user.
        key: String,
    },
    /// The trial has no sample in the time window of the figures.
    #[error("no sample of {trial} to draw from {from_s} s{}: the trial ends at {end_s:.3} s; change --from or --to", match to_s {
        Some(to_s) => format!(" to {to_s} s"),
        None => String::new(),
    })]
    EmptyPlotWindow {
        /// Name of the trial.
        trial: ForeignText,
        /// Start of the window, s.
        from_s: f64,
        /// End of the window, s; `None` for the end of the trial.
        to_s: Option<f64>,
        /// End of the trial, s.
        end_s: f64,
    },
    /// Several slots have the parameter.
    #[error("parameter {key} exists in several slots; use {}", candidates.join(" or "))]
    AmbiguousKey {
        /// Requested parameter.
        key: String,
        /// Unambiguous names of the parameter.
        candidates: Vec<String>,
    },
    /// The stage rejects the value of a parameter.
    #[error("setting {key} of `{stage}`: {cause}")]
    InvalidValue {
        /// Name of the parameter.
        key: String,
        /// Name of the stage.
        stage: String,
        /// Reason for the rejection.
        cause: ParameterError,
    },
    /// A fixes file is given for several trials.
    #[error(
        "{} belongs to one recording, but there are {trials} trials; score it alone, or use --gnss auto",
        foreign::path(fixes)
    )]
    FixesForSeveralTrials {
        /// Path of the fixes file.
        fixes: PathBuf,
        /// Number of trials.
        trials: usize,
    },
    /// Two trials have the same name, so that their output files would collide.
    #[error(
        "two trials are named `{name}`, so their output files would overwrite each other; rename one or score it separately"
    )]
    DuplicateTrialName {
        /// Common name of the trials.
        name: ForeignText,
    },
    /// The seed range is malformed, empty or too long.
    #[error("invalid seeds in {text}: expected seed=A..B with A at most B and at most {max} seeds")]
    InvalidSeedRange {
        /// Maximum number of seeds.
        max: u64,
        /// Name of the simulation.
        text: String,
    },
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A simulation is unknown or its parameters are invalid.
    #[error("simulation: {0}")]
    Scenario(#[from] ScenarioError),
    /// The attitudes cannot be collected or written.
    #[error(transparent)]
    Collector(#[from] CollectorError),
    /// An output file would overwrite the recording or an estimate.
    #[error(
        "writing {}: this is the recording itself or an estimate; choose another folder for --out-dir or --csv",
        foreign::path(path)
    )]
    OutputIsRecording {
        /// Path of the output file.
        path: PathBuf,
    },
    /// The report would overwrite the recording.
    #[error("writing {}: this is the recording itself; choose another file for --report", foreign::path(path))]
    ReportIsRecording {
        /// Path of the report.
        path: PathBuf,
    },
    /// No trial has a reference, so the values of the parameter cannot be ranked.
    #[error("cannot rank values of {key}: no trial has a scored reference; give one with --reference")]
    NoReferenceForTuning {
        /// Name of the parameter.
        key: String,
    },
    /// A slot cannot be started.
    #[error(transparent)]
    Slot(#[from] RuntimeError),
    /// The source of the readings failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A file or folder cannot be written.
    #[error("writing {}: {cause}", foreign::path(path))]
    Write {
        /// Path of the file or folder.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
}

impl ScoreError {
    /// Returns the exit code of `plumb`: 3 for an invalid input file, 2 for an invalid command
    /// line, otherwise 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::UnknownStage(_)
            | Self::DuplicateFuser { .. }
            | Self::DuplicateEstimate { .. }
            | Self::InvalidEstimateName { .. }
            | Self::EstimateForSeveralTrials { .. }
            | Self::DuplicateSetting { .. }
            | Self::EmptyPlotWindow { .. }
            | Self::UnknownKey { .. }
            | Self::AmbiguousKey { .. }
            | Self::InvalidValue { .. }
            | Self::Scenario(_)
            | Self::FixesForSeveralTrials { .. }
            | Self::DuplicateTrialName { .. }
            | Self::InvalidSeedRange { .. }
            | Self::ReportIsRecording { .. }
            | Self::NoReferenceForTuning { .. }
            | Self::OutputIsRecording { .. } => 2,
            Self::Recording(RecordingError::Write { .. }) => 1,
            Self::Recording(_) => 3,
            Self::Collector(_) | Self::Slot(_) | Self::Source(_) | Self::Write { .. } => 1,
        }
    }
}
