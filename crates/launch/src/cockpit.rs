//! Where the system is shown in a browser: `[cockpit]`.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use serde::{Deserialize, Serialize};
use toml::Spanned;

use crate::{problem::Problem, walk::Section};

/// The port that is tried first where none is named.
const PORT: u16 = 8088;
/// Pages of others at most.
const ORIGINS_MAX: usize = 8;

/// Where the system is shown in a browser.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cockpit {
    /// Where it listens, beyond the loopback only with `tls`; a port that is taken is passed over for the next free one.
    pub listen: SocketAddr,
    /// What the page shows of itself. With it, also on the loopback, looking needs a token, too.
    pub tls: Option<CockpitTls>,
    /// Pages of others that may see everything at `/foxglove`, by their origins as browsers tell them, `https://app.foxglove.dev`.
    pub foxglove_origins: Vec<String>,
}

/// The certificate that the page is served with, PEM.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CockpitTls {
    /// The certificate, and those that it is signed with.
    pub cert: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

impl Default for Cockpit {
    fn default() -> Self {
        Self { listen: (Ipv4Addr::LOCALHOST, PORT).into(), tls: None, foxglove_origins: Vec::new() }
    }
}

impl Cockpit {
    /// What an address must be, for people.
    pub const EXPECTED: &str = "an address of the loopback, as 127.0.0.1:8088, or with tls any; from elsewhere `ssh -L 8088:127.0.0.1:8088 HOST` leads to the loopback";

    /// The address of a text, where it may be listened at: with TLS any, else one of the loopback.
    pub fn address(text: &str, has_tls: bool) -> Option<SocketAddr> {
        text.parse().ok().filter(|address: &SocketAddr| has_tls || address.ip().is_loopback())
    }
}

/// Reads `[cockpit]`.
pub(crate) fn cockpit(section: &mut Section<'_, '_>, out: &mut Cockpit) {
    let has_tls = section.has("tls");
    section.text("listen", Cockpit::EXPECTED, |text| Cockpit::address(text, has_tls), &mut out.listen);
    section.section("tls", |section| {
        let mut tls = CockpitTls::default();
        let files = [("cert", &mut tls.cert), ("key", &mut tls.key)];
        let taken = files.map(|(key, file)| section.text(key, "a path", |path| Some(path.into()), file));
        match ["cert", "key"].into_iter().find(|key| !section.has(key)) {
            Some(key) => {
                let remedy = "`plumb keys vehicle NAME --host HOST` makes a folder with cert.pem and key.pem";
                section.report_table(&format!("cockpit.tls: {key:?} is missing"), remedy);
            }
            None if taken.iter().all(|taken| *taken) => out.tls = Some(tls),
            None => {}
        }
    });
    let Some(listed) = section.texts("foxglove_origins", ORIGINS_MAX) else { return };
    for origin in listed.iter().filter(|origin| !is_origin(origin.get_ref())) {
        let title = format!("cockpit.foxglove_origins: {:?} is no origin of a page", origin.get_ref());
        section.report(Problem {
            note: Some(
                "whoever is named here sees everything and commands nothing; \"*\" and \"null\" would be everybody"
                    .into(),
            ),
            ..Problem::new(origin.span(), title, "expected scheme and host, as \"https://app.foxglove.dev\"")
        });
    }
    out.foxglove_origins = listed.into_iter().map(Spanned::into_inner).collect();
}

/// A scheme, a host or none, a port or none, in small letters, as a browser writes it (RFC 6454, 6.2).
fn is_origin(text: &str) -> bool {
    let Some((scheme, authority)) = text.split_once("://") else { return false };
    let is_scheme = scheme.starts_with(|first: char| first.is_ascii_lowercase())
        && scheme
            .chars()
            .all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || "+-.".contains(letter));
    let is_host = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || "-._:[]".contains(letter);
    is_scheme && authority.chars().all(is_host) && (!authority.is_empty() || !["http", "https"].contains(&scheme))
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    #[test]
    fn origins_are_taken_as_browsers_write_them_and_nothing_that_is_everybody() {
        let named = |text: &str| Launch::parse("x", &format!("cockpit.foxglove_origins = [{text:?}]"));
        for text in ["https://app.foxglove.dev", "http://localhost:8080", "http://[::1]:3000", "file://"] {
            assert_eq!(named(text).unwrap().cockpit.foxglove_origins, [text]);
        }
        for text in ["*", "null", "", "https://", "https://*.dev", "https://App.dev", "https://app.dev/", "app.dev"] {
            let shown = named(text).unwrap_err().to_string();
            assert!(shown.contains("no origin of a page"), "{text}: {shown}");
        }
        let many = format!("cockpit.foxglove_origins = {:?}", ["file://"; 9]);
        assert!(Launch::parse("x", &many).unwrap_err().to_string().contains("8 at most"));
    }

    #[test]
    fn with_certificate_and_key_any_address_is_taken() {
        let tls = "cockpit.tls = { cert = \"cert.pem\", key = \"key.pem\" }";
        let launch = Launch::parse("x", &format!("cockpit.listen = \"0.0.0.0:8088\"\n{tls}")).unwrap();
        assert_eq!(launch.cockpit.listen.to_string(), "0.0.0.0:8088");
        assert_eq!(launch.cockpit.tls.unwrap().key.to_str(), Some("key.pem"));
        let half = "cockpit.listen = \"0.0.0.0:8088\"\ncockpit.tls = { cert = \"cert.pem\" }";
        assert!(Launch::parse("x", half).unwrap_err().to_string().contains("\"key\" is missing"));
    }

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
