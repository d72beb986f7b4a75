//! The Zenoh configurations of router, vehicle and ground: the files of `deploy/zenoh` with hosts and access list filled in.

use crate::{Host, access::AccessList};

/// Where a party's folder is to be, as the configurations have it.
pub const INSTALLED_AT: &str = "/etc/plumbline/keys";
/// The router's port.
pub const PORT: u16 = 7447;
/// The line before the access list.
pub const LIST_BEGIN: &str = "access list: begin";
/// The line after it.
pub const LIST_END: &str = "access list: end";

/// The router's; it lets nobody do anything until it is given a list.
pub const ROUTER: &str = include_str!("../../../deploy/zenoh/router.json5");
const VEHICLE: &str = include_str!("../../../deploy/zenoh/vehicle.json5");
const GROUND: &str = include_str!("../../../deploy/zenoh/ground.json5");
/// What stands for the router's endpoints there.
const ENDPOINTS: &str = "\"quic/router.example.net:7447\"";

/// A vehicle's, for a router at `hosts`.
pub fn vehicle(hosts: &[Host]) -> String {
    with_endpoints(VEHICLE, hosts)
}

/// That of an operator or a viewer, for a router at `hosts`.
pub fn ground(hosts: &[Host]) -> String {
    with_endpoints(GROUND, hosts)
}

fn with_endpoints(text: &str, hosts: &[Host]) -> String {
    let endpoints: Vec<_> = hosts.iter().map(|host| format!("\"{}\"", host.endpoint(PORT))).collect();
    text.replace(ENDPOINTS, &endpoints.join(", "))
}

/// The configuration with this access list in place of the one it has; nothing where the list has no place in it.
pub fn with_list(text: &str, list: &AccessList) -> Option<String> {
    let lines: Vec<&str> = text.lines().collect();
    let begin = lines.iter().position(|line| line.contains(LIST_BEGIN))?;
    let end = lines.iter().position(|line| line.contains(LIST_END)).filter(|end| *end > begin)?;
    let list = format!("access_control: {},", list.text());
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
    fn the_list_replaces_the_one_before_and_leaves_the_rest() {
        let alpha = AccessList::new(&["vehicle.alpha".parse().unwrap()], &[]);
        let edited = ROUTER.replace("max_sessions", "max_sessions /* mine */");
        let with_alpha = with_list(&edited, &alpha).unwrap();
        assert!(with_alpha.contains("plumbline/v1/alpha/**") && with_alpha.contains("/* mine */"));
        assert_eq!(with_list(&with_alpha, &alpha).unwrap(), with_alpha);
        assert!(!with_list(&with_alpha, &AccessList::new(&[], &[])).unwrap().contains("alpha"));
    }

    #[test]
    fn a_configuration_without_a_place_for_the_list_is_refused() {
        let list = AccessList::new(&[], &[]);
        assert_eq!(with_list("{}", &list), None);
        assert_eq!(with_list(&format!("// {LIST_END}\n// {LIST_BEGIN}\n"), &list), None);
    }

    #[test]
    fn every_host_is_an_endpoint() {
        let hosts = ["10.0.0.1", "router.example.net"].map(|host| host.parse().unwrap());
        for text in [vehicle(&hosts), ground(&hosts)] {
            assert!(text.contains(r#"["quic/10.0.0.1:7447", "quic/router.example.net:7447"]"#), "{text}");
        }
    }
}
