//! Access list of a Zenoh router or gateway.
//!
//! Everything not listed is denied. Zenoh checks whether a rule's key *includes* the key of a
//! message, but delivers a query to every key that it *intersects*: a query for
//! `plumbline/v1/alpha/**` would also reach alpha's commands. Queries are therefore allowed only on
//! keys that cannot intersect a command's key, and each key on which commands are allowed names a
//! single vehicle.

use serde::Serialize;

use crate::{Party, Role};

/// Keys that may be subscribed to: everything that vehicles publish. Commands are queries and are
/// therefore not included.
const TELEMETRY_KEYS: &str = "plumbline/v1/**";
/// Keys that may be queried: last values and schemas.
const QUERYABLE_KEYS: [&str; 2] = ["plumbline/v1/*/*", "plumbline/v1/*/schema/**"];
/// Keys of liveliness tokens. They have their own pattern, because `**` does not match a chunk that
/// starts with `@`.
const LIVELINESS_KEYS: &str = "plumbline/v1/*/@live/**";
/// Keys under which the hosts of split systems exchange ticks.
const CARRY_KEYS: &str = "plumbline/v1/*/@carry";
/// Name of the access-list subject for clients without a certificate.
const ANONYMOUS: &str = "plain";
/// All message kinds to which a rule can apply.
const ALL_MESSAGE_KINDS: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Permission for one vehicle to import the ticks of another. Both are hosts of a split system.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Import {
    /// Vehicle that publishes the ticks.
    pub exporter: Party,
    /// Vehicle that receives the ticks.
    pub importer: Party,
}

/// Access list in the form of Zenoh's `access_control` configuration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AccessList {
    enabled: bool,
    default_permission: &'static str,
    rules: Vec<Rule>,
    subjects: Vec<Subject>,
    policies: Vec<Policy>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Rule {
    id: String,
    permission: &'static str,
    /// Direction as seen by the router: `ingress` is from the party to the router.
    flows: [&'static str; 1],
    messages: Vec<&'static str>,
    key_exprs: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Subject {
    id: String,
    /// Common names of the certificates. Empty if the subject includes every client.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    cert_common_names: Vec<String>,
    link_protocols: [&'static str; 1],
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Policy {
    rules: Vec<String>,
    subjects: Vec<String>,
}

impl AccessList {
    /// Creates a router's access list for these parties. All other parties are denied. An import is
    /// ignored unless both of its parties are listed.
    pub fn new(parties: &[Party], imports: &[Import]) -> Self {
        let of = |role| parties.iter().filter(move |party| party.role() == role);
        let mut list = Self::deny_all();
        let mut commands = Vec::new();
        for vehicle in of(Role::Vehicle) {
            commands.push(format!("plumbline/v1/{}/command/*", vehicle.name()));
            let imports = imports
                .iter()
                .filter(|import| [&import.exporter, &import.importer].iter().all(|it| parties.contains(it)));
            list.add_parties(
                &vehicle.to_string(),
                [vehicle],
                [vehicle_rules(vehicle), carry_rules(vehicle, imports)].concat(),
            );
        }
        list.add_parties("viewers", of(Role::Viewer), reader_rules("viewers"));
        list.add_parties(
            "operators",
            of(Role::Operator),
            [reader_rules("operators"), command_rules(&commands)].concat(),
        );
        list
    }

    /// Creates the access list of a gateway.
    ///
    /// Clients without a certificate may subscribe and query. They may not put, reply, declare
    /// liveliness or send commands. With `exports` they may also receive the vehicle's ticks,
    /// because in a split system the other hosts may be such clients. With `certified`, clients
    /// with a certificate may do everything, because the router through which they connect has its
    /// own access list.
    pub fn for_gateway(vehicle: &str, exports: bool, certified: bool) -> Self {
        let mut list = Self::deny_all();
        let mut rules = reader_rules(ANONYMOUS);
        // Between peers a query is sent only to peers that have declared a queryable. If this
        // declaration were denied, no query would arrive.
        rules.push(allow(format!("{ANONYMOUS} see queryables"), "egress", &["declare_queryable"], QUERYABLE_KEYS));
        if exports {
            let carry = [format!("plumbline/v1/{vehicle}/@carry")];
            rules.push(allow(
                format!("{ANONYMOUS} request ticks"),
                "ingress",
                &["declare_subscriber", "query"],
                &carry,
            ));
            rules.push(allow(
                format!("{ANONYMOUS} receive ticks"),
                "egress",
                &["put", "reply", "declare_queryable"],
                &carry,
            ));
        }
        list.add_subject(ANONYMOUS, vec![], "tcp", rules);
        if certified {
            let keys = [TELEMETRY_KEYS, LIVELINESS_KEYS, CARRY_KEYS];
            let rules =
                ["ingress", "egress"].map(|flow| allow(format!("certified {flow}"), flow, &ALL_MESSAGE_KINDS, keys));
            list.add_subject("certified", vec![], "quic", rules.into());
        }
        list
    }

    fn deny_all() -> Self {
        Self { enabled: true, default_permission: "deny", rules: vec![], subjects: vec![], policies: vec![] }
    }

    fn add_parties<'a>(&mut self, id: &str, parties: impl IntoIterator<Item = &'a Party>, rules: Vec<Rule>) {
        let cert_common_names: Vec<_> = parties.into_iter().map(Party::to_string).collect();
        if !cert_common_names.is_empty() {
            // The subjects are restricted to QUIC, because a common name is proven only on a TLS
            // link, and every QUIC link uses TLS.
            self.add_subject(id, cert_common_names, "quic", rules);
        }
    }

    fn add_subject(&mut self, id: &str, cert_common_names: Vec<String>, protocol: &'static str, rules: Vec<Rule>) {
        let ids = rules.iter().map(|rule| rule.id.clone()).collect();
        self.rules.extend(rules);
        self.subjects.push(Subject { id: id.into(), cert_common_names, link_protocols: [protocol] });
        self.policies.push(Policy { rules: ids, subjects: vec![id.into()] });
    }

    /// Returns the access list as JSON, which is also valid JSON5.
    pub fn to_json(&self) -> String {
        // Serialising strings and lists cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}

/// Returns the rules of a vehicle. The vehicle publishes and replies under its own name, and
/// receives commands and queries for its own data.
fn vehicle_rules(vehicle: &Party) -> Vec<Rule> {
    let own = format!("plumbline/v1/{}", vehicle.name());
    let id = |what: &str| format!("{vehicle} {what}");
    let (all, live, commands) = (format!("{own}/**"), format!("{own}/@live/**"), format!("{own}/command/*"));
    vec![
        allow(id("publishes"), "ingress", &["put", "declare_queryable", "reply"], [all]),
        allow(id("declares liveliness"), "ingress", &["liveliness_token"], [live]),
        // Without this rule no subscriber is visible to the vehicle, and the vehicle publishes
        // nothing.
        allow(id("sees subscribers"), "egress", &["declare_subscriber"], [TELEMETRY_KEYS]),
        allow(id("receives queries"), "egress", &["query"], QUERYABLE_KEYS),
        allow(id("receives commands"), "egress", &["query"], [commands]),
    ]
}

/// Returns the rules for the ticks that the vehicle exports and imports as a host of a split
/// system.
fn carry_rules<'a>(vehicle: &Party, imports: impl Iterator<Item = &'a Import> + Clone) -> Vec<Rule> {
    let carry = |party: &Party| format!("plumbline/v1/{}/@carry", party.name());
    let id = |what: &str| format!("{vehicle} {what}");
    let sources: Vec<_> =
        imports.clone().filter(|import| import.importer == *vehicle).map(|it| carry(&it.exporter)).collect();
    let mut rules = Vec::new();
    if imports.clone().any(|import| import.exporter == *vehicle) {
        let own = [carry(vehicle)];
        rules.push(allow(id("exports ticks"), "ingress", &["put", "declare_queryable", "reply"], &own));
        rules.push(allow(id("sees importers"), "egress", &["declare_subscriber", "query"], &own));
    }
    if !sources.is_empty() {
        rules.push(allow(id("requests ticks"), "ingress", &["declare_subscriber", "query"], &sources));
        rules.push(allow(id("receives ticks"), "egress", &["put", "reply", "declare_queryable"], &sources));
    }
    rules
}

fn reader_rules(subject: &str) -> Vec<Rule> {
    let id = |what: &str| format!("{subject} {what}");
    vec![
        allow(id("subscribe"), "ingress", &["declare_subscriber"], [TELEMETRY_KEYS]),
        allow(id("receive samples"), "egress", &["put"], [TELEMETRY_KEYS]),
        allow(id("query"), "ingress", &["query"], QUERYABLE_KEYS),
        allow(id("receive replies"), "egress", &["reply"], QUERYABLE_KEYS),
        allow(
            id("query liveliness"),
            "ingress",
            &["liveliness_query", "declare_liveliness_subscriber"],
            [LIVELINESS_KEYS],
        ),
        allow(id("receive liveliness"), "egress", &["liveliness_token"], [LIVELINESS_KEYS]),
    ]
}

/// Returns the rules for commands. Each key names one vehicle, so that a single query cannot
/// command several vehicles.
fn command_rules(commands: &[String]) -> Vec<Rule> {
    if commands.is_empty() {
        return vec![];
    }
    vec![
        allow("operators command".into(), "ingress", &["query"], commands),
        allow("operators receive results".into(), "egress", &["reply"], commands),
    ]
}

fn allow<K: ToString>(
    id: String,
    flow: &'static str,
    messages: &[&'static str],
    keys: impl IntoIterator<Item = K>,
) -> Rule {
    let key_exprs = keys.into_iter().map(|key| key.to_string()).collect();
    Rule { id, permission: "allow", flows: [flow], messages: messages.to_vec(), key_exprs }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn party(text: &str) -> Party {
        text.parse().unwrap()
    }

    #[test]
    fn list_without_parties_denies_everything() {
        let list = AccessList::new(&[], &[]);
        assert_eq!((list.enabled, list.default_permission), (true, "deny"));
        assert!(list.rules.is_empty() && list.subjects.is_empty() && list.policies.is_empty());
    }

    #[test]
    fn policies_refer_to_existing_rules_and_only_allow() {
        let list = AccessList::new(&["vehicle.a", "vehicle.b", "operator.o", "viewer.v"].map(party), &[]);
        for policy in &list.policies {
            assert!(!policy.rules.is_empty() && !policy.subjects.is_empty());
            assert!(policy.rules.iter().all(|id| list.rules.iter().filter(|rule| rule.id == *id).count() == 1));
            assert!(policy.subjects.iter().all(|id| list.subjects.iter().filter(|it| it.id == *id).count() == 1));
        }
        assert!(list.rules.iter().all(|rule| rule.permission == "allow" && !rule.key_exprs.is_empty()));
    }

    #[test]
    fn ticks_are_allowed_from_exporter_to_importer_only() {
        let [board, base, other] = ["vehicle.board", "vehicle.base", "vehicle.other"].map(party);
        let import = Import { exporter: board.clone(), importer: base.clone() };
        let carrying = |parties: &[Party], imports: &[Import]| {
            let list = AccessList::new(parties, imports);
            let rules = list.rules.into_iter().filter(|rule| rule.key_exprs.iter().any(|key| key.contains("@carry")));
            rules.map(|rule| (rule.id, rule.key_exprs)).collect::<Vec<_>>()
        };
        let key = vec!["plumbline/v1/board/@carry".to_owned()];
        let ids = ["board exports ticks", "board sees importers", "base requests ticks", "base receives ticks"];
        let expected = ids.map(|id| (format!("vehicle.{id}"), key.clone()));
        assert_eq!(carrying(&[board.clone(), base.clone(), other], std::slice::from_ref(&import)), expected);
        assert_eq!(carrying(&[board, base.clone()], &[]), []);
        assert_eq!(carrying(&[base], &[import]), []);
    }

    #[test]
    fn client_without_certificate_can_only_read() {
        let texts = |exports| {
            let list = AccessList::for_gateway("boat", exports, false);
            assert_eq!((list.default_permission, list.subjects.len()), ("deny", 1));
            assert_eq!(list.subjects[0].link_protocols, ["tcp"]);
            let ingress = list.rules.into_iter().filter(|rule| rule.flows == ["ingress"]);
            ingress.flat_map(|rule| rule.messages.into_iter().map(move |it| (it, rule.key_exprs.clone()))).collect()
        };
        let looking: Vec<(&str, Vec<String>)> = texts(false);
        assert!(looking.iter().all(|(message, keys)| {
            ["declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"].contains(message)
                && keys.iter().all(|key| !key.contains("command") && !key.contains("@carry"))
        }));
        let carried: Vec<_> = texts(true).into_iter().filter(|it| !looking.contains(it)).collect();
        let key = vec!["plumbline/v1/boat/@carry".to_owned()];
        assert_eq!(carried, [("declare_subscriber", key.clone()), ("query", key)]);
    }

    #[test]
    fn only_operators_may_query_commands() {
        let list = AccessList::new(&["vehicle.a", "operator.o", "viewer.v"].map(party), &[]);
        let commanding =
            |rule: &&Rule| rule.flows == ["ingress"] && rule.key_exprs.iter().any(|key| key.contains("command"));
        let ids: Vec<_> = list.rules.iter().filter(commanding).map(|rule| rule.id.as_str()).collect();
        assert_eq!(ids, ["operators command"]);
        let policies: Vec<_> = list.policies.iter().filter(|it| it.rules.iter().any(|id| id == ids[0])).collect();
        assert_eq!(policies.len(), 1);
        assert_eq!(policies[0].subjects, ["operators"]);
    }
}
