//! Error that ends the gateway.

use bus::BusError;
use link::LinkError;
use runtime::RuntimeError;

/// Error that ended the gateway.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// The system cannot be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// Access to the bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The network cannot be opened, or a declaration failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The process exceeds its memory limit.
    #[error(
        "memory limit exceeded: {used_mib} MiB used, {limit_mib} MiB allowed; a client sends or requests too much; the gateway restarts and clients reconnect"
    )]
    Memory {
        /// Memory used, MiB.
        used_mib: u64,
        /// Memory limit, MiB.
        limit_mib: u64,
    },
    /// The network thread panicked.
    #[error("network thread terminated unexpectedly")]
    NetworkThread,
}
