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
    /// The orders on standard input were not those of a supervisor.
    #[error("reading the orders of service {service}: {cause}; services are started by `plumb up`")]
    Orders {
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
    /// A program of the user's, where there are no processes.
    #[error(
        "filling the slot `{slot}`: `{stage}` is a program of its own and runs only as a process; leave out --in-process"
    )]
    Program {
        /// The slot.
        slot: Service,
        /// The name asked for.
        stage: String,
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
