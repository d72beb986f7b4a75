//! Where the system is shown in a browser: `[cockpit]`.

use std::net::{Ipv4Addr, SocketAddr};

use serde::{Deserialize, Serialize};

use crate::walk::Section;

/// The port that is tried first where none is named.
const PORT: u16 = 8088;

/// Where the system is shown in a browser.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cockpit {
    /// An address of the loopback; a port that is taken is passed over for the next free one.
    pub listen: SocketAddr,
}

impl Default for Cockpit {
    fn default() -> Self {
        Self { listen: (Ipv4Addr::LOCALHOST, PORT).into() }
    }
}

impl Cockpit {
    /// What an address must be, for people.
    pub const EXPECTED: &str =
        "an address of the loopback, as 127.0.0.1:8088; from elsewhere `ssh -L 8088:127.0.0.1:8088 HOST` leads there";

    /// The address of a text, where it is one of the loopback.
    pub fn address(text: &str) -> Option<SocketAddr> {
        text.parse().ok().filter(|address: &SocketAddr| address.ip().is_loopback())
    }
}

/// Reads `[cockpit]`.
pub(crate) fn cockpit(section: &mut Section<'_, '_>, out: &mut Cockpit) {
    section.text("listen", Cockpit::EXPECTED, Cockpit::address, &mut out.listen);
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    #[test]
    fn an_address_of_the_loopback_is_taken_and_any_other_is_refused_with_the_way_in() {
        for (text, expected) in [("127.0.0.1:9000", "127.0.0.1:9000"), ("[::1]:9000", "[::1]:9000")] {
            let launch = Launch::parse("x", &format!("cockpit.listen = {text:?}")).unwrap();
            assert_eq!(launch.cockpit.listen.to_string(), expected);
        }
        for text in ["0.0.0.0:8088", "192.168.1.5:8088", "localhost:8088", "127.0.0.1", "[::]:8088", ""] {
            let shown = Launch::parse("x", &format!("cockpit.listen = {text:?}")).unwrap_err().to_string();
            assert!(shown.contains("an address of the loopback") && shown.contains("ssh -L"), "{text}: {shown}");
        }
    }
}
