//! How far the gateway's endpoints reach, and what they need: beyond the loopback mutual TLS, or a tunnel that is known.

use std::net::{IpAddr, Ipv4Addr};

use toml::Spanned;

use crate::{gateway::Gateway, problem::Problem, walk::Section};

/// Endpoints of each kind at most.
const ENDPOINTS_MAX: usize = 16;
/// Networks of tunnels at most.
const TUNNELS_MAX: usize = 4;
/// Fewer common bits are no network of one's own.
const COMMON_BITS_MIN: u32 = 8;

/// Reads `listen`, `connect` and `tunnel`.
pub(crate) fn endpoints(section: &mut Section<'_, '_>, out: &mut Gateway) {
    let tunnels = tunnels(section);
    let given = |access| Given { tls: section.has("tls"), access, tunnels: &tunnels };
    // Whoever listens holds the list.
    let [listening, connecting] = [given(section.has("access")), given(true)];
    read(section, "listen", &listening, &mut out.listen);
    read(section, "connect", &connecting, &mut out.connect);
}

/// What there is for endpoints beyond the loopback.
struct Given<'t> {
    tls: bool,
    access: bool,
    tunnels: &'t [Network],
}

/// Where everybody could listen, or pretend to be somebody, only mutual TLS is allowed.
fn read(section: &mut Section<'_, '_>, key: &'static str, given: &Given<'_>, out: &mut Vec<String>) {
    let Some(listed) = section.texts(key, ENDPOINTS_MAX) else { return };
    for endpoint in &listed {
        let text = endpoint.get_ref();
        let problem = match Endpoint::of(text) {
            Some(Endpoint::Loopback) => continue,
            Some(Endpoint::Quic { names_ipv6: true }) if key == "connect" => Problem {
                note: Some("an IPv6 address is no name that Zenoh's QUIC takes".into()),
                help: Some("name the host by its DNS name, or by an IPv4 address".into()),
                ..at(endpoint, key, "never connects", "expected a DNS name or an IPv4 address")
            },
            Some(Endpoint::Quic { .. }) if given.tls && given.access => continue,
            Some(Endpoint::Quic { .. }) if given.tls => Problem {
                help: Some(
                    "access names the list of who may do what; `plumb keys vehicle NAME --host HOST` writes it".into(),
                ),
                ..at(endpoint, key, "has no access list", "needs access")
            },
            Some(Endpoint::Quic { .. }) => Problem {
                help: Some(CERTIFICATES.into()),
                ..at(endpoint, key, "has no certificates", "needs [gateway.tls]")
            },
            Some(Endpoint::Plain { host }) if given.tunnels.iter().any(|tunnel| tunnel.has(host)) => continue,
            Some(Endpoint::Plain { .. }) => {
                let help = Some(format!(
                    "use \"quic/…\" with certificates, or the loopback: {LOOPBACK}; {CERTIFICATES}; within a tunnel that encrypts, tunnel names its network"
                ));
                Problem { help, ..at(endpoint, key, "is open to everybody", "beyond the loopback only mutual TLS") }
            }
            None => {
                let note = Some(format!("as {LOOPBACK} or \"quic/station.example:7447\""));
                Problem { note, ..at(endpoint, key, "is no endpoint", "expected tcp/HOST:PORT or quic/HOST:PORT") }
            }
        };
        section.report(problem);
    }
    *out = listed.into_iter().map(Spanned::into_inner).collect();
}

const LOOPBACK: &str = "\"tcp/127.0.0.1:7447\"";
const CERTIFICATES: &str = "[gateway.tls] names the files ca, cert and key";

fn at(endpoint: &Spanned<String>, key: &str, what: &str, label: &str) -> Problem {
    Problem::new(endpoint.span(), format!("gateway.{key}: {:?} {what}", endpoint.get_ref()), label)
}

/// Networks whose members all have a key to them; what is none is reported.
fn tunnels(section: &mut Section<'_, '_>) -> Vec<Network> {
    let listed = section.texts("tunnel", TUNNELS_MAX).unwrap_or_default();
    let mut tunnels = Vec::new();
    for text in &listed {
        match Network::of(text.get_ref()) {
            Some(network) => tunnels.push(network),
            None => section.report(at(text, "tunnel", "is no network", "expected ADDRESS/BITS, as \"10.9.0.0/24\"")),
        }
    }
    tunnels
}

/// Addresses that begin with the same bits.
struct Network {
    address: Ipv4Addr,
    bits: u32,
}

impl Network {
    fn of(text: &str) -> Option<Self> {
        let (address, bits) = text.split_once('/')?;
        let bits = bits.parse().ok().filter(|bits| (COMMON_BITS_MIN..=Ipv4Addr::BITS).contains(bits))?;
        Some(Self { address: address.parse().ok()?, bits })
    }

    fn has(&self, host: &str) -> bool {
        let others = |host: Ipv4Addr| (host.to_bits() ^ self.address.to_bits()) >> (Ipv4Addr::BITS - self.bits);
        host.parse().is_ok_and(|host| others(host) == 0)
    }
}

/// How far an endpoint reaches.
enum Endpoint<'t> {
    Loopback,
    /// With mutual TLS.
    Quic {
        names_ipv6: bool,
    },
    Plain {
        host: &'t str,
    },
}

impl<'t> Endpoint<'t> {
    fn of(text: &'t str) -> Option<Self> {
        let (protocol, address) = text.split_once('/')?;
        let (host, port) = address.rsplit_once(':')?;
        let plain = |letter: char| letter.is_ascii_alphanumeric() || ".-:[]".contains(letter);
        if host.is_empty() || !host.chars().all(plain) || port.parse::<u16>().is_err() {
            return None;
        }
        match protocol {
            "quic" => Some(Self::Quic { names_ipv6: host.contains(':') }),
            "tcp" if is_loopback(host) => Some(Self::Loopback),
            "tcp" => Some(Self::Plain { host }),
            _ => None,
        }
    }
}

/// This machine and nobody else.
pub(crate) fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    fn said(text: &str) -> String {
        let services = r#"services = ["ingest", "gyro", "accel", "fuser", "course", "gateway"]"#;
        Launch::parse("launch.toml", &format!("{services}\n[gateway]\n{text}\n"))
            .err()
            .map_or(String::new(), |it| it.to_string())
    }

    #[test]
    fn plain_tcp_is_for_the_loopback_and_for_addresses_of_a_tunnel() {
        for (tunnel, host, is_taken) in [
            ("10.9.0.0/24", "10.9.0.1", true),
            ("10.9.0.1/24", "10.9.0.255", true),
            ("10.9.0.1/32", "10.9.0.1", true),
            ("10.0.0.0/8", "10.255.1.2", true),
            ("10.9.0.0/24", "10.9.1.1", false),
            ("10.9.0.1/32", "10.9.0.2", false),
            ("10.9.0.0/24", "0.0.0.0", false),
            ("10.9.0.0/24", "base.example", false),
            ("10.9.0.0/24", "[fd00::1]", false),
        ] {
            for key in ["listen", "connect"] {
                let said = said(&format!("{key} = [\"tcp/{host}:7447\"]\ntunnel = [{tunnel:?}]"));
                assert_eq!(said.is_empty(), is_taken, "{tunnel} {host}: {said}");
                assert!(is_taken || said.contains("is open to everybody"), "{said}");
            }
        }
    }

    #[test]
    fn what_is_no_network_of_ones_own_is_refused() {
        for tunnel in ["0.0.0.0/0", "10.0.0.0/7", "10.9.0.0/33", "10.9.0.0", "wg0", "10.9.0/24", "fd00::/64"] {
            let said = said(&format!("tunnel = [{tunnel:?}]"));
            assert!(said.contains("expected ADDRESS/BITS"), "{tunnel}: {said}");
        }
    }
}
