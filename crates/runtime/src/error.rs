//! Errors that end a service.

use std::io;

use attitude::parameters::ParameterError;
use bus::BusError;
use launch::{Service, Slot};

/// Error that ends a service.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The configuration on standard input is invalid.
    #[error("invalid configuration of service {service} on standard input: {cause}; start services with `plumb up`")]
    ServiceConfig {
        /// Service that was started.
        service: Service,
        /// Problem with the configuration.
        cause: String,
    },
    /// A system call failed.
    #[error("{doing}: {cause}")]
    System {
        /// Operation that failed.
        doing: &'static str,
        /// Error of the system call.
        cause: io::Error,
    },
    /// The stage does not exist.
    #[error("slot `{slot}`: unknown stage `{stage}`; `plumb stage list` lists the stages")]
    UnknownStage {
        /// Slot of the stage.
        slot: Slot,
        /// Name of the stage.
        stage: String,
    },
    /// An external stage could not be started.
    #[error(transparent)]
    ExternalStage(#[from] host::HostError),
    /// A stage failed permanently, or the service cannot use its settings.
    #[error("slot `{slot}` failed: {cause}")]
    StageFailed {
        /// Slot of the stage.
        slot: Slot,
        /// Cause of the failure.
        cause: String,
    },
    /// The stage rejected a parameter.
    #[error("cannot set `{name}` of stage `{stage}` in slot `{slot}`: {cause}")]
    Parameter {
        /// Slot of the stage.
        slot: Slot,
        /// Name of the stage.
        stage: String,
        /// Name of the parameter.
        name: String,
        /// Cause of the rejection.
        cause: ParameterError,
    },
}
