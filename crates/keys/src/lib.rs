//! Certificates and access lists for vehicles, operators and viewers on a network.
//!
//! Input: names of parties.
//! Output: one folder per party with its certificate, private key and Zenoh configuration, to be
//! copied to the party's machine.
//! Time: the wall clock, for the validity of certificates.
//! Failure: existing files are replaced only on request.
//!
//! | module | contents |
//! | --- | --- |
//! | [`party`] | roles, names and hosts |
//! | [`certificate`] | the authority and the certificates it issues |
//! | [`access`] | the access list of a router or gateway |
//! | [`configuration`] | the Zenoh configurations of router, vehicle and ground station |
//! | [`validity`] | check whether a certificate is valid now |
//! | [`folder`] | the key folder on disk |
#![forbid(unsafe_code)]

pub mod access;
pub mod certificate;
pub mod configuration;
pub mod folder;
pub mod party;
pub mod validity;

use std::{io, path::PathBuf};

use foreign::ForeignText;

pub use folder::{Holder, Keys, WrittenFolder};
pub use party::{Host, Party, Role};

/// Error while creating or reading keys.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// The name cannot be part of a key expression or the name of a folder.
    #[error("invalid name `{name}`: expected 1 to 32 characters of a-z, 0-9, - and _")]
    InvalidName {
        /// The rejected name.
        name: String,
    },
    /// The text is not of the form `role.name`.
    #[error("invalid party `{text}`: expected vehicle.NAME, operator.NAME or viewer.NAME")]
    InvalidParty {
        /// The rejected text.
        text: String,
    },
    /// The text is neither an IPv4 address nor a host name.
    #[error("invalid host `{text}`: expected an IPv4 address or a host name")]
    InvalidHost {
        /// The rejected text.
        text: String,
    },
    /// The host is an IPv6 address, which Zenoh does not support over QUIC.
    #[error(
        "unsupported host `{text}`: Zenoh cannot connect to an IPv6 address over QUIC; use a DNS name or an IPv4 address"
    )]
    Ipv6Host {
        /// The rejected address.
        text: String,
    },
    /// The validity period is out of range.
    #[error("invalid validity of {days} days: expected 1 to {max}")]
    InvalidValidity {
        /// The requested validity, days.
        days: u32,
        /// Maximum validity, days.
        max: u32,
    },
    /// The target file or folder exists and replacing it was not requested.
    #[error("{path} already exists; use --force to replace it{consequence}", path = foreign::path(path))]
    Exists {
        /// Path of the existing file or folder.
        path: PathBuf,
        /// Consequence of replacing the file or folder, appended to the message.
        consequence: &'static str,
    },
    /// The folder contains no authority.
    #[error("no authority at {path}; create one with `plumb keys init`", path = foreign::path(path))]
    NoAuthority {
        /// Expected path of the authority's certificate.
        path: PathBuf,
    },
    /// The name belongs to a revoked party. The revoked certificate may still be valid.
    #[error("{party} was revoked and its certificate is valid until {until}; choose another name")]
    Revoked {
        /// The revoked party.
        party: Party,
        /// Last day on which the revoked certificate is valid, `YYYY-MM-DD`, UTC.
        until: String,
    },
    /// The folder contains no such party.
    #[error("no {party} in {folder}; list the parties with `plumb keys list`", folder = foreign::path(folder))]
    UnknownParty {
        /// The missing party.
        party: Party,
        /// Path of the searched folder.
        folder: PathBuf,
    },
    /// The router's configuration lacks the lines that enclose the access list.
    #[error("cannot write the access list to {path}: the lines `// {begin}` and `// {end}` are missing; restore them", begin = configuration::LIST_START, end = configuration::LIST_END, path = foreign::path(path))]
    MissingListMarkers {
        /// Path of the router's configuration.
        path: PathBuf,
    },
    /// The file is not a valid certificate, key or import list.
    #[error("cannot read {path}: {why}", path = foreign::path(path))]
    InvalidFile {
        /// Path of the invalid file.
        path: PathBuf,
        /// Reason why the file is invalid.
        why: ForeignText,
    },
    /// The certificate has expired.
    #[error(
        "the certificate of {name}, {path}, expired on {until} (today is {today} on this machine); on the machine of the authority run `{remedy}` with the options it was created with, then copy the folder again", path = foreign::path(path)
    )]
    Expired {
        /// Common name of the certificate.
        name: String,
        /// Path of the certificate file.
        path: PathBuf,
        /// Last day of validity, `YYYY-MM-DD`, UTC.
        until: String,
        /// Today's date by the machine's clock, UTC.
        today: String,
        /// Command that creates a new certificate.
        remedy: String,
    },
    /// The certificate is not valid yet.
    #[error(
        "the certificate of {name}, {path}, is valid from {from}, but today is {today} on this machine; set the clock, for example with timedatectl", path = foreign::path(path)
    )]
    NotYetValid {
        /// Common name of the certificate.
        name: String,
        /// Path of the certificate file.
        path: PathBuf,
        /// First day of validity, `YYYY-MM-DD`, UTC.
        from: String,
        /// Today's date by the machine's clock, UTC.
        today: String,
    },
    /// Creating a certificate failed.
    #[error("cannot create the certificate of {subject}: {cause}")]
    CreateCertificate {
        /// Common name of the certificate.
        subject: String,
        /// Error of the certificate library.
        cause: rcgen::Error,
    },
    /// A file operation failed.
    #[error("cannot {action} {path}: {cause}", path = foreign::path(path))]
    Io {
        /// Verb of the operation: read, write, create, move or remove.
        action: &'static str,
        /// Path of the file or folder.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
}

impl KeysError {
    /// Returns the exit code of `plumb`: 2 for a usage error, 3 for an invalid file, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::InvalidName { .. }
            | Self::InvalidParty { .. }
            | Self::InvalidHost { .. }
            | Self::Ipv6Host { .. }
            | Self::InvalidValidity { .. } => 2,
            Self::MissingListMarkers { .. } | Self::InvalidFile { .. } => 3,
            _ => 1,
        }
    }
}
