//! Web page of the system: `[cockpit]`.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use crate::{
    description::Key,
    keys::keys,
    kind::{By, File, Optional, Table, Texts},
    problem::Problem,
    toml_reader::Section,
};

const MAX_ORIGINS: usize = 8;

keys! {
    /// Settings of the cockpit service, which serves a web page of the system.
    #[derive(Eq)]
    pub struct Cockpit {
        /// Address to listen on. Addresses other than loopback require `tls`. If the port is in
        /// use, the next free one is used.
        listen: SocketAddr = (Ipv4Addr::LOCALHOST, 8088).into(), By(listen);
        /// Server certificate and key, PEM. If set, viewing requires a token, even on the loopback
        /// interface.
        tls: Option<CockpitTls> = None, Optional(Table(CockpitTls::read));
        /// Origins of other web pages that may read everything at `/foxglove`, in the form that
        /// browsers send, see docs/explanation/security-model.md.
        foxglove_origins: Vec<String> = Vec::new(), Texts::<MAX_ORIGINS>,
            example r#"["https://app.foxglove.dev"]"#;
        /// Folder for the recordings that an operator starts on the page. If it is not set, no
        /// recording can be started.
        recordings: Option<PathBuf> = None, Optional(File), example r#""flights""#;
        /// Size at which the recording ends.
        recording_max_mib: u64 = 4096, 1..=1_000_000, unit "MiB";
    }
}

keys! {
    /// Server certificate and key, PEM.
    #[derive(Eq)]
    pub struct CockpitTls {
        /// File with the certificate and its chain.
        cert: PathBuf = PathBuf::new(), File, example r#""keys/vehicle.alpha/cert.pem""#;
        /// File with the private key.
        key: PathBuf = PathBuf::new(), File, example r#""keys/vehicle.alpha/key.pem""#;
    }
}

impl Cockpit {
    /// Returns a command that forwards the default port from another host.
    pub fn forward_command() -> String {
        let address = Self::default().listen;
        format!("`ssh -L {}:{address} HOST`", address.port())
    }

    /// Parses a listen address. Returns `None` if it is invalid, or if it is not a loopback address
    /// and there is no TLS.
    fn parse_address(text: &str, has_tls: bool) -> Option<SocketAddr> {
        text.parse().ok().filter(|address: &SocketAddr| has_tls || address.ip().is_loopback())
    }

    /// Reads `[cockpit]` and checks the origins.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        let origins = section.elements("foxglove_origins");
        for (origin, span) in origins.into_iter().filter(|(origin, _)| !is_origin(origin)) {
            let title = format!("cockpit.foxglove_origins: {origin:?} is not an origin");
            section.report(Problem {
                note: Some(
                    "pages of a listed origin can read everything but send no commands; \"*\" and \"null\" would admit any page"
                        .into(),
                ),
                ..Problem::new(span, title, "expected scheme and host, such as \"https://app.foxglove.dev\"")
            });
        }
    }
}

impl CockpitTls {
    fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        section.require(&["cert", "key"], "`plumb keys vehicle NAME --host HOST` creates cert.pem and key.pem");
    }
}

fn listen(section: &mut Section<'_, '_>, key: Key, out: &mut SocketAddr) {
    let (has_tls, default) = (section.has("tls"), out.to_string());
    let parse = |text: &str| Cockpit::parse_address(text, has_tls);
    let expected = format!(
        "a loopback address such as {}, or any address with tls; for remote access use {}",
        Cockpit::default().listen,
        Cockpit::forward_command()
    );
    section.text(key, &expected, parse, Some(default), out);
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
