//! Where everything is found: `plumbline/v1/<vehicle>/…`.
//!
//! | key | what |
//! | --- | --- |
//! | `<topic>` | telemetry; a query gives the last message |
//! | `gateway` | how the gateway is; likewise |
//! | `schema` | query: the descriptors |
//! | `services` | query: how the services are |
//! | `command/swap` | query: swap what fills a slot |
//! | `@carry` | ticks for slots on another host; a query with `from` and `to` gives those that are kept |
//! | `@live`, `@live/<service>` | liveliness of the vehicle and of each service |
//!
//! `@` keeps the tokens and the ticks out of what `*` and `**` select: who looks at everything is not sent what two hosts of one system say to
//! each other. Nothing else may begin with it.

/// What comes before the vehicle.
pub const PREFIX: &str = "plumbline/v1";
/// The topic of the gateway's own report.
pub const GATEWAY: &str = "gateway";
/// The query for the descriptors.
pub const SCHEMA: &str = "schema";
/// The query for the services.
pub const SERVICES: &str = "services";
/// The query that swaps what fills a slot.
pub const SWAP: &str = "command/swap";
/// Ticks for slots on another host.
pub const CARRY: &str = "@carry";
/// Liveliness of the vehicle.
pub const LIVE: &str = "@live";

/// A key of a vehicle; `*` for the vehicle selects them all.
pub fn key(vehicle: &str, rest: &str) -> String {
    format!("{PREFIX}/{vehicle}/{rest}")
}

/// The liveliness of a service.
pub fn live(vehicle: &str, service: &str) -> String {
    key(vehicle, &format!("{LIVE}/{service}"))
}

/// The vehicle of a key, and what comes after it.
pub fn parts(key: &str) -> Option<(&str, &str)> {
    let (vehicle, rest) = key.strip_prefix(PREFIX)?.strip_prefix('/')?.split_once('/')?;
    is_vehicle(vehicle).then_some((vehicle, rest))
}

/// 1 to 32 of a-z, 0-9, - and _.
pub fn is_vehicle(name: &str) -> bool {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    (1..=32).contains(&name.len()) && name.bytes().all(allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_taken_apart_as_it_was_put_together() {
        assert_eq!(parts(&key("drone-1", "attitude")), Some(("drone-1", "attitude")));
        assert_eq!(parts(&live("drone-1", "fuser")), Some(("drone-1", "@live/fuser")));
        for foreign in
            ["", "plumbline/v1", "plumbline/v1/a", "plumbline/v1//attitude", "plumbline/v2/a/b", "plumbline/v1/A/b"]
        {
            assert_eq!(parts(foreign), None, "{foreign}");
        }
    }
}
