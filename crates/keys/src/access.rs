//! Who may do what on which keys: the access list of a Zenoh router.
//!
//! Everything is refused but what is named here. Zenoh looks whether a rule's key *includes* that of a message, and a query reaches
//! whatever its key *intersects*: a query for `plumbline/v1/alpha/**` arrives at the commands of alpha. Queries are therefore allowed on
//! keys only that cannot meet a command's, and commands on those of one vehicle each.

use serde::Serialize;

use crate::{Party, Role};

/// What may be subscribed to: everything that vehicles put. Commands are queries, so none is heard.
const TELEMETRY: &str = "plumbline/v1/**";
/// What may be asked for: last values and schemas.
const ANSWERS: [&str; 2] = ["plumbline/v1/*/*", "plumbline/v1/*/schema/**"];
/// Who is alive. `**` alone does not match a chunk that begins with `@`.
const LIVE: &str = "plumbline/v1/*/@live/**";
/// The ticks of split systems.
const CARRY: &str = "plumbline/v1/*/@carry";
/// Those who come without a certificate.
const PLAIN: &str = "plain";
/// Everything that a rule can be about.
const MESSAGES: [&str; 9] = [
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

/// Ticks of a split system that go from one of its hosts to another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Import {
    /// The vehicle that makes them.
    pub from: Party,
    /// The vehicle that takes them.
    pub by: Party,
}

/// The access list, as Zenoh's configuration has it under `access_control`.
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
    /// Seen from the router: `ingress` is what the party sends.
    flows: [&'static str; 1],
    messages: Vec<&'static str>,
    key_exprs: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Subject {
    id: String,
    /// Whatever is shown, where there are none.
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
    /// The list for these parties and nobody else; an import of a party that is not among them is none.
    pub fn new(parties: &[Party], imports: &[Import]) -> Self {
        let of = |role| parties.iter().filter(move |party| party.role() == role);
        let mut list = Self::closed();
        let mut commands = Vec::new();
        for vehicle in of(Role::Vehicle) {
            commands.push(format!("plumbline/v1/{}/command/*", vehicle.name()));
            let imports =
                imports.iter().filter(|import| [&import.from, &import.by].iter().all(|it| parties.contains(it)));
            list.add(&vehicle.to_string(), [vehicle], [vehicle_rules(vehicle), carry_rules(vehicle, imports)].concat());
        }
        list.add("viewers", of(Role::Viewer), reader_rules("viewers"));
        list.add("operators", of(Role::Operator), [reader_rules("operators"), command_rules(&commands)].concat());
        list
    }

    /// What a gateway lets those do who come without a certificate: look at what it sends and ask for it. They put nothing, answer
    /// nothing, are nobody and command nobody. `exports`: they may take its ticks as another host of one system. `certified`: who comes
    /// with a certificate may do everything, as whoever the gateway calls keeps a list.
    pub fn of_gateway(vehicle: &str, exports: bool, certified: bool) -> Self {
        let mut list = Self::closed();
        let mut rules = reader_rules(PLAIN);
        // Between peers a question goes to those only who have said what they answer.
        rules.push(allow(format!("{PLAIN} know what to ask"), "egress", &["declare_queryable"], ANSWERS));
        if exports {
            let carry = [format!("plumbline/v1/{vehicle}/@carry")];
            rules.push(allow(format!("{PLAIN} follow"), "ingress", &["declare_subscriber", "query"], &carry));
            rules.push(allow(format!("{PLAIN} are brought"), "egress", &["put", "reply", "declare_queryable"], &carry));
        }
        list.bind(PLAIN, vec![], "tcp", rules);
        if certified {
            let keys = [TELEMETRY, LIVE, CARRY];
            let rules = ["ingress", "egress"].map(|flow| allow(format!("certified {flow}"), flow, &MESSAGES, keys));
            list.bind("certified", vec![], "quic", rules.into());
        }
        list
    }

    fn closed() -> Self {
        Self { enabled: true, default_permission: "deny", rules: vec![], subjects: vec![], policies: vec![] }
    }

    fn add<'a>(&mut self, id: &str, parties: impl IntoIterator<Item = &'a Party>, rules: Vec<Rule>) {
        let cert_common_names: Vec<_> = parties.into_iter().map(Party::to_string).collect();
        if !cert_common_names.is_empty() {
            // Only a link with TLS tells a common name that was proved, and every QUIC link has it.
            self.bind(id, cert_common_names, "quic", rules);
        }
    }

    fn bind(&mut self, id: &str, cert_common_names: Vec<String>, protocol: &'static str, rules: Vec<Rule>) {
        let ids = rules.iter().map(|rule| rule.id.clone()).collect();
        self.rules.extend(rules);
        self.subjects.push(Subject { id: id.into(), cert_common_names, link_protocols: [protocol] });
        self.policies.push(Policy { rules: ids, subjects: vec![id.into()] });
    }

    /// As text for the configuration; JSON is JSON5.
    pub fn text(&self) -> String {
        // Strings and lists always have a JSON form.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}

/// It publishes and answers below its own name, and is asked for what concerns it.
fn vehicle_rules(vehicle: &Party) -> Vec<Rule> {
    let own = format!("plumbline/v1/{}", vehicle.name());
    let id = |what: &str| format!("{vehicle} {what}");
    let (all, live, commands) = (format!("{own}/**"), format!("{own}/@live/**"), format!("{own}/command/*"));
    vec![
        allow(id("publishes"), "ingress", &["put", "declare_queryable", "reply"], [all]),
        allow(id("is alive"), "ingress", &["liveliness_token"], [live]),
        // Without it the vehicle does not know that anybody listens, and sends nothing.
        allow(id("has listeners"), "egress", &["declare_subscriber"], [TELEMETRY]),
        allow(id("is asked"), "egress", &["query"], ANSWERS),
        allow(id("is commanded"), "egress", &["query"], [commands]),
    ]
}

/// Its ticks go to who may import them, and it follows those that it may import.
fn carry_rules<'a>(vehicle: &Party, imports: impl Iterator<Item = &'a Import> + Clone) -> Vec<Rule> {
    let carry = |party: &Party| format!("plumbline/v1/{}/@carry", party.name());
    let id = |what: &str| format!("{vehicle} {what}");
    let sources: Vec<_> = imports.clone().filter(|import| import.by == *vehicle).map(|it| carry(&it.from)).collect();
    let mut rules = Vec::new();
    if imports.clone().any(|import| import.from == *vehicle) {
        let own = [carry(vehicle)];
        rules.push(allow(id("carries"), "ingress", &["put", "declare_queryable", "reply"], &own));
        rules.push(allow(id("is followed"), "egress", &["declare_subscriber", "query"], &own));
    }
    if !sources.is_empty() {
        rules.push(allow(id("follows"), "ingress", &["declare_subscriber", "query"], &sources));
        rules.push(allow(id("is brought"), "egress", &["put", "reply", "declare_queryable"], &sources));
    }
    rules
}

fn reader_rules(who: &str) -> Vec<Rule> {
    let id = |what: &str| format!("{who} {what}");
    vec![
        allow(id("subscribe"), "ingress", &["declare_subscriber"], [TELEMETRY]),
        allow(id("hear"), "egress", &["put"], [TELEMETRY]),
        allow(id("ask"), "ingress", &["query"], ANSWERS),
        allow(id("are answered"), "egress", &["reply"], ANSWERS),
        allow(id("ask who is alive"), "ingress", &["liveliness_query", "declare_liveliness_subscriber"], [LIVE]),
        allow(id("hear who is alive"), "egress", &["liveliness_token"], [LIVE]),
    ]
}

/// A command names its vehicle: one query cannot command a fleet.
fn command_rules(commands: &[String]) -> Vec<Rule> {
    if commands.is_empty() {
        return vec![];
    }
    vec![
        allow("operators command".into(), "ingress", &["query"], commands),
        allow("operators hear what came of it".into(), "egress", &["reply"], commands),
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
    fn nobody_on_the_list_means_nobody_may_do_anything() {
        let list = AccessList::new(&[], &[]);
        assert_eq!((list.enabled, list.default_permission), (true, "deny"));
        assert!(list.rules.is_empty() && list.subjects.is_empty() && list.policies.is_empty());
    }

    #[test]
    fn every_policy_names_rules_and_subjects_that_are_there_and_only_allows() {
        let list = AccessList::new(&["vehicle.a", "vehicle.b", "operator.o", "viewer.v"].map(party), &[]);
        for policy in &list.policies {
            assert!(!policy.rules.is_empty() && !policy.subjects.is_empty());
            assert!(policy.rules.iter().all(|id| list.rules.iter().filter(|rule| rule.id == *id).count() == 1));
            assert!(policy.subjects.iter().all(|id| list.subjects.iter().filter(|it| it.id == *id).count() == 1));
        }
        assert!(list.rules.iter().all(|rule| rule.permission == "allow" && !rule.key_exprs.is_empty()));
    }

    #[test]
    fn ticks_are_carried_by_whom_they_are_made_to_whom_they_are_for() {
        let [board, base, other] = ["vehicle.board", "vehicle.base", "vehicle.other"].map(party);
        let import = Import { from: board.clone(), by: base.clone() };
        let carrying = |parties: &[Party], imports: &[Import]| {
            let list = AccessList::new(parties, imports);
            let rules = list.rules.into_iter().filter(|rule| rule.key_exprs.iter().any(|key| key.contains("@carry")));
            rules.map(|rule| (rule.id, rule.key_exprs)).collect::<Vec<_>>()
        };
        let key = vec!["plumbline/v1/board/@carry".to_owned()];
        let ids = ["board carries", "board is followed", "base follows", "base is brought"];
        let expected = ids.map(|id| (format!("vehicle.{id}"), key.clone()));
        assert_eq!(carrying(&[board.clone(), base.clone(), other], std::slice::from_ref(&import)), expected);
        assert_eq!(carrying(&[board, base.clone()], &[]), []);
        assert_eq!(carrying(&[base], &[import]), []);
    }

    #[test]
    fn without_a_certificate_one_looks_and_no_more() {
        let texts = |exports| {
            let list = AccessList::of_gateway("boat", exports, false);
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
    fn only_operators_send_queries_to_commands() {
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
