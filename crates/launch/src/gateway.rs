//! Connections to other hosts, and the topics sent: `[gateway]`.

use std::{collections::BTreeMap, ops::RangeInclusive, path::PathBuf};

use graph::{Buffer, Presence, Topic};
use serde::{Deserialize, Serialize};
use toml::de::DeValue;

use crate::{
    description::Key,
    endpoint::{self, LOOPBACK_ENDPOINT, MAX_ENDPOINTS, MAX_TUNNELS},
    keys::{Kind, keys},
    kind::{By, File, NAME, Optional, Table, Texts, many_of},
    problem::{Problem, quoted},
    toml_reader::{Section, Values},
};

/// Allowed rates of a topic, Hz.
const RATE_RANGE_HZ: RangeInclusive<f64> = 0.1..=10_000.0;

keys! {
    /// Settings of the gateway, which connects the system to other hosts.
    pub struct Gateway {
        /// Vehicle name that other hosts see. If not set, the name of the system.
        vehicle: Option<String> = None, Optional(NAME), example r#""drone-7""#;
        /// Endpoints to listen on. `tcp/HOST:PORT` is unencrypted and read-only, and is allowed on
        /// the loopback and in a `tunnel`. `quic/HOST:PORT` needs `tls` and `access`. If a port on
        /// the loopback is in use, the next free one is used.
        listen: Vec<String> = vec![LOOPBACK_ENDPOINT.into()], Texts::<MAX_ENDPOINTS>;
        /// Endpoints of routers and stations to connect to.
        connect: Vec<String> = Vec::new(), Texts::<MAX_ENDPOINTS>, example r#"["quic/station.example:7447"]"#;
        /// Maximum message rate of a topic. Several samples of a faster topic are combined into one
        /// message. Samples of a slower topic are sent without delay.
        messages_hz: f64 = 200.0, 20.0..=10_000.0, unit "Hz";
        /// Number of samples of each topic that are sent per second of the source's time. Topics
        /// that are not listed are not sent.
        rates: BTreeMap<String, TopicRate> = default_rates(), Table(rates);
        /// Topics for slots on other hosts. Every tick is sent, and is sent again to hosts that
        /// missed it.
        export: Vec<String> = Vec::new(), By(split_topics);
        /// Time for which exported ticks are kept for a disconnected host.
        cache_s: f64 = 30.0, 1.0..=600.0, unit "s";
        /// Topics imported from the slots of another host.
        import: Option<Import> = None, Optional(Table(Import::read));
        /// Certificates for mutual TLS, PEM.
        tls: Option<Tls> = None, Optional(Table(Tls::read));
        /// File with Zenoh's `access_control` settings, which define the permissions of each
        /// client. Remote commands need a certificate, `plumb swap` on board does not.
        access: Option<PathBuf> = None, Optional(File), example r#""access.json5""#;
        /// Networks of encrypted tunnels such as WireGuard, where tcp/HOST:PORT is also allowed.
        tunnel: Vec<String> = Vec::new(), Texts::<MAX_TUNNELS>, example r#"["10.9.0.0/24"]"#;
    }
}

/// Rate at which a topic is sent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum TopicRate {
    /// Every sample is sent.
    All,
    /// Number of samples sent per second of the source's time.
    Hz(f64),
}

keys! {
    /// Certificates and key for mutual TLS, PEM.
    #[derive(Eq)]
    pub struct Tls {
        /// File with the certificate of the common authority.
        ca: PathBuf = PathBuf::new(), File, example r#""ca.pem""#;
        /// File with the certificate of this vehicle.
        cert: PathBuf = PathBuf::new(), File, example r#""drone-7.pem""#;
        /// File with the private key of this vehicle.
        key: PathBuf = PathBuf::new(), File, example r#""drone-7.key""#;
    }
}

keys! {
    /// Topics imported from another host.
    #[derive(Eq)]
    pub struct Import {
        /// Vehicle name of the other host's gateway.
        vehicle: String = String::new(), NAME, example r#""board""#;
        /// Topics received from the other host.
        topics: Vec<String> = Vec::new(), By(split_topics), example r#"["gyro", "accel", "mag", "gnss"]"#;
    }
}

fn default_rates() -> BTreeMap<String, TopicRate> {
    let rates = [
        (Topic::Attitude, TopicRate::Hz(50.0)),
        (Topic::Fused, TopicRate::Hz(10.0)),
        (Topic::Gnss, TopicRate::All),
        (Topic::Difference, TopicRate::All),
        (Topic::Control, TopicRate::All),
        (Topic::Health, TopicRate::All),
    ];
    rates.map(|(topic, rate)| (topic.name().into(), rate)).into()
}

impl Gateway {
    /// Reads `[gateway]` and checks that every connection is secured.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        endpoint::check_endpoints(section);
    }

    /// Returns `true` if slots of the system run on other hosts.
    pub fn is_split(&self) -> bool {
        !self.export.is_empty() || self.import.is_some()
    }

    pub(crate) fn imports(&self, topic: Topic) -> bool {
        self.import.as_ref().is_some_and(|import| import.topics.iter().any(|imported| imported == topic.name()))
    }
}

impl Tls {
    fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        section.require(&["ca", "cert", "key"], "mutual TLS needs ca, cert and key");
    }
}

impl Import {
    fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        section.require(&["vehicle", "topics"], "needs vehicle and topics");
    }
}

/// Reads the rate of every topic.
fn rates(out: &mut BTreeMap<String, TopicRate>, section: &mut Section<'_, '_>) {
    for topic in Topic::ALL {
        let entry = topic.entry();
        // Messages of control topics have no source time, so their rate cannot be reduced.
        let is_timed = entry.buffer != Buffer::Control;
        let number = format!(r#""all", "off" or {} to {} Hz"#, RATE_RANGE_HZ.start(), RATE_RANGE_HZ.end());
        let expected = if is_timed { &*number } else { r#""all" or "off""# };
        let mut rate = out.remove(entry.name);
        let default = match rate {
            Some(TopicRate::All) => r#""all""#.into(),
            Some(TopicRate::Hz(hz)) => hz.to_string(),
            None => r#""off""#.into(),
        };
        let key = Key { name: entry.name, doc: "", unit: "", example: "" };
        section.value(key, Values::new(expected, Some(default)), &mut rate, |section, value| match value.get_ref() {
            DeValue::Integer(_) | DeValue::Float(_) if is_timed => {
                section.number(entry.name, value, &RATE_RANGE_HZ).map(|hz| Some(TopicRate::Hz(hz)))
            }
            _ => section.parse(entry.name, value, expected, |text| match text {
                "all" => Some(Some(TopicRate::All)),
                "off" => Some(None),
                _ => None,
            }),
        });
        out.extend(rate.map(|rate| (entry.name.into(), rate)));
    }
}

/// Reads topics that are exchanged between hosts. They are stored in the order of the topic table,
/// without duplicates.
fn split_topics(section: &mut Section<'_, '_>, key: Key, out: &mut Vec<String>) {
    let mut listed = Vec::new();
    many_of(Topic::carried().map(|topic| (topic.name(), topic))).read(section, key, &mut listed);
    if !section.is_set(key.name) {
        return;
    }
    *out = Topic::carried().filter(|topic| listed.contains(topic)).map(|topic| topic.name().into()).collect();
    if !listed.iter().any(|topic| has_every_tick(*topic)) {
        let [dense, sparse] = [true, false].map(|dense| {
            Topic::carried().filter(|topic| has_every_tick(*topic) == dense).map(Topic::name).collect::<Vec<_>>()
        });
        let note =
            Some(format!("{} have messages only for some ticks, marked by flags of the others", sparse.join(" and ")));
        let title = format!("{}: one of {} must be among the topics", key.name, quoted(&dense));
        let span = section.span(key.name).unwrap_or_default();
        section.report(Problem { note, ..Problem::new(span, title, "no topic with every tick") });
    }
}

fn has_every_tick(topic: Topic) -> bool {
    topic.entry().presence == Presence::EveryTick
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    fn rejected(text: &str) -> String {
        Launch::parse("launch.toml", text)
            .map(|launch| panic!("{:?} was accepted", launch.gateway))
            .unwrap_or_else(|problems| problems.to_string())
    }

    #[test]
    fn rates_replace_those_of_the_default() {
        let text = "gateway.rates = { attitude = \"all\", fused = \"off\", imu = 100 }";
        let rates = Launch::parse("launch.toml", text).unwrap().gateway.rates;
        let rate = |topic: &str| rates.get(topic).copied();
        let expected = [Some(TopicRate::All), None, Some(TopicRate::Hz(100.0)), Some(TopicRate::All)];
        assert_eq!(["attitude", "fused", "imu", "health"].map(rate), expected);
    }

    #[test]
    fn insecure_or_invalid_endpoint_is_rejected_with_remedy() {
        for (text, expected) in [
            ("listen = [\"tcp/0.0.0.0:7447\"]", "outside the loopback only mutual TLS"),
            ("listen = [\"tcp/127.0.0.1:7447\", \"tcp/192.168.1.4:7447\"]", "\"tcp/192.168.1.4:7447\" is not secured"),
            ("connect = [\"tcp/station.example:7447\"]", "set ca, cert and key in [gateway.tls]"),
            ("listen = [\"quic/0.0.0.0:7447\"]", "needs [gateway.tls]"),
            ("listen = [\"quic/0.0.0.0:7447\"]\ntls = { ca = \"a\", cert = \"b\", key = \"c\" }", "has no access list"),
            ("connect = [\"quic/[fd00::1]:7447\"]", "expected a DNS name or an IPv4 address"),
            ("connect = [\"quic/fd00::1:7447\"]", "use a DNS name or an IPv4 address"),
            ("listen = [\"tls/0.0.0.0:7447\"]", "expected tcp/HOST:PORT or quic/HOST:PORT"),
            ("listen = [\"udp/127.0.0.1:7447\"]", "expected tcp/HOST:PORT or quic/HOST:PORT"),
            ("listen = [\"tcp/127.0.0.1\"]", "is not an endpoint"),
            ("listen = [\"tcp/127.0.0.1:7447#iface=eth0\"]", "is not an endpoint"),
            ("listen = \"tcp/127.0.0.1:7447\"", "expected an array of at most 16 strings"),
            ("tls = { ca = \"ca.pem\", cert = \"me.pem\" }", "\"key\" is missing"),
            ("rates = { health = 5 }", "gateway.rates.health: expected a string, found an integer"),
            ("rates = { health = \"some\" }", "expected \"all\" or \"off\""),
            ("rates = { attitude = 0 }", "expected 0.1 to 10000"),
            ("rates = { atitude = 5 }", "did you mean \"attitude\"?"),
            ("vehicle = \"Drone/7\"", "1 to 32"),
        ] {
            let problems = rejected(&format!("[gateway]\n{text}\n"));
            assert!(problems.contains(expected), "{text}: {problems}");
        }
    }
}
