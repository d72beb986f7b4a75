//! Why a service ended.

use std::io;

use attitude::parameters::ParameterError;
use bus::BusError;
use launch::Service;

/// Why a service ended.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The configuration on standard input were not those of a supervisor.
    #[error("reading the configuration of service {service}: {cause}; services are started by `plumb up`")]
    ServiceConfig {
        /// Who was to read them.
        service: Service,
        /// What is wrong with them.
        cause: String,
    },
    /// The system could not be asked for something.
    #[error("{doing}: {cause}")]
    System {
        /// What was being done.
        doing: &'static str,
        /// What the system answered.
        cause: io::Error,
    },
    /// A stage that is not there.
    #[error("filling the slot `{slot}`: there is no stage `{stage}`")]
    Stage {
        /// The slot.
        slot: Service,
        /// The name asked for.
        stage: String,
    },
    /// A stage that is a program of its own does not start.
    #[error(transparent)]
    Program(#[from] host::HostError),
    /// A stage cannot go on.
    #[error("filling the slot `{slot}`: {why}")]
    Failed {
        /// The slot.
        slot: Service,
        /// Why not.
        why: String,
    },
    /// A parameter that the stage does not take.
    #[error("setting `{name}` of the stage `{stage}` in the slot `{slot}`: {cause}")]
    Parameter {
        /// The slot.
        slot: Service,
        /// The stage.
        stage: String,
        /// The parameter.
        name: String,
        /// What is wrong with it.
        cause: ParameterError,
    },
}
