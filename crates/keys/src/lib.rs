//! Who may do what beyond the board: an authority of one's own, certificates, and the router's access list.
//!
//! Input: names. Output: a folder per party, complete with certificate, private key and Zenoh configuration, to be copied to where the
//! party runs. Time: the clock, for the validity of certificates. Failure: nothing that exists is replaced unless asked to.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`party`] | roles and names |
//! | [`certificate`] | the authority, and what it signs |
//! | [`access`] | who may do what on which keys |
//! | [`configuration`] | the Zenoh configurations of router, vehicle and ground |
//! | [`validity`] | whether a certificate serves now |
//! | [`folder`] | all of it as files |
#![forbid(unsafe_code)]

pub mod access;
pub mod certificate;
pub mod configuration;
pub mod folder;
pub mod party;
pub mod validity;

use std::{io, path::PathBuf};

pub use folder::{Holder, Keys, Written};
pub use party::{Host, Party, Role};

/// Why keys could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// A name that no key expression and no folder can have.
    #[error("the name `{name}`: expected 1 to 32 of a-z, 0-9, - and _")]
    Name {
        /// What was given.
        name: String,
    },
    /// A party that is written otherwise than `role.name`.
    #[error("the party `{text}`: expected vehicle.NAME, operator.NAME or viewer.NAME")]
    Party {
        /// What was given.
        text: String,
    },
    /// A host that no certificate can name.
    #[error("the host `{text}`: expected an IPv4 address or a host name")]
    Host {
        /// What was given.
        text: String,
    },
    /// An address to which nobody could connect.
    #[error(
        "the host `{text}`: over QUIC, Zenoh connects to no IPv6 address; give a DNS name that leads there, or an IPv4 address"
    )]
    Ipv6 {
        /// What was given.
        text: String,
    },
    /// A validity that is none.
    #[error("a validity of {days} days: expected 1 to {max}")]
    Validity {
        /// What was given.
        days: u32,
        /// The longest.
        max: u32,
    },
    /// It is there already.
    #[error("making {path}: it exists; --force replaces it{consequence}")]
    Exists {
        /// The folder or file.
        path: PathBuf,
        /// What replacing it would mean.
        consequence: &'static str,
    },
    /// There is no authority here.
    #[error("reading {path}: there is no authority; `plumb keys init` makes one")]
    NoAuthority {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The name belonged to a party that was revoked, whose certificate may still be valid.
    #[error("the name {party} was revoked until its certificate ends on {until}; choose another")]
    Revoked {
        /// The party.
        party: Party,
        /// The last day of the revoked certificate.
        until: String,
    },
    /// There is no such party.
    #[error("there is no {party} in {folder}; `plumb keys list` tells who there is")]
    NoParty {
        /// The party.
        party: Party,
        /// Where it was looked for.
        folder: PathBuf,
    },
    /// The router's configuration has no place for the list any more.
    #[error("writing the access list into {path}: the lines `// {begin}` and `// {end}` are missing; put them back", begin = configuration::LIST_BEGIN, end = configuration::LIST_END)]
    NoPlaceForList {
        /// The configuration.
        path: PathBuf,
    },
    /// A file is no certificate, or no key.
    #[error("reading {path}: {why}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// A certificate is no longer good.
    #[error(
        "the certificate of {name}, {path}, ended on {until} (today is {today} here): `{remedy}`, where the authority is, makes another; repeat what else it was made with, and copy the folder again"
    )]
    Ended {
        /// Whose.
        name: String,
        /// The file.
        path: PathBuf,
        /// Its last day.
        until: String,
        /// What the clock says.
        today: String,
        /// The command that makes another.
        remedy: String,
    },
    /// A certificate is not good yet.
    #[error(
        "the certificate of {name}, {path}, begins on {from} and today is {today} here: is this machine's clock right? set the clock, for example by timedatectl"
    )]
    NotBegun {
        /// Whose.
        name: String,
        /// The file.
        path: PathBuf,
        /// Its first day.
        from: String,
        /// What the clock says.
        today: String,
    },
    /// A certificate could not be made.
    #[error("making the certificate of {subject}: {cause}")]
    Certificate {
        /// Whose.
        subject: String,
        /// What the library says.
        cause: rcgen::Error,
    },
    /// A file could not be read or written.
    #[error("{doing} {path}: {cause}")]
    File {
        /// What was being done.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
}

impl KeysError {
    /// The exit code of `plumb`: 2 when the command line is wrong, 3 when a file is, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Name { .. } | Self::Party { .. } | Self::Host { .. } | Self::Ipv6 { .. } | Self::Validity { .. } => 2,
            Self::NoPlaceForList { .. } | Self::Damaged { .. } => 3,
            _ => 1,
        }
    }
}
