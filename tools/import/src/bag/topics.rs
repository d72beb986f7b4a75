//! What the topics of a bag hold, and which of them are read.

use std::{collections::BTreeMap, path::Path};

use mapping::names::nearest;

use crate::{ImportError, Note};

/// Topics that are looked at.
const MAX_TOPICS: usize = 4096;
const MAX_NAME_BYTES: usize = 512;

/// What a message says; ours are taken before those of ROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Kind {
    OurSample,
    OurField,
    OurFix,
    OurReference,
    Imu,
    MagneticField,
    Twist,
    NavSatFix,
}

/// What a topic is read for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Rows,
    Field,
    Velocity,
    Position,
    Reference,
}

impl Role {
    fn what(self) -> &'static str {
        match self {
            Self::Rows => "rate and force",
            Self::Field => "the field",
            Self::Velocity => "the velocity",
            Self::Position => "the position",
            Self::Reference => "the reference",
        }
    }
}

impl Kind {
    /// The kind of messages of an encoding and a type; `None` of those that nothing is read of.
    pub(super) fn of(encoding: &str, schema: &str) -> Option<Self> {
        Some(match (encoding, schema) {
            ("protobuf", "plumbline.v1.ImuSample") => Self::OurSample,
            ("protobuf", "plumbline.v1.MagSample") => Self::OurField,
            ("protobuf", "plumbline.v1.GnssFix") => Self::OurFix,
            ("protobuf", "plumbline.v1.Reference") => Self::OurReference,
            ("cdr", "sensor_msgs/msg/Imu") => Self::Imu,
            ("cdr", "sensor_msgs/msg/MagneticField") => Self::MagneticField,
            ("cdr", "geometry_msgs/msg/TwistStamped" | "geometry_msgs/msg/TwistWithCovarianceStamped") => Self::Twist,
            ("cdr", "sensor_msgs/msg/NavSatFix") => Self::NavSatFix,
            _ => return None,
        })
    }

    pub(super) fn role(self) -> Role {
        match self {
            Self::OurSample | Self::Imu => Role::Rows,
            Self::OurField | Self::MagneticField => Role::Field,
            Self::OurFix | Self::Twist => Role::Velocity,
            Self::NavSatFix => Role::Position,
            Self::OurReference => Role::Reference,
        }
    }
}

/// A topic that can be read.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Topic {
    pub(super) kind: Kind,
    pub(super) name: String,
}

impl Topic {
    /// `None` of a topic that nothing is read of.
    pub(super) fn of(name: &str, encoding: &str, schema: &str) -> Option<Self> {
        let kind = Kind::of(encoding, schema).filter(|_| name.len() <= MAX_NAME_BYTES)?;
        Some(Self { kind, name: name.into() })
    }
}

/// What came of a topic.
#[derive(Debug, Default)]
pub(super) struct Count {
    pub(super) samples: u64,
    /// Messages that say nothing.
    pub(super) refused: u64,
    /// Samples with an attitude.
    pub(super) attitudes: u64,
}

/// All topics that can be read, and those that people named.
pub(super) struct Topics<'a> {
    named: &'a [String],
    counts: BTreeMap<Topic, Count>,
}

impl<'a> Topics<'a> {
    pub(super) fn new(named: &'a [String]) -> Self {
        Self { named, counts: BTreeMap::new() }
    }

    pub(super) fn count(&mut self, topic: &Topic) -> Option<&mut Count> {
        if !self.counts.contains_key(topic) {
            if self.counts.len() >= MAX_TOPICS {
                return None;
            }
            self.counts.insert(topic.clone(), Count::default());
        }
        self.counts.get_mut(topic)
    }

    pub(super) fn is_named(&self, topic: &Topic) -> bool {
        self.named.contains(&topic.name)
    }

    /// Refuses names of topics that are not there, or of two for one thing.
    pub(super) fn check(&self, path: &Path) -> Result<(), ImportError> {
        for (index, name) in self.named.iter().enumerate() {
            let known = || self.counts.keys().map(|topic| topic.name.as_str());
            let Some(topic) = self.counts.keys().find(|topic| topic.name == *name) else {
                let near = nearest(name, known()).map(str::to_owned);
                let known = known().map(str::to_owned).collect();
                return Err(ImportError::UnknownTopic { path: path.into(), found: name.clone(), near, known });
            };
            let role = topic.kind.role();
            let before = &self.named[..index];
            let same = self.counts.keys().find(|other| other.kind.role() == role && before.contains(&other.name));
            if let Some(first) = same {
                let (first, second) = (first.name.clone(), name.clone());
                return Err(ImportError::TopicTwice { path: path.into(), first, second, what: role.what() });
            }
        }
        Ok(())
    }

    /// The topic to read for a role: the one named, else the first by name of those that say something. Velocities of ROS are read
    /// only where they are named: nothing in them says in which axes they are.
    pub(super) fn choose(&self, role: Role, notes: &mut Vec<Note>) -> Option<&Topic> {
        let of_role = || self.counts.iter().filter(|(topic, _)| topic.kind.role() == role);
        let is_open = |topic: &&Topic| topic.kind != Kind::Twist;
        let named = || of_role().map(|(topic, _)| topic).find(|topic| self.is_named(topic));
        let speaking = || of_role().filter(|(_, count)| count.samples > 0).map(|(topic, _)| topic);
        let chosen = named().or_else(|| speaking().find(is_open));
        let Some(chosen) = chosen else {
            let unnamed = speaking().map(|topic| topic.name.clone());
            notes.extend(unnamed.map(|topic| Note::Unnamed {
                what: "the velocity of a receiver",
                topic,
                meaning: "east, north, up",
            }));
            return None;
        };
        if role != Role::Position {
            let others: Vec<_> =
                speaking().filter(|topic| *topic != chosen).map(|topic| topic.name.clone()).take(8).collect();
            if !others.is_empty() && named().is_none() {
                notes.push(Note::OtherTopics { what: role.what(), read: chosen.name.clone(), others });
            }
        }
        if let Some(Count { refused: count @ 1.., .. }) = self.counts.get(chosen) {
            let why = "they are malformed, or say that nothing was measured";
            notes.push(Note::LeftOut { what: "messages of the topics read", count: *count, why });
        }
        Some(chosen)
    }

    pub(super) fn has_attitudes(&self, topic: &Topic) -> bool {
        self.counts.get(topic).is_some_and(|count| count.attitudes > 0)
    }

    /// The names of all topics that can be read.
    pub(super) fn names(&self) -> Vec<&str> {
        self.counts.keys().map(|topic| topic.name.as_str()).collect()
    }
}
