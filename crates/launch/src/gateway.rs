//! Connections to other hosts, and the topics sent: `[gateway]`.

use std::{collections::BTreeMap, path::PathBuf};

use graph::Topic;
use serde::{Deserialize, Serialize};

/// Settings of the gateway, which connects the system to other hosts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gateway {
    /// Vehicle name that other hosts see. `None` to use the system's name.
    pub vehicle: Option<String>,
    /// Endpoints to listen on, such as `tcp/127.0.0.1:7447` or `quic/0.0.0.0:7447`. If a port on
    /// the loopback is in use, the next free one is used.
    pub listen: Vec<String>,
    /// Endpoints of routers and stations to connect to.
    pub connect: Vec<String>,
    /// Maximum message rate of a topic, Hz. Several samples of a faster topic are combined into one
    /// message. Samples of a slower topic are sent without delay.
    pub messages_hz: f64,
    /// Rate at which each topic is sent, by topic name. Topics without an entry are not sent.
    pub rates: BTreeMap<String, TopicRate>,
    /// Topics for slots on other hosts. Every tick is sent, and is sent again to hosts that missed
    /// it.
    pub export: Vec<String>,
    /// Time for which exported ticks are kept for a disconnected host, s.
    pub cache_s: f64,
    /// Topics imported from the slots of another host.
    pub import: Option<Import>,
    /// Certificates for mutual TLS.
    pub tls: Option<Tls>,
    /// File with Zenoh's `access_control` settings, which define the permissions of each client.
    pub access: Option<PathBuf>,
}

/// Rate at which a topic is sent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum TopicRate {
    /// Every sample is sent.
    All,
    /// This many samples are sent per second of the source's time, Hz.
    Hz(f64),
}

/// Certificates and key for mutual TLS, PEM.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tls {
    /// File with the certificate of the common authority.
    pub ca: PathBuf,
    /// File with the certificate of this vehicle.
    pub cert: PathBuf,
    /// File with the private key of this vehicle.
    pub key: PathBuf,
}

impl Default for Gateway {
    fn default() -> Self {
        let rates = [
            (Topic::Attitude, TopicRate::Hz(50.0)),
            (Topic::Fused, TopicRate::Hz(10.0)),
            (Topic::Gnss, TopicRate::All),
            (Topic::Difference, TopicRate::All),
            (Topic::Control, TopicRate::All),
            (Topic::Health, TopicRate::All),
        ];
        Self {
            vehicle: None,
            listen: vec!["tcp/127.0.0.1:7447".into()],
            connect: Vec::new(),
            messages_hz: 200.0,
            export: Vec::new(),
            cache_s: 30.0,
            import: None,
            rates: rates.map(|(topic, rate)| (topic.name().into(), rate)).into(),
            tls: None,
            access: None,
        }
    }
}

/// Topics imported from another host.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Import {
    /// Vehicle name of the other host's gateway.
    pub vehicle: String,
    /// Names of the topics.
    pub topics: Vec<String>,
}

impl Gateway {
    /// Returns `true` if slots of the system run on other hosts.
    pub fn is_split(&self) -> bool {
        !self.export.is_empty() || self.import.is_some()
    }

    pub(crate) fn imports(&self, topic: Topic) -> bool {
        self.import.as_ref().is_some_and(|import| import.topics.iter().any(|imported| imported == topic.name()))
    }
}
