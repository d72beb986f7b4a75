//! Limits on incoming connections, and access control for clients without a certificate.

use std::path::Path;

use keys::access::AccessList;
use serde_json::Value;
use zenoh::Config;

use crate::error::LinkError;

/// Maximum message size, bytes. Larger messages are dropped while they are received. Zenoh's
/// default is 1 GiB.
pub(crate) const MAX_MESSAGE: (&str, &str) = ("transport/link/rx/max_message_size", "1048576");
/// Maximum number of sessions of a listener, including those it has opened itself.
pub const MAX_SESSIONS: usize = 64;
/// Maximum number of connections that do not have a session yet. Each uses a file descriptor, and a
/// process is usually limited to 1,024 of them.
const MAX_PENDING_CONNECTIONS: usize = 512;
/// Timeout in ms for a connection to become a session. It allows a few round trips on a slow
/// network.
pub(crate) const HANDSHAKE_TIMEOUT_MS: u64 = 3000;

/// Returns the connection limits of a listener. They replace Zenoh's defaults, which are 1,000
/// sessions, 100 pending connections and 10 s.
pub(crate) fn connection_limits() -> [(&'static str, String); 3] {
    [
        ("transport/unicast/max_sessions", MAX_SESSIONS.to_string()),
        ("transport/unicast/accept_pending", MAX_PENDING_CONNECTIONS.to_string()),
        ("transport/unicast/accept_timeout", HANDSHAKE_TIMEOUT_MS.to_string()),
    ]
}

/// Returns Zenoh's `access_control` setting, which merges the list from the file with the list for
/// clients without a certificate.
pub(crate) fn access_control(file: Option<&Path>, plain: Option<&AccessList>) -> Result<Option<Value>, LinkError> {
    let plain = plain.map(serde_json::to_value).transpose().map_err(|cause| config_error(cause.to_string()))?;
    let Some(path) = file else { return Ok(plain) };
    let mut list = read(path).map_err(|cause| config_error(format!("reading {}: {cause}", foreign::path(path))))?;
    if let Some(plain) = plain {
        if list["enabled"] != true || list["default_permission"] != "deny" {
            return Err(config_error(format!(
                "reading {}: `enabled: true` and `default_permission: \"deny\"` are required; otherwise any user of this machine could act as the vehicle",
                foreign::path(path)
            )));
        }
        for part in ["rules", "subjects", "policies"] {
            let both = [&list, &plain].into_iter().filter_map(|list| list[part].as_array()).flatten();
            list[part] = both.cloned().collect();
        }
    }
    Ok(Some(list))
}

/// Parses the file with Zenoh's own reader and returns it as plain JSON.
fn read(path: &Path) -> Result<Value, String> {
    let text = std::fs::read_to_string(path).map_err(|cause| cause.to_string())?;
    let mut config = Config::default();
    config.insert_json5("access_control", &text).map_err(|cause| cause.to_string())?;
    let json = config.get_json("access_control").map_err(|cause| cause.to_string())?;
    serde_json::from_str(&json).map_err(|cause| cause.to_string())
}

fn config_error(cause: String) -> LinkError {
    LinkError::Config { what: "access_control", cause: cause.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_file(text: &str) -> Result<Option<Value>, LinkError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        access_control(Some(file.path()), Some(&AccessList::for_gateway("boat", false, false)))
    }

    #[test]
    fn lists_of_file_and_gateway_are_merged() {
        let parties = ["vehicle.boat", "operator.ann"].map(|party| party.parse().unwrap());
        let list = with_file(&AccessList::new(&parties, &[]).to_json()).unwrap().unwrap();
        let ids =
            |part: &str| list[part].as_array().unwrap().iter().map(|one| one["id"].to_string()).collect::<Vec<_>>();
        assert_eq!(ids("subjects"), ["\"vehicle.boat\"", "\"operators\"", "\"plain\""]);
        assert!(
            ids("rules").contains(&"\"plain subscribe\"".into()) && list["policies"].as_array().unwrap().len() == 3
        );
        Config::default().insert_json5("access_control", &list.to_string()).unwrap();
    }

    #[test]
    fn permissive_list_is_rejected_with_its_path() {
        for text in [
            "{ enabled: false }",
            "{ enabled: true, default_permission: \"allow\", rules: [], subjects: [], policies: [] }",
        ] {
            let error = with_file(text).unwrap_err().to_string();
            assert!(error.contains("are required") && error.contains("/tmp"), "{error}");
        }
        let error = with_file("{ enabled: tru").unwrap_err().to_string();
        assert!(error.contains("access_control") && error.contains("reading /"), "{error}");
    }
}
