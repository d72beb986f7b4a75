//! Reason why a system did not start or did not end normally.

use std::{io, path::PathBuf};

use bus::BusError;
use control::ControlError;
use drivers::DriversError;
use flight::FlightError;
use foreign::ForeignText;
use launch::LaunchError;
use pipeline::CollectorError;
use readings::{flight_replay::FlightReplayError, source::SourceError};
use recording::RecordingError;
use runtime::RuntimeError;
use supervision::Failure;

/// Reason why a system did not start or did not end normally.
#[derive(Debug, thiserror::Error)]
pub enum UpError {
    /// The launch file is invalid.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The recording is invalid.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The source is invalid or failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The recorded flight cannot be replayed.
    #[error("{0}")]
    Flight(String),
    /// The launch file in a flight runs a program as a stage. The user has not permitted this.
    #[error(
        "the flight's own launch file runs the program `{command}` as stage {stage}, and can name any program; if you trust it, add --trust-programs, or name your own launch file: plumb up --launch LAUNCH --replay FLIGHT"
    )]
    UntrustedProgram {
        /// Name of the stage.
        stage: ForeignText,
        /// Command line of the program.
        command: ForeignText,
    },
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A stage failed or could not be created.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The system stopped prematurely.
    #[error(transparent)]
    Failed(#[from] Failure),
    /// The source yielded no reading.
    #[error(
        "{source_name} yielded no reading: no line or message had rate and force; name the columns with map, such as map=gx=COLUMN,gy=COLUMN,…, and their units with units, such as units=deg/s,g, or select another format"
    )]
    NoReadings {
        /// Name of the source.
        source_name: &'static str,
    },
    /// The launch file lists a service that this executable lacks.
    #[error(
        "{file}: services lists {service:?}, which needs the feature `{feature}`, which this build lacks; remove {service:?}, or rebuild plumb with --features {feature}", file = foreign::path(file)
    )]
    AbsentService {
        /// Path of the launch file.
        file: PathBuf,
        /// Name of the service.
        service: &'static str,
        /// Missing feature.
        feature: &'static str,
    },
    /// The configuration requires all slots on this host.
    #[error("cannot split the system over hosts: {reason}; run it live from \"sim\", \"bus\" or a device")]
    Split {
        /// Reason why the system cannot be split, shown to the user.
        reason: &'static str,
    },
    /// Standard input is the source but is a terminal.
    #[error(
        "cannot read samples from standard input: it is a terminal; pipe a program or a file into it: PROGRAM | plumb up --source stdin"
    )]
    Terminal,
    /// A run time was given for standard input without a rate. The run time is counted in readings.
    #[error(
        "--for needs the rate of the readings on standard input: add it to the source, such as --source 'stdin?rate_hz=100'"
    )]
    DurationWithoutRate,
    /// A receiver was given for a source that includes fixes.
    #[error(
        "--receiver needs a device as source, because simulations and recordings contain their own fixes; add for example --source serial:/dev/ttyUSB0"
    )]
    Receiver,
    /// A repeatable source has no date for the magnetic declination.
    #[error(
        "cannot compute true north: a repeatable source needs a fixed date; set its date in [course] of the launch file, for example date = 2026-11-23"
    )]
    NoDate,
    /// The current date is outside the validity period of the magnetic model.
    #[error(
        "cannot compute true north: the system clock shows {today}, but the magnetic model is valid from {} to {}; set the clock, or date in [course] of the launch file",
        launch::MODEL_YEARS.start(),
        launch::MODEL_YEARS.end()
    )]
    NoModel {
        /// Current date.
        today: String,
    },
    /// The output file is the recording being read.
    #[error("cannot write {path}: it is the recording itself; choose another file with --out", path = foreign::path(path))]
    OutIsReplay {
        /// Path of the file.
        path: PathBuf,
    },
    /// A receiver was configured for a run without a bus.
    #[error("cannot read the receiver: --in-process starts no drivers; omit --in-process or the receiver")]
    ReceiverWithoutBus,
    /// Standard input could not be decoded.
    #[error(transparent)]
    StandardInput(Box<DriversError>),
    /// A recording was requested for a run without a bus.
    #[error("cannot record the flight: --in-process has no bus to record; omit --in-process or --record")]
    NoBus,
    /// The recording could not be started.
    #[error(transparent)]
    Recorder(#[from] FlightError),
    /// A system call failed.
    #[error("{action}: {cause}")]
    System {
        /// Attempted action.
        action: String,
        /// Operating system error.
        cause: io::Error,
    },
    /// The attitudes could not be collected or written.
    #[error(transparent)]
    Collector(#[from] CollectorError),
    /// The control socket could not be opened.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// Some ticks have no attitude.
    #[error(
        "{lost} of {ticks_in} ticks were lost: a service did not respond, or restarted too late for the buffer of its topics"
    )]
    Lost {
        /// Number of lost ticks.
        lost: u64,
        /// Number of ticks received.
        ticks_in: u64,
    },
    /// The supervisor did not collect some of the published attitudes.
    #[error(
        "{} published but missing from the report's figures and the --out file: the supervisor did not collect them within buffer_s; check whether it was stopped or starved",
        launch::pluralize(*not_recorded, "attitude")
    )]
    NotRecorded {
        /// Number of attitudes not collected.
        not_recorded: u64,
    },
    /// Some lines of the output file lack the values of the fused state.
    #[error(
        "{} of the --out file without u, v, z and bias: the supervisor did not collect the fused states within buffer_s",
        launch::pluralize(*without_fused, "line")
    )]
    WithoutFused {
        /// Number of lines without the values of the fused state.
        without_fused: u64,
    },
}

impl From<FlightReplayError> for UpError {
    fn from(error: FlightReplayError) -> Self {
        match error {
            FlightReplayError::MissingReadings(lost) => Self::Flight(lost.to_string()),
            FlightReplayError::Source(error) => Self::Source(error),
        }
    }
}

impl From<DriversError> for UpError {
    fn from(error: DriversError) -> Self {
        Self::StandardInput(Box::new(error))
    }
}

impl UpError {
    /// Returns the exit code of `plumb`.
    ///
    /// The code is 3 for an invalid configuration or input file, 2 for an invalid command line, and
    /// 1 for every other error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Launch(_) | Self::Recording(_) | Self::Source(_) | Self::Flight(_) | Self::StandardInput(_) => 3,
            Self::AbsentService { .. } | Self::NoDate | Self::NoModel { .. } => 3,
            Self::UntrustedProgram { .. }
            | Self::OutIsReplay { .. }
            | Self::Split { .. }
            | Self::Terminal
            | Self::DurationWithoutRate
            | Self::Receiver
            | Self::ReceiverWithoutBus
            | Self::NoBus => 2,
            _ => 1,
        }
    }
}
