//! Error while joining or feeding a system.

use bus::BusError;

/// Error while joining or feeding a system.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    /// The system is not running or cannot be joined.
    #[error(transparent)]
    Bus(BusError),
    /// The system is running but has not opened the topic.
    #[error(
        "feeding the system {system:?}: its topic {topic:?} is not open; set source = \"bus\" in [ingest] of its launch file, or wait until ingest has started"
    )]
    TopicNotOpen {
        /// Name of the system.
        system: String,
        /// Name of the topic.
        topic: &'static str,
    },
}
