//! Error of a client of remote vehicles.

use std::path::PathBuf;

use link::LinkError;

/// Error of a request to a remote vehicle.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// The network failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A QUIC endpoint needs certificates, but no key folder was given.
    #[error(
        "--keys is missing: {endpoint} requires a certificate; create a folder with `plumb keys operator NAME` or `plumb keys viewer NAME`"
    )]
    NoKeys {
        /// QUIC endpoint.
        endpoint: String,
    },
    /// The key folder is incomplete.
    #[error(
        "no {file} in {folder}: --keys expects a folder created by `plumb keys operator NAME` or `plumb keys viewer NAME`", folder = foreign::path(folder)
    )]
    NoFile {
        /// Key folder.
        folder: PathBuf,
        /// Name of the missing file.
        file: &'static str,
    },
    /// The vehicle did not reply.
    #[error(
        "vehicle {vehicle:?} did not reply within {limit_s:.0} s; list reachable vehicles with `plumb station` and the same --connect"
    )]
    NoVehicle {
        /// Vehicle name.
        vehicle: String,
        /// Timeout, s.
        limit_s: f64,
    },
    /// The vehicle does not publish this topic.
    #[error(
        "vehicle {vehicle:?} does not publish `{topic}`, only {sent}; add the topic to [gateway.rates] of its launch file"
    )]
    NotSent {
        /// Vehicle name.
        vehicle: String,
        /// Name of the requested topic.
        topic: String,
        /// Names of the published topics, separated by commas.
        sent: String,
    },
    /// The vehicle responds to queries, but rejects commands from this client.
    #[error(
        "vehicle {vehicle:?} accepts no commands from this client: its access list requires the certificate of an operator, --keys keys/operator.NAME"
    )]
    ReadOnly {
        /// Vehicle name.
        vehicle: String,
    },
    /// Commands require certificates, and a plain endpoint does not use any.
    #[error(
        "vehicle {vehicle:?} accepts no commands over {endpoint}, which is read-only because it has no certificates; run `plumb swap {slot} {stage}` on the vehicle, or use a quic/ endpoint with the certificate of an operator, --keys keys/operator.NAME (docs/how-to/secure.md)"
    )]
    PlainReadOnly {
        /// Vehicle name.
        vehicle: String,
        /// Plain endpoint.
        endpoint: String,
        /// Slot in the request.
        slot: String,
        /// Stage in the request.
        stage: String,
    },
}

impl RemoteError {
    /// Returns the exit code of `plumb`: 2 for a usage error, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NoKeys { .. } | Self::NoFile { .. } | Self::Link(LinkError::Ipv6 { .. }) => 2,
            Self::Link(_)
            | Self::NoVehicle { .. }
            | Self::NotSent { .. }
            | Self::ReadOnly { .. }
            | Self::PlainReadOnly { .. } => 1,
        }
    }
}
