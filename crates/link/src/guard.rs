//! What a place in the network bears: how much may come in, and what those may do who show no certificate.

use std::path::Path;

use keys::access::AccessList;
use serde_json::Value;
use zenoh::Config;

use crate::LinkError;

/// What is larger is dropped while it comes in, bytes.
pub(crate) const MESSAGE_MAX: (&str, &str) = ("transport/link/rx/max_message_size", "1048576");
/// Sessions of a place where others may connect, those it has called included.
pub const SESSIONS_MAX: usize = 64;
/// Connections that are no session yet, at most; each has a file descriptor, of which a process usually has 1,024.
const ARRIVALS_MAX: usize = 512;
/// For how long a connection may take to become a session, ms: some round trips of a slow network.
pub(crate) const ARRIVAL_LIMIT_MS: u64 = 3000;

/// Of a place where others may connect. What Zenoh has by itself is 1 GiB, 1,000, 100 and 10 s.
pub(crate) fn limits() -> [(&'static str, String); 3] {
    [
        ("transport/unicast/max_sessions", SESSIONS_MAX.to_string()),
        ("transport/unicast/accept_pending", ARRIVALS_MAX.to_string()),
        ("transport/unicast/accept_timeout", ARRIVAL_LIMIT_MS.to_string()),
    ]
}

/// Zenoh's `access_control`: the list of the file, and the one for those who show no certificate.
pub(crate) fn access_control(file: Option<&Path>, plain: Option<&AccessList>) -> Result<Option<Value>, LinkError> {
    let plain = plain.map(serde_json::to_value).transpose().map_err(|cause| refused(cause.to_string()))?;
    let Some(path) = file else { return Ok(plain) };
    let mut list = read(path).map_err(|cause| refused(format!("reading {}: {cause}", path.display())))?;
    if let Some(plain) = plain {
        if list["enabled"] != true || list["default_permission"] != "deny" {
            return Err(refused(format!(
                "reading {}: it must say `enabled: true` and `default_permission: \"deny\"`, or any user of this machine could speak as the vehicle",
                path.display()
            )));
        }
        for part in ["rules", "subjects", "policies"] {
            let both = [&list, &plain].into_iter().filter_map(|list| list[part].as_array()).flatten();
            list[part] = both.cloned().collect();
        }
    }
    Ok(Some(list))
}

/// Zenoh's own reader checks the file and tells it as plain JSON.
fn read(path: &Path) -> Result<Value, String> {
    let text = std::fs::read_to_string(path).map_err(|cause| cause.to_string())?;
    let mut config = Config::default();
    config.insert_json5("access_control", &text).map_err(|cause| cause.to_string())?;
    let json = config.get_json("access_control").map_err(|cause| cause.to_string())?;
    serde_json::from_str(&json).map_err(|cause| cause.to_string())
}

fn refused(cause: String) -> LinkError {
    LinkError::Config { what: "access_control", cause }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn with_file(text: &str) -> Result<Option<Value>, LinkError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        access_control(Some(file.path()), Some(&AccessList::of_gateway("boat", false, false)))
    }

    #[test]
    fn the_list_of_a_file_and_that_of_the_gateway_are_one() {
        let parties = ["vehicle.boat", "operator.ann"].map(|party| party.parse().unwrap());
        let list = with_file(&AccessList::new(&parties, &[]).text()).unwrap().unwrap();
        let ids =
            |part: &str| list[part].as_array().unwrap().iter().map(|one| one["id"].to_string()).collect::<Vec<_>>();
        assert_eq!(ids("subjects"), ["\"vehicle.boat\"", "\"operators\"", "\"plain\""]);
        assert!(
            ids("rules").contains(&"\"plain subscribe\"".into()) && list["policies"].as_array().unwrap().len() == 3
        );
        Config::default().insert_json5("access_control", &list.to_string()).unwrap();
    }

    #[test]
    fn a_list_that_lets_everybody_in_is_refused_with_its_place() {
        for text in [
            "{ enabled: false }",
            "{ enabled: true, default_permission: \"allow\", rules: [], subjects: [], policies: [] }",
        ] {
            let error = with_file(text).unwrap_err().to_string();
            assert!(error.contains("must say") && error.contains("/tmp"), "{error}");
        }
        let error = with_file("{ enabled: tru").unwrap_err().to_string();
        assert!(error.contains("access_control") && error.contains("reading /"), "{error}");
    }
}
