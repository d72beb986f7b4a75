//! Classification and selection of the topics of a bag.

use std::{collections::BTreeMap, path::Path};

use foreign::ForeignText;
use mapping::names::nearest;

use crate::{ImportError, Note};

/// Maximum number of topics for which messages are counted.
const MAX_TOPICS: usize = 4096;
const MAX_NAME_BYTES: usize = 512;

/// Message type of a topic. The variants are in order of preference: Plumbline before ROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Kind {
    PlumblineImu,
    PlumblineMag,
    PlumblineFix,
    PlumblineReference,
    Imu,
    MagneticField,
    Twist,
    NavSatFix,
}

/// Quantity for which a topic is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Rows,
    Field,
    Velocity,
    Position,
    Reference,
}

impl Role {
    fn label(self) -> &'static str {
        match self {
            Self::Rows => "rate and force",
            Self::Field => "field",
            Self::Velocity => "velocity",
            Self::Position => "position",
            Self::Reference => "reference",
        }
    }
}

impl Kind {
    /// Returns the kind of a message with this encoding and schema; `None` if the kind is not
    /// supported.
    pub(super) fn from_schema(encoding: &str, schema: &str) -> Option<Self> {
        Some(match (encoding, schema) {
            ("protobuf", "plumbline.v1.ImuSample") => Self::PlumblineImu,
            ("protobuf", "plumbline.v1.MagSample") => Self::PlumblineMag,
            ("protobuf", "plumbline.v1.GnssFix") => Self::PlumblineFix,
            ("protobuf", "plumbline.v1.Reference") => Self::PlumblineReference,
            ("cdr", "sensor_msgs/msg/Imu") => Self::Imu,
            ("cdr", "sensor_msgs/msg/MagneticField") => Self::MagneticField,
            ("cdr", "geometry_msgs/msg/TwistStamped" | "geometry_msgs/msg/TwistWithCovarianceStamped") => Self::Twist,
            ("cdr", "sensor_msgs/msg/NavSatFix") => Self::NavSatFix,
            _ => return None,
        })
    }

    pub(super) fn role(self) -> Role {
        match self {
            Self::PlumblineImu | Self::Imu => Role::Rows,
            Self::PlumblineMag | Self::MagneticField => Role::Field,
            Self::PlumblineFix | Self::Twist => Role::Velocity,
            Self::NavSatFix => Role::Position,
            Self::PlumblineReference => Role::Reference,
        }
    }
}

/// Readable topic.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Topic {
    pub(super) kind: Kind,
    pub(super) name: ForeignText,
}

impl Topic {
    /// Creates a topic; `None` if its messages are not supported or its name is too long.
    pub(super) fn from_channel(name: &str, encoding: &str, schema: &str) -> Option<Self> {
        let kind = Kind::from_schema(encoding, schema).filter(|_| name.len() <= MAX_NAME_BYTES)?;
        Some(Self { kind, name: name.into() })
    }
}

/// Message counts of a topic.
#[derive(Debug, Default)]
pub(super) struct MessageCounts {
    pub(super) samples: u64,
    /// Number of messages that are malformed or marked as not measured.
    pub(super) rejected: u64,
    /// Number of samples with an attitude.
    pub(super) attitudes: u64,
}

/// Readable topics of a bag, and the topics that the user requested.
pub(super) struct Topics<'a> {
    requested: &'a [String],
    counts: BTreeMap<Topic, MessageCounts>,
}

impl<'a> Topics<'a> {
    pub(super) fn new(requested: &'a [String]) -> Self {
        Self { requested, counts: BTreeMap::new() }
    }

    /// Returns a mutable reference to the counts of a topic; `None` if there are too many topics.
    pub(super) fn counts_mut(&mut self, topic: &Topic) -> Option<&mut MessageCounts> {
        if !self.counts.contains_key(topic) {
            if self.counts.len() >= MAX_TOPICS {
                return None;
            }
            self.counts.insert(topic.clone(), MessageCounts::default());
        }
        self.counts.get_mut(topic)
    }

    pub(super) fn is_requested(&self, topic: &Topic) -> bool {
        self.requested.iter().any(|name| topic.name == **name)
    }

    /// Checks that the requested topics exist and that no two of them have the same role.
    pub(super) fn check_requested(&self, path: &Path) -> Result<(), ImportError> {
        for (index, name) in self.requested.iter().enumerate() {
            let known = || self.counts.keys().map(|topic| &topic.name);
            let Some(topic) = self.counts.keys().find(|topic| topic.name == **name) else {
                let near = nearest(name, known().map(ForeignText::raw)).map(ForeignText::from);
                let known = known().cloned().collect();
                return Err(ImportError::UnknownTopic { path: path.into(), found: name.clone(), near, known });
            };
            let role = topic.kind.role();
            let before = &self.requested[..index];
            let same = self
                .counts
                .keys()
                .find(|other| other.kind.role() == role && before.iter().any(|name| other.name == **name));
            if let Some(first) = same {
                let (first, second) = (first.name.raw().to_owned(), name.clone());
                return Err(ImportError::ConflictingTopics { path: path.into(), first, second, what: role.label() });
            }
        }
        Ok(())
    }

    /// Selects the topic to read for a role.
    ///
    /// This is the requested topic. If none is requested, it is the first topic with samples, in
    /// the order of [`Kind`] and then of the name. ROS velocities are read only on request, because
    /// their messages do not specify the axes.
    pub(super) fn select(&self, role: Role, notes: &mut Vec<Note>) -> Option<&Topic> {
        let of_role = || self.counts.iter().filter(|(topic, _)| topic.kind.role() == role);
        let is_read_by_default = |topic: &&Topic| topic.kind != Kind::Twist;
        let requested = || of_role().map(|(topic, _)| topic).find(|topic| self.is_requested(topic));
        let with_samples = || of_role().filter(|(_, count)| count.samples > 0).map(|(topic, _)| topic);
        let selected = requested().or_else(|| with_samples().find(is_read_by_default));
        let Some(selected) = selected else {
            let skipped = with_samples().map(|topic| topic.name.clone());
            notes.extend(skipped.map(|topic| Note::TopicOnRequest {
                what: "the velocity of a receiver",
                topic,
                interpretation: "east, north, up",
            }));
            return None;
        };
        if role != Role::Position {
            let others: Vec<_> =
                with_samples().filter(|topic| *topic != selected).map(|topic| topic.name.clone()).take(8).collect();
            if !others.is_empty() && requested().is_none() {
                notes.push(Note::OtherTopics { what: role.label(), read: selected.name.clone(), others });
            }
        }
        if let Some(MessageCounts { rejected: count @ 1.., .. }) = self.counts.get(selected) {
            let reason = "malformed, or marked as not measured";
            notes.push(Note::Skipped { what: "messages of the topics read", count: *count, reason });
        }
        Some(selected)
    }

    pub(super) fn has_attitudes(&self, topic: &Topic) -> bool {
        self.counts.get(topic).is_some_and(|count| count.attitudes > 0)
    }

    /// Returns the names of all readable topics.
    pub(super) fn names(&self) -> Vec<&ForeignText> {
        self.counts.keys().map(|topic| &topic.name).collect()
    }
}
