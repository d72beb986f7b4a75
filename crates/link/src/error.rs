//! Error of a network session.

use foreign::ForeignText;

/// Error of a network operation.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The session could not be opened.
    #[error("opening {endpoints}: {cause}; check that the port is free and the certificates exist")]
    Open {
        /// Endpoints of the session.
        endpoints: String,
        /// Zenoh error.
        cause: ForeignText,
    },
    /// No endpoint could be reached.
    #[error("connecting: no connection after {limit_s} s: {reason}")]
    Unreachable {
        /// Duration of the attempts, s.
        limit_s: u64,
        /// Each endpoint with the reason why it is unreachable.
        reason: String,
    },
    /// A certificate of this program is invalid.
    #[error(transparent)]
    Certificate(#[from] keys::KeysError),
    /// The endpoint has an IPv6 address, which is not supported over QUIC.
    #[error("connecting to {endpoint}: IPv6 addresses are not supported over QUIC; use a DNS name or an IPv4 address")]
    Ipv6 {
        /// Endpoint that contains the address.
        endpoint: String,
    },
    /// The endpoints or their security settings are invalid.
    #[error("setting {what}: {cause}")]
    Config {
        /// Invalid setting.
        what: &'static str,
        /// Problem with the setting.
        cause: ForeignText,
    },
    /// All ports that were tried are in use.
    #[error(
        "listening at {endpoint}: this port and the next {tried} ports are in use; set another one in [gateway] listen"
    )]
    NoFreePort {
        /// First endpoint tried.
        endpoint: String,
        /// Number of further ports tried.
        tried: u16,
    },
    /// A Zenoh operation on a key failed.
    #[error("{operation} {key}: {cause}")]
    Key {
        /// Operation that failed.
        operation: &'static str,
        /// Key of the operation.
        key: String,
        /// Zenoh error.
        cause: ForeignText,
    },
    /// The query received no response.
    #[error("querying {key}: no response within {limit_s:.0} s; `plumb station` lists the visible vehicles")]
    NoResponse {
        /// Key of the query.
        key: String,
        /// Timeout of the query, s.
        limit_s: f64,
    },
    /// The query was rejected.
    #[error("querying {key}: rejected: {}", reason.with_lines())]
    Rejected {
        /// Key of the query.
        key: String,
        /// Reason, written by the vehicle.
        reason: ForeignText,
    },
    /// The response is invalid.
    #[error("querying {key}: {cause}")]
    InvalidResponse {
        /// Key of the query.
        key: String,
        /// Error in the response.
        cause: wire::DecodeError,
    },
}
