//! What goes beyond the board, and to where: `[gateway]`.

use std::{collections::BTreeMap, path::PathBuf};

use graph::Topic;
use serde::{Deserialize, Serialize};

/// What goes beyond the board, and to where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gateway {
    /// The vehicle's name beyond the board; the system's name where there is none.
    pub vehicle: Option<String>,
    /// Where others may connect, as `tcp/127.0.0.1:7447` or `quic/0.0.0.0:7447`; a port of the loopback that is taken is passed over for
    /// the next free one.
    pub listen: Vec<String>,
    /// Whom it connects to: routers and stations.
    pub connect: Vec<String>,
    /// Messages per second of a topic at most, Hz: a topic that is faster goes several samples to a message; a path that is not is waited
    /// for, and goes out at once.
    pub messages_hz: f64,
    /// How much of each topic goes out, by its name; nothing of a topic that is not there.
    pub rates: BTreeMap<String, Rate>,
    /// Topics that slots on other hosts take part in: each tick goes out, and again to who missed it.
    pub export: Vec<String>,
    /// For how long exported ticks are kept for a host that was cut off, s.
    pub cache_s: f64,
    /// What comes from the slots of another host.
    pub import: Option<Import>,
    /// The certificates of mutual TLS.
    pub tls: Option<Tls>,
    /// A file with Zenoh's `access_control`: who may do what.
    pub access: Option<PathBuf>,
}

/// How much of a topic goes out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Rate {
    /// Every sample.
    All,
    /// So many samples a second of the source's time, Hz.
    Hz(f64),
}

/// The certificates of mutual TLS, PEM.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tls {
    /// Of the authority that has signed everybody's.
    pub ca: PathBuf,
    /// This vehicle's.
    pub cert: PathBuf,
    /// The key to it.
    pub key: PathBuf,
}

impl Default for Gateway {
    fn default() -> Self {
        let rates = [
            (Topic::Attitude, Rate::Hz(50.0)),
            (Topic::Fused, Rate::Hz(10.0)),
            (Topic::Gnss, Rate::All),
            (Topic::Difference, Rate::All),
            (Topic::Control, Rate::All),
            (Topic::Health, Rate::All),
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

/// Topics that come from another host.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Import {
    /// The name of the other's gateway beyond its board.
    pub vehicle: String,
    /// Which ones.
    pub topics: Vec<String>,
}

impl Gateway {
    /// Slots of the system are on other hosts.
    pub fn is_split(&self) -> bool {
        !self.export.is_empty() || self.import.is_some()
    }

    pub(crate) fn imports(&self, topic: Topic) -> bool {
        self.import.as_ref().is_some_and(|import| import.topics.iter().any(|imported| imported == topic.name()))
    }
}
