//! Error that ends the service `drivers`.

use bus::BusError;
use decoders::lines::LinesError;
use mapping::MappingError;
use runtime::RuntimeError;

/// Error that ends the service.
#[derive(Debug, thiserror::Error)]
pub enum DriversError {
    /// The system could not be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The column mapping is invalid.
    #[error(transparent)]
    Mapping(#[from] MappingError),
    /// The settings of a text format are invalid.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// A thread could not be started.
    #[error("cannot start a thread of the drivers: {0}")]
    Thread(#[from] std::io::Error),
}
