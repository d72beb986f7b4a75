//! Roles and names.

use std::{fmt, net::Ipv6Addr, str::FromStr};

use serde::Serialize;

use crate::KeysError;

/// Longest name.
const MAX_NAME: usize = 32;
/// Longest name of a host (RFC 1035, 2.3.4).
const MAX_HOST: usize = 253;

/// What a party is there for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Publishes below its own name and takes commands there.
    Vehicle,
    /// Reads everything and commands.
    Operator,
    /// Reads everything.
    Viewer,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 3] = [Self::Vehicle, Self::Operator, Self::Viewer];

    /// As it is written in names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Operator => "operator",
            Self::Viewer => "viewer",
        }
    }
}

/// Somebody with a certificate. Written as `vehicle.alpha`, which is also the common name of the certificate and the folder's name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Party {
    role: Role,
    name: String,
}

impl Party {
    /// A party whose name is 1 to 32 of a-z, 0-9, - and _: a chunk of a key expression that means nothing else.
    pub fn new(role: Role, name: &str) -> Result<Self, KeysError> {
        let legal = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if !(1..=MAX_NAME).contains(&name.len()) || !name.chars().all(legal) {
            return Err(KeysError::Name { name: name.into() });
        }
        Ok(Self { role, name: name.into() })
    }

    /// What it is there for.
    pub fn role(&self) -> Role {
        self.role
    }

    /// Its name, without the role.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl fmt::Display for Party {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.role.name(), self.name)
    }
}

impl FromStr for Party {
    type Err = KeysError;

    fn from_str(text: &str) -> Result<Self, KeysError> {
        let parts = text.split_once('.');
        let role = parts.and_then(|(role, _)| Role::ALL.into_iter().find(|it| it.name() == role));
        match (role, parts) {
            (Some(role), Some((_, name))) => Self::new(role, name),
            _ => Err(KeysError::Party { text: text.into() }),
        }
    }
}

impl Serialize for Party {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// An IPv4 address or a name at which a router or a vehicle is reached; its certificate is good for no other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Host(String);

impl Host {
    /// As it is written in an endpoint: `quic/HOST:PORT`.
    pub fn endpoint(&self, port: u16) -> String {
        format!("quic/{}:{port}", self.0)
    }

    /// The address or name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Host {
    type Err = KeysError;

    fn from_str(text: &str) -> Result<Self, KeysError> {
        let label = |label: &str| {
            !label.is_empty() && !label.starts_with('-') && label.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
        };
        let is_name = text.len() <= MAX_HOST && text.split('.').all(label);
        // An IPv4 address has the form of a name.
        if is_name {
            Ok(Self(text.into()))
        } else if text.parse::<Ipv6Addr>().is_ok() {
            Err(KeysError::Ipv6 { text: text.into() })
        } else {
            Err(KeysError::Host { text: text.into() })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_party_is_read_as_it_is_written() {
        for text in ["vehicle.alpha", "operator.a", "viewer.wall-display_2"] {
            assert_eq!(text.parse::<Party>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn what_could_be_taken_for_another_key_or_folder_is_no_name() {
        let long = "a".repeat(33);
        for name in ["", "*", "**", "a/b", "..", "@live", "a b", "Alpha", "a$*", "a#", "é", "a.b", &long] {
            assert!(matches!(Party::new(Role::Vehicle, name), Err(KeysError::Name { .. })), "{name}");
        }
        for text in ["alpha", "router.alpha", "vehicle", "vehicle.", ".alpha", "Vehicle.alpha"] {
            assert!(text.parse::<Party>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_host_is_an_address_or_a_name() {
        for (text, endpoint) in
            [("127.0.0.1", "quic/127.0.0.1:7447"), ("router.example.net", "quic/router.example.net:7447")]
        {
            assert_eq!(text.parse::<Host>().unwrap().endpoint(7447), endpoint);
        }
        for text in ["", "a b", "quic/a:7447", "a:7447", "[fd00::1]", "a..b", "-a", "a\"b", "ü.net"] {
            assert!(text.parse::<Host>().is_err(), "{text}");
        }
        for text in ["fd00::1", "::1", "::ffff:10.0.0.1"] {
            assert!(matches!(text.parse::<Host>(), Err(KeysError::Ipv6 { .. })), "{text}");
        }
    }
}
