//! Web page of the system: `[cockpit]`.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use serde::{Deserialize, Serialize};
use toml::Spanned;

use crate::{problem::Problem, toml_reader::Section};

/// Default port.
const PORT: u16 = 8088;
const MAX_ORIGINS: usize = 8;

/// Settings of the cockpit service, which serves a web page of the system.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cockpit {
    /// Address to listen on. Other addresses than loopback ones require `tls`. If the port is in
    /// use, the next free one is used.
    pub listen: SocketAddr,
    /// Server certificate and key. If set, viewing requires a token, even on the loopback.
    pub tls: Option<CockpitTls>,
    /// Origins of other web pages that may read everything at `/foxglove`, in the form that
    /// browsers send, such as `https://app.foxglove.dev`.
    pub foxglove_origins: Vec<String>,
}

/// Server certificate and key, PEM.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CockpitTls {
    /// File with the certificate and its chain.
    pub cert: PathBuf,
    /// File with the private key.
    pub key: PathBuf,
}

impl Default for Cockpit {
    fn default() -> Self {
        Self { listen: (Ipv4Addr::LOCALHOST, PORT).into(), tls: None, foxglove_origins: Vec::new() }
    }
}

impl Cockpit {
    /// Description of valid addresses for error messages.
    pub const EXPECTED_ADDRESS: &str = "a loopback address such as 127.0.0.1:8088, or any address with tls; for remote access use `ssh -L 8088:127.0.0.1:8088 HOST`";

    /// Parses a listen address. Returns `None` if it is invalid, or outside the loopback without
    /// TLS.
    pub fn parse_address(text: &str, has_tls: bool) -> Option<SocketAddr> {
        text.parse().ok().filter(|address: &SocketAddr| has_tls || address.ip().is_loopback())
    }
}

/// Reads `[cockpit]`.
pub(crate) fn cockpit(section: &mut Section<'_, '_>, out: &mut Cockpit) {
    let has_tls = section.has("tls");
    section.parsed("listen", Cockpit::EXPECTED_ADDRESS, |text| Cockpit::parse_address(text, has_tls), &mut out.listen);
    section.section("tls", |section| {
        let mut tls = CockpitTls::default();
        let files = [("cert", &mut tls.cert), ("key", &mut tls.key)];
        let valid = files.map(|(key, file)| section.parsed(key, "a path", |path| Some(path.into()), file));
        match ["cert", "key"].into_iter().find(|key| !section.has(key)) {
            Some(key) => {
                let remedy = "`plumb keys vehicle NAME --host HOST` creates cert.pem and key.pem";
                section.report_table(&format!("cockpit.tls: {key:?} is missing"), remedy);
            }
            None if valid.iter().all(|valid| *valid) => out.tls = Some(tls),
            None => {}
        }
    });
    let Some(listed) = section.spanned_strings("foxglove_origins", MAX_ORIGINS) else { return };
    for origin in listed.iter().filter(|origin| !is_origin(origin.get_ref())) {
        let title = format!("cockpit.foxglove_origins: {:?} is not an origin", origin.get_ref());
        section.report(Problem {
            note: Some(
                "pages of a listed origin can read everything but send no commands; \"*\" and \"null\" would admit any page"
                    .into(),
            ),
            ..Problem::new(origin.span(), title, "expected scheme and host, such as \"https://app.foxglove.dev\"")
        });
    }
    out.foxglove_origins = listed.into_iter().map(Spanned::into_inner).collect();
}

/// Returns `true` for an origin as browsers send it: a scheme with optional host and port, in lower
/// case (RFC 6454, 6.2).
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
    fn origins_are_accepted_only_as_browsers_send_them() {
        let parse = |text: &str| Launch::parse("x", &format!("cockpit.foxglove_origins = [{text:?}]"));
        for text in ["https://app.foxglove.dev", "http://localhost:8080", "http://[::1]:3000", "file://"] {
            assert_eq!(parse(text).unwrap().cockpit.foxglove_origins, [text]);
        }
        for text in ["*", "null", "", "https://", "https://*.dev", "https://App.dev", "https://app.dev/", "app.dev"] {
            let shown = parse(text).unwrap_err().to_string();
            assert!(shown.contains("is not an origin"), "{text}: {shown}");
        }
        let many = format!("cockpit.foxglove_origins = {:?}", ["file://"; 9]);
        assert!(Launch::parse("x", &many).unwrap_err().to_string().contains("at most 8"));
    }

    #[test]
    fn certificate_and_key_allow_any_address() {
        let tls = "cockpit.tls = { cert = \"cert.pem\", key = \"key.pem\" }";
        let launch = Launch::parse("x", &format!("cockpit.listen = \"0.0.0.0:8088\"\n{tls}")).unwrap();
        assert_eq!(launch.cockpit.listen.to_string(), "0.0.0.0:8088");
        assert_eq!(launch.cockpit.tls.unwrap().key.to_str(), Some("key.pem"));
        let half = "cockpit.listen = \"0.0.0.0:8088\"\ncockpit.tls = { cert = \"cert.pem\" }";
        assert!(Launch::parse("x", half).unwrap_err().to_string().contains("\"key\" is missing"));
    }

    #[test]
    fn address_outside_loopback_without_tls_is_rejected() {
        for (text, expected) in [("127.0.0.1:9000", "127.0.0.1:9000"), ("[::1]:9000", "[::1]:9000")] {
            let launch = Launch::parse("x", &format!("cockpit.listen = {text:?}")).unwrap();
            assert_eq!(launch.cockpit.listen.to_string(), expected);
        }
        for text in ["0.0.0.0:8088", "192.168.1.5:8088", "localhost:8088", "127.0.0.1", "[::]:8088", ""] {
            let shown = Launch::parse("x", &format!("cockpit.listen = {text:?}")).unwrap_err().to_string();
            assert!(shown.contains("a loopback address") && shown.contains("ssh -L"), "{text}: {shown}");
        }
    }
}
