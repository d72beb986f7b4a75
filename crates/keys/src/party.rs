//! Roles, names and hosts of parties.

use std::{fmt, net::Ipv6Addr, str::FromStr};

use serde::Serialize;

use crate::KeysError;

/// Maximum length of a party name, bytes.
const MAX_NAME: usize = 32;
/// Maximum length of a host name, bytes (RFC 1035, 2.3.4).
const MAX_HOST: usize = 253;

/// Role of a party, which determines its permissions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Party that publishes under its own name and accepts commands under that name.
    Vehicle,
    /// Party that reads everything and sends commands.
    Operator,
    /// Party that reads everything.
    Viewer,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 3] = [Self::Vehicle, Self::Operator, Self::Viewer];

    /// Returns the role as written in party names: `vehicle`, `operator` or `viewer`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Operator => "operator",
            Self::Viewer => "viewer",
        }
    }
}

/// Holder of a certificate: a role and a name.
///
/// Written as `vehicle.alpha`, which is also the certificate's common name and the folder's name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Party {
    role: Role,
    name: String,
}

impl Party {
    /// Creates a party.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::InvalidName`] unless the name is 1 to 32 characters of a-z, 0-9, - and
    /// _. Such a name is a single chunk of a key expression and has no special meaning there.
    pub fn new(role: Role, name: &str) -> Result<Self, KeysError> {
        let legal = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if !(1..=MAX_NAME).contains(&name.len()) || !name.chars().all(legal) {
            return Err(KeysError::InvalidName { name: name.into() });
        }
        Ok(Self { role, name: name.into() })
    }

    /// Returns the role.
    pub fn role(&self) -> Role {
        self.role
    }

    /// Returns the name without the role.
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
            _ => Err(KeysError::InvalidParty { text: text.into() }),
        }
    }
}

impl Serialize for Party {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// IPv4 address or DNS name at which a router or vehicle is reached.
///
/// A server certificate is valid only for the hosts it names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Host(String);

impl Host {
    /// Returns the Zenoh endpoint `quic/HOST:PORT`.
    pub fn endpoint(&self, port: u16) -> String {
        format!("quic/{}:{port}", self.0)
    }

    /// Returns the address or name as text.
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
        // This check also accepts IPv4 addresses.
        if is_name {
            Ok(Self(text.into()))
        } else if text.parse::<Ipv6Addr>().is_ok() {
            Err(KeysError::Ipv6Host { text: text.into() })
        } else {
            Err(KeysError::InvalidHost { text: text.into() })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn party_text_round_trips() {
        for text in ["vehicle.alpha", "operator.a", "viewer.wall-display_2"] {
            assert_eq!(text.parse::<Party>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn party_names_with_special_characters_are_rejected() {
        let long = "a".repeat(33);
        for name in ["", "*", "**", "a/b", "..", "@live", "a b", "Alpha", "a$*", "a#", "é", "a.b", &long] {
            assert!(matches!(Party::new(Role::Vehicle, name), Err(KeysError::InvalidName { .. })), "{name}");
        }
        for text in ["alpha", "router.alpha", "vehicle", "vehicle.", ".alpha", "Vehicle.alpha"] {
            assert!(text.parse::<Party>().is_err(), "{text}");
        }
    }

    #[test]
    fn host_accepts_ipv4_and_names_and_rejects_ipv6() {
        for (text, endpoint) in
            [("127.0.0.1", "quic/127.0.0.1:7447"), ("router.example.net", "quic/router.example.net:7447")]
        {
            assert_eq!(text.parse::<Host>().unwrap().endpoint(7447), endpoint);
        }
        for text in ["", "a b", "quic/a:7447", "a:7447", "[fd00::1]", "a..b", "-a", "a\"b", "ü.net"] {
            assert!(text.parse::<Host>().is_err(), "{text}");
        }
        for text in ["fd00::1", "::1", "::ffff:10.0.0.1"] {
            assert!(matches!(text.parse::<Host>(), Err(KeysError::Ipv6Host { .. })), "{text}");
        }
    }
}
