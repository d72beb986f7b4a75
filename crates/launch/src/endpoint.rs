//! Security of the gateway's endpoints. Endpoints outside the loopback interface need mutual TLS or
//! a listed tunnel.

use std::{
    net::{IpAddr, Ipv4Addr},
    ops::Range,
};

use crate::{problem::Problem, toml_reader::Section};

/// Maximum number of endpoints per key.
pub(crate) const MAX_ENDPOINTS: usize = 16;
/// Maximum number of networks in `tunnel`.
pub(crate) const MAX_TUNNELS: usize = 4;
/// Endpoint on the loopback interface with Zenoh's usual port.
pub(crate) const LOOPBACK_ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// Shortest network prefix accepted for a tunnel. A shorter prefix covers more addresses than any
/// private network.
const MIN_PREFIX_BITS: u32 = 8;

/// Checks the endpoints in `listen` and `connect`, and the networks in `tunnel`, as they stand in
/// the file, so that a problem points to them.
pub(crate) fn check_endpoints(section: &mut Section<'_, '_>) {
    let tunnels = tunnels(section);
    let security = |access| Security { tls: section.has("tls"), access, tunnels: &tunnels };
    // Only the listening side enforces the access list, so the connecting side does not need one.
    let [listen_security, connect_security] = [security(section.has("access")), security(true)];
    check(section, "listen", &listen_security);
    check(section, "connect", &connect_security);
}

/// Security settings for endpoints outside the loopback interface.
struct Security<'t> {
    tls: bool,
    access: bool,
    tunnels: &'t [Network],
}

/// Checks endpoints. Outside the loopback interface, any host could eavesdrop or impersonate
/// another host, so only mutual TLS and the listed tunnels are allowed.
fn check(section: &mut Section<'_, '_>, key: &'static str, security: &Security<'_>) {
    let mut problems = Vec::new();
    for endpoint in section.elements(key).iter().filter(|_| section.are_valid(&[key])) {
        let (text, _) = endpoint;
        let problem = match Endpoint::parse(text) {
            Some(Endpoint::Loopback) => continue,
            Some(Endpoint::Quic { names_ipv6: true }) if key == "connect" => Problem {
                note: Some("Zenoh does not connect to IPv6 addresses over QUIC".into()),
                help: Some("use a DNS name or an IPv4 address of the host".into()),
                ..endpoint_problem(endpoint, key, "never connects", "expected a DNS name or an IPv4 address")
            },
            Some(Endpoint::Quic { .. }) if security.tls && security.access => continue,
            Some(Endpoint::Quic { .. }) if security.tls => Problem {
                help: Some("set access to an access list; `plumb keys vehicle NAME --host HOST` writes one".into()),
                ..endpoint_problem(endpoint, key, "has no access list", "needs access")
            },
            Some(Endpoint::Quic { .. }) => Problem {
                help: Some(CERTIFICATES.into()),
                ..endpoint_problem(endpoint, key, "has no certificates", "needs [gateway.tls]")
            },
            Some(Endpoint::Plain { host }) if security.tunnels.iter().any(|tunnel| tunnel.contains(host)) => continue,
            Some(Endpoint::Plain { .. }) => {
                let help = Some(format!(
                    "use \"quic/…\" with certificates ({CERTIFICATES}), or the loopback ({LOOPBACK_ENDPOINT:?}); for an encrypted tunnel, list its network in tunnel"
                ));
                Problem {
                    help,
                    ..endpoint_problem(
                        endpoint,
                        key,
                        "is not secured",
                        "outside the loopback only mutual TLS is allowed",
                    )
                }
            }
            None => {
                let note = Some(format!("for example {LOOPBACK_ENDPOINT:?} or \"quic/station.example:7447\""));
                Problem {
                    note,
                    ..endpoint_problem(endpoint, key, "is not an endpoint", "expected tcp/HOST:PORT or quic/HOST:PORT")
                }
            }
        };
        problems.push(problem);
    }
    problems.into_iter().for_each(|problem| section.report(problem));
}

const CERTIFICATES: &str = "set ca, cert and key in [gateway.tls]";

fn endpoint_problem((text, span): &(&str, Range<usize>), key: &str, what: &str, label: &str) -> Problem {
    Problem::new(span.clone(), format!("gateway.{key}: {text:?} {what}"), label)
}

/// Returns the networks of encrypted tunnels, and reports invalid ones.
fn tunnels(section: &mut Section<'_, '_>) -> Vec<Network> {
    let mut tunnels = Vec::new();
    for listed in section.elements("tunnel") {
        match Network::parse(listed.0) {
            Some(network) => tunnels.push(network),
            None => section.report(endpoint_problem(
                &listed,
                "tunnel",
                "is not a network",
                "expected ADDRESS/BITS, such as \"10.9.0.0/24\"",
            )),
        }
    }
    tunnels
}

/// IPv4 network.
struct Network {
    address: Ipv4Addr,
    bits: u32,
}

impl Network {
    fn parse(text: &str) -> Option<Self> {
        let (address, bits) = text.split_once('/')?;
        let bits = bits.parse().ok().filter(|bits| (MIN_PREFIX_BITS..=Ipv4Addr::BITS).contains(bits))?;
        Some(Self { address: address.parse().ok()?, bits })
    }

    fn contains(&self, host: &str) -> bool {
        let others = |host: Ipv4Addr| (host.to_bits() ^ self.address.to_bits()) >> (Ipv4Addr::BITS - self.bits);
        host.parse().is_ok_and(|host| others(host) == 0)
    }
}

/// Parsed endpoint.
enum Endpoint<'t> {
    Loopback,
    /// Endpoint with mutual TLS.
    Quic {
        names_ipv6: bool,
    },
    Plain {
        host: &'t str,
    },
}

impl<'t> Endpoint<'t> {
    fn parse(text: &'t str) -> Option<Self> {
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

/// Returns `true` if `host` is a loopback address or `localhost`.
pub(crate) fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    fn problems(text: &str) -> String {
        let services = r#"services = ["ingest", "gyro", "accel", "fuser", "course", "gateway"]"#;
        Launch::parse("launch.toml", &format!("{services}\n[gateway]\n{text}\n"))
            .err()
            .map_or(String::new(), |it| it.to_string())
    }

    #[test]
    fn plain_tcp_is_only_for_loopback_and_tunnels() {
        for (tunnel, host, is_valid) in [
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
                let shown = problems(&format!("{key} = [\"tcp/{host}:7447\"]\ntunnel = [{tunnel:?}]"));
                assert_eq!(shown.is_empty(), is_valid, "{tunnel} {host}: {shown}");
                assert!(is_valid || shown.contains("is not secured"), "{shown}");
            }
        }
    }

    #[test]
    fn invalid_or_oversized_tunnel_network_is_rejected() {
        for tunnel in ["0.0.0.0/0", "10.0.0.0/7", "10.9.0.0/33", "10.9.0.0", "wg0", "10.9.0/24", "fd00::/64"] {
            let shown = problems(&format!("tunnel = [{tunnel:?}]"));
            assert!(shown.contains("expected ADDRESS/BITS"), "{tunnel}: {shown}");
        }
    }
}
