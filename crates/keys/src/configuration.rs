//! Zenoh configurations for the router, the vehicle and the ground station.
//!
//! Each configuration is a file from `deploy/zenoh` with the hosts and the access list filled in.

use crate::{Host, access::AccessList};

/// Folder on a party's machine to which its key folder is copied. The Zenoh configurations contain
/// paths in this folder.
pub const INSTALL_DIR: &str = "/etc/plumbline/keys";
/// Port on which the router listens.
pub const ROUTER_PORT: u16 = 7447;
/// Marker in the comment line before the access list.
pub const LIST_START: &str = "access list: begin";
/// Marker in the comment line after the access list.
pub const LIST_END: &str = "access list: end";

/// Configuration of the router. Its access list denies everything until it is replaced.
pub const ROUTER: &str = include_str!("../../../deploy/zenoh/router.json5");
const VEHICLE: &str = include_str!("../../../deploy/zenoh/vehicle.json5");
const GROUND: &str = include_str!("../../../deploy/zenoh/ground.json5");
/// Placeholder for the router's endpoints in the vehicle and ground configurations.
const ENDPOINT_PLACEHOLDER: &str = "\"quic/router.example.net:7447\"";

/// Returns the configuration of a vehicle that connects to a router at `hosts`.
pub fn vehicle(hosts: &[Host]) -> String {
    with_endpoints(VEHICLE, hosts)
}

/// Returns the configuration of an operator or viewer that connects to a router at `hosts`.
pub fn ground(hosts: &[Host]) -> String {
    with_endpoints(GROUND, hosts)
}

fn with_endpoints(text: &str, hosts: &[Host]) -> String {
    let endpoints: Vec<_> = hosts.iter().map(|host| format!("\"{}\"", host.endpoint(ROUTER_PORT))).collect();
    text.replace(ENDPOINT_PLACEHOLDER, &endpoints.join(", "))
}

/// Replaces the access list of a configuration, or returns `None` if its markers are missing.
pub fn replace_access_list(text: &str, list: &AccessList) -> Option<String> {
    let lines: Vec<&str> = text.lines().collect();
    let begin = lines.iter().position(|line| line.contains(LIST_START))?;
    let end = lines.iter().position(|line| line.contains(LIST_END)).filter(|end| *end > begin)?;
    let list = format!("access_control: {},", list.to_json());
    let list = list.lines().map(|line| format!("  {line}"));
    let (before, after) = (lines.get(..=begin)?, lines.get(end..)?);
    let all: Vec<String> = [
        before.iter().map(|line| (*line).to_owned()).collect(),
        list.collect::<Vec<_>>(),
        after.iter().map(|line| (*line).to_owned()).collect(),
    ]
    .concat();
    Some(all.join("\n") + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn access_list_is_replaced_and_the_rest_is_kept() {
        let alpha = AccessList::new(&["vehicle.alpha".parse().unwrap()], &[]);
        let edited = ROUTER.replace("max_sessions", "max_sessions /* mine */");
        let with_alpha = replace_access_list(&edited, &alpha).unwrap();
        assert!(with_alpha.contains("plumbline/v1/alpha/**") && with_alpha.contains("/* mine */"));
        assert_eq!(replace_access_list(&with_alpha, &alpha).unwrap(), with_alpha);
        assert!(!replace_access_list(&with_alpha, &AccessList::new(&[], &[])).unwrap().contains("alpha"));
    }

    #[test]
    fn configuration_without_list_markers_is_rejected() {
        let list = AccessList::new(&[], &[]);
        assert_eq!(replace_access_list("{}", &list), None);
        assert_eq!(replace_access_list(&format!("// {LIST_END}\n// {LIST_START}\n"), &list), None);
    }

    #[test]
    fn every_host_becomes_an_endpoint() {
        let hosts = ["10.0.0.1", "router.example.net"].map(|host| host.parse().unwrap());
        for text in [vehicle(&hosts), ground(&hosts)] {
            assert!(text.contains(r#"["quic/10.0.0.1:7447", "quic/router.example.net:7447"]"#), "{text}");
        }
    }
}
