//! Zenoh keys, `plumbline/v1/<vehicle>/…`.
//!
//! | key | use |
//! | --- | --- |
//! | `<topic>` | telemetry; a query returns the last message |
//! | `gateway` | gateway report; a query returns the last report |
//! | `schema` | query: descriptors of the schema |
//! | `services` | query: service status |
//! | `command/swap` | query: swaps the stage in a slot |
//! | `@carry` | ticks for slots on another host; a query with `from`, `to` returns cached ticks |
//! | `@live`, `@live/<service>` | liveliness of the vehicle and of each service |
//!
//! Wildcards `*` and `**` do not match chunks that begin with `@`. A subscriber to all telemetry
//! therefore does not receive liveliness tokens or the ticks exchanged between hosts of one system.
//! No other key may begin with `@`.

/// Prefix of every key, before the vehicle.
pub const PREFIX: &str = "plumbline/v1";
/// Key of the gateway's report.
pub const GATEWAY: &str = "gateway";
/// Key of the query for the descriptors.
pub const SCHEMA: &str = "schema";
/// Key of the query for the status of the services.
pub const SERVICES: &str = "services";
/// Key of the query that requests a swap.
pub const SWAP: &str = "command/swap";
/// Key of the ticks for slots on another host.
pub const CARRY: &str = "@carry";
/// Key of the vehicle's liveliness token.
pub const LIVELINESS: &str = "@live";

/// Returns the vehicle's key with the ending `rest`. The vehicle `*` selects all vehicles.
pub fn key(vehicle: &str, rest: &str) -> String {
    format!("{PREFIX}/{vehicle}/{rest}")
}

/// Returns the key of a service's liveliness token.
pub fn service_liveliness(vehicle: &str, service: &str) -> String {
    key(vehicle, &format!("{LIVELINESS}/{service}"))
}

/// Splits a key into the vehicle and the remainder.
///
/// Returns `None` if the prefix or the vehicle name is invalid.
pub fn parse(key: &str) -> Option<(&str, &str)> {
    let (vehicle, rest) = key.strip_prefix(PREFIX)?.strip_prefix('/')?.split_once('/')?;
    is_vehicle_name(vehicle).then_some((vehicle, rest))
}

/// Returns `true` if the name has 1 to 32 characters of a-z, 0-9, `-` and `_`.
pub fn is_vehicle_name(name: &str) -> bool {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    (1..=32).contains(&name.len()) && name.bytes().all(allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_parses_into_vehicle_and_remainder() {
        assert_eq!(parse(&key("drone-1", "attitude")), Some(("drone-1", "attitude")));
        assert_eq!(parse(&service_liveliness("drone-1", "fuser")), Some(("drone-1", "@live/fuser")));
        for foreign in
            ["", "plumbline/v1", "plumbline/v1/a", "plumbline/v1//attitude", "plumbline/v2/a/b", "plumbline/v1/A/b"]
        {
            assert_eq!(parse(foreign), None, "{foreign}");
        }
    }
}
