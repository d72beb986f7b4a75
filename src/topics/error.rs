//! Error while observing the topics of a system.

use bus::BusError;
use launch::LaunchError;
use mapping::names::UnknownName;

use crate::remote::RemoteError;

/// Error while observing a system.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ObserveError {
    /// The system on this machine cannot be observed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The vehicle cannot be reached over the network.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// The topic name is unknown.
    #[error(transparent)]
    UnknownTopic(#[from] UnknownName),
    /// The launch file that names the system is invalid.
    #[error(transparent)]
    Launch(#[from] LaunchError),
}

impl ObserveError {
    /// Returns the exit code of `plumb`: 2 for an unknown topic or a usage error, 3 for an
    /// invalid launch file, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::UnknownTopic(_) => 2,
            Self::Remote(error) => error.exit_code(),
            Self::Launch(_) => 3,
            Self::Bus(_) => 1,
        }
    }
}
