//! Classification and selection of the topics of a bag.

use std::{collections::BTreeMap, path::Path};

use foreign::ForeignText;
use mapping::names::nearest;

use super::samples::InertialSample;
use crate::{
    ImportError, Note, Sensor,
    sensor_state::SensorState,
    timeline::{Segment, SegmentFinder},
};

/// Maximum number of topics for which messages are counted.
const MAX_TOPICS: usize = 4096;
const MAX_NAME_BYTES: usize = 512;
/// Minimum number of equal timestamps for the timestamps of a topic to count as constant.
const MIN_CONSTANT_STAMPS: u64 = 10;

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
    /// Pose of a body: `PoseStamped`, and the leading fields of `PoseWithCovarianceStamped`.
    Pose,
    /// Pose of a named frame: `TransformStamped`, and the leading fields of `Odometry`.
    ChildPose,
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
            ("cdr", "geometry_msgs/msg/PoseStamped" | "geometry_msgs/msg/PoseWithCovarianceStamped") => Self::Pose,
            ("cdr", "geometry_msgs/msg/TransformStamped" | "nav_msgs/msg/Odometry") => Self::ChildPose,
            _ => return None,
        })
    }

    pub(super) fn role(self) -> Role {
        match self {
            Self::PlumblineImu | Self::Imu => Role::Rows,
            Self::PlumblineMag | Self::MagneticField => Role::Field,
            Self::PlumblineFix | Self::Twist => Role::Velocity,
            Self::NavSatFix => Role::Position,
            Self::PlumblineReference | Self::Pose | Self::ChildPose => Role::Reference,
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
    /// Number of samples with both rate and force.
    joint: u64,
    /// Number of samples with a rate that is not zero.
    pub(super) rates: u64,
    /// Number of samples with a force that is not zero.
    pub(super) forces: u64,
    /// First timestamp of the samples, ns.
    first_stamp_ns: Option<i64>,
    /// `true` if the timestamps of two samples differ.
    has_moving_stamps: bool,
    /// State of the sensor. The times of its samples are log times.
    pub(super) state: SensorState,
    /// Segments of the samples, found from the timestamps and from the log times.
    pub(super) segments: [SegmentFinder; 2],
}

impl MessageCounts {
    /// Adds a sample of rate, force or both.
    pub(super) fn push_inertial(&mut self, sample: &InertialSample, log_ns: i64) {
        let is_non_zero = |vector: Option<[f64; 3]>| vector.is_some_and(|vector| vector != [0.0; 3]);
        self.rates += u64::from(is_non_zero(sample.rate_rad_s));
        self.forces += u64::from(is_non_zero(sample.force_m_s2));
        self.joint += u64::from(sample.rate_rad_s.is_some() && sample.force_m_s2.is_some());
        self.attitudes += u64::from(sample.attitude.is_some());
        self.state.push(log_ns, [sample.rate_rad_s, sample.force_m_s2], true);
        let [by_stamp, by_log_time] = &mut self.segments;
        by_stamp.push(sample.t_ns);
        by_log_time.push(log_ns);
    }

    /// Adds the timestamp of a sample of any kind.
    pub(super) fn push_stamp(&mut self, t_ns: i64) {
        let first_ns = *self.first_stamp_ns.get_or_insert(t_ns);
        self.has_moving_stamps |= t_ns != first_ns;
    }

    /// Returns `true` if the timestamps of the samples never change.
    pub(super) fn has_constant_stamps(&self) -> bool {
        self.first_stamp_ns.is_some() && !self.has_moving_stamps && self.samples >= MIN_CONSTANT_STAMPS
    }

    /// Returns `true` if the messages of the topic declare both rate and force as measured.
    fn is_complete(&self) -> bool {
        self.joint > 0
    }

    /// Returns `true` if the topic has rates and no forces.
    fn has_rates_only(&self) -> bool {
        self.rates > 0 && self.forces == 0
    }

    /// Returns `true` if the topic has forces and no rates.
    fn has_forces_only(&self) -> bool {
        self.forces > 0 && self.rates == 0
    }
}

/// Topics from which rate and force are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct MotionTopics {
    /// Topic of the rate.
    pub(super) rate: Topic,
    /// Topic of the force, if it differs from that of the rate.
    pub(super) force: Option<Topic>,
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
            let state = match topic.kind.role() {
                Role::Velocity => SensorState::of_receiver(),
                _ => SensorState::default(),
            };
            self.counts.insert(topic.clone(), MessageCounts { state, ..MessageCounts::default() });
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
            // Rate and force may be on two topics.
            let is_pair = |first: &Topic| {
                let counts = [self.counts.get(first), self.counts.get(topic)];
                role == Role::Rows
                    && counts.into_iter().flatten().all(|counts| counts.has_rates_only() || counts.has_forces_only())
            };
            if let Some(first) = same.filter(|first| !is_pair(first)) {
                let (first, second) = (first.name.raw().to_owned(), name.clone());
                return Err(ImportError::ConflictingTopics { path: path.into(), first, second, what: role.label() });
            }
        }
        Ok(())
    }

    /// Selects the topic to read for a role.
    ///
    /// If a topic is requested, selects this topic. Otherwise, selects the first topic with
    /// samples, in the order of [`Kind`] and then of the name. A magnetometer that works is
    /// preferred. ROS velocities and poses are read only on request, because their messages do not
    /// specify the axes.
    pub(super) fn select(&self, role: Role, notes: &mut Vec<Note>) -> Option<&Topic> {
        let of_role = || self.counts.iter().filter(|(topic, _)| topic.kind.role() == role);
        let is_read_by_default = |topic: &&Topic| !matches!(topic.kind, Kind::Twist | Kind::Pose | Kind::ChildPose);
        let requested = || of_role().map(|(topic, _)| topic).find(|topic| self.is_requested(topic));
        let with_samples = || of_role().filter(|(_, count)| count.samples > 0).map(|(topic, _)| topic);
        let is_healthy = |topic: &&Topic| {
            role != Role::Field || self.counts.get(*topic).is_some_and(|counts| counts.state.is_healthy())
        };
        let default = || with_samples().filter(is_read_by_default);
        let first = || default().find(is_healthy).or_else(|| default().next());
        let selected = requested().or_else(first);
        let Some(selected) = selected else {
            let skipped = with_samples().map(|topic| topic.name.clone());
            let (what, interpretation) = match role {
                Role::Reference => ("a reference attitude", "the rotation from body axes to east, north, up"),
                _ => ("the velocity of a receiver", "east, north, up"),
            };
            notes.extend(skipped.map(|topic| Note::TopicOnRequest { what, topic, interpretation }));
            return None;
        };
        if role != Role::Position {
            let others: Vec<_> =
                with_samples().filter(|topic| *topic != selected).map(|topic| topic.name.clone()).take(8).collect();
            if !others.is_empty() && requested().is_none() {
                notes.push(Note::OtherTopics { what: role.label(), read: selected.name.clone(), others });
            }
        }
        self.note_rejected(selected, notes);
        Some(selected)
    }

    /// Selects the topic with this number for a role. If no number is given, selects the topic like
    /// [`Topics::select`].
    pub(super) fn select_numbered(
        &self,
        path: &Path,
        role: Role,
        number: Option<usize>,
        notes: &mut Vec<Note>,
    ) -> Result<Option<Topic>, ImportError> {
        let Some(number) = number else { return Ok(self.select(role, notes).cloned()) };
        let with_samples =
            || self.counts.iter().filter(|(topic, counts)| topic.kind.role() == role && counts.samples > 0);
        let what = if role == Role::Field { "--mag" } else { "--gnss" };
        let unknown = || {
            let count = with_samples().count();
            ImportError::UnknownSensor { path: path.into(), what, found: number, count }
        };
        with_samples().nth(number).map(|(topic, _)| Some(topic.clone())).ok_or_else(unknown)
    }

    /// Selects the topics of rate and force.
    ///
    /// If `number` is given, selects the sensor with this number. Otherwise, selects the first
    /// sensor that works. If no topic has both quantities, selects one topic with rates and one
    /// with forces.
    pub(super) fn select_motion(
        &self,
        path: &Path,
        number: Option<usize>,
        notes: &mut Vec<Note>,
    ) -> Result<Option<MotionTopics>, ImportError> {
        let is_wanted = {
            let any_requested =
                self.counts.keys().any(|topic| topic.kind.role() == Role::Rows && self.is_requested(topic));
            move |topic: &Topic| !any_requested || self.is_requested(topic)
        };
        let rows = || {
            let counts = self.counts.iter().filter(|(topic, _)| topic.kind.role() == Role::Rows);
            counts.filter(|(topic, counts)| counts.samples > 0 && is_wanted(topic))
        };
        let complete = || rows().filter(|(_, counts)| counts.is_complete());
        let single = |topic: &Topic| MotionTopics { rate: topic.clone(), force: None };
        if let Some(number) = number {
            let count = complete().count();
            let found = complete().nth(number).map(|(topic, _)| single(topic));
            let unknown = || ImportError::UnknownSensor { path: path.into(), what: "--imu", found: number, count };
            return found.ok_or_else(unknown).map(Some);
        }
        let has_both = rows().any(|(_, counts)| counts.rates > 0 && counts.forces > 0);
        let rate = rows().find(|(_, counts)| counts.has_rates_only());
        let force = rows().find(|(_, counts)| counts.has_forces_only());
        if let (false, Some((rate, _)), Some((force, _))) = (has_both, rate, force) {
            notes.push(Note::Joined { rate: rate.name.clone(), force: force.name.clone() });
            return Ok(Some(MotionTopics { rate: rate.clone(), force: Some(force.clone()) }));
        }
        let first = complete().find(|(_, counts)| counts.state.is_healthy()).or_else(|| complete().next());
        let Some((topic, _)) = first.or_else(|| rows().next()) else { return Ok(None) };
        for (dead, _) in complete().take_while(|(other, _)| *other != topic) {
            notes.push(Note::DeadSensor { sensor: dead.name.clone(), read: topic.name.clone() });
        }
        let others: Vec<_> =
            rows().filter(|(other, _)| *other != topic).map(|(other, _)| other.name.clone()).take(8).collect();
        if !others.is_empty() && !self.is_requested(topic) {
            notes.push(Note::OtherTopics { what: Role::Rows.label(), read: topic.name.clone(), others });
        }
        self.note_rejected(topic, notes);
        Ok(Some(single(topic)))
    }

    /// Returns the inertial sensors that measure both rate and force. `read` is the topic that is
    /// read.
    pub(super) fn sensors(&self, read: Option<&Topic>, uses_log_times: bool) -> Vec<Sensor> {
        let counts =
            self.counts.iter().filter(|(topic, counts)| topic.kind.role() == Role::Rows && counts.is_complete());
        let sensors = (0..).zip(counts).map(|(number, (topic, counts)): (usize, _)| {
            let segments = counts.segments[usize::from(uses_log_times)].segments();
            Sensor {
                option: format!("--imu {number}"),
                name: topic.name.clone(),
                samples: counts.samples,
                rate_hz: counts.samples.saturating_sub(1) as f64
                    / segments.iter().map(Segment::duration_s).sum::<f64>(),
                state: counts.state.problem().unwrap_or("healthy"),
                is_read: read == Some(topic),
            }
        });
        sensors.collect()
    }

    /// Returns the sensors in a role, such as magnetometers. The sensor with the topic `read` is
    /// marked as used.
    pub(super) fn other_sensors(&self, option: &str, role: Role, read: Option<&Topic>) -> Vec<Sensor> {
        let counts = self.counts.iter().filter(|(topic, counts)| topic.kind.role() == role && counts.samples > 0);
        let sensors = counts.enumerate().map(|(number, (topic, counts))| {
            counts.state.sensor(option, number, topic.name.clone(), read == Some(topic))
        });
        sensors.collect()
    }

    /// Returns the counts of a topic.
    pub(super) fn counts(&self, topic: &Topic) -> Option<&MessageCounts> {
        self.counts.get(topic)
    }

    fn note_rejected(&self, topic: &Topic, notes: &mut Vec<Note>) {
        let Some(counts) = self.counts.get(topic) else { return };
        let partial = if topic.kind.role() == Role::Rows { counts.samples - counts.joint } else { 0 };
        let count = counts.rejected + partial;
        if count > 0 {
            let reason = "malformed, or marked as not measured";
            notes.push(Note::Skipped { what: "messages of the topics read", count, reason });
        }
    }

    pub(super) fn has_attitudes(&self, topic: &Topic) -> bool {
        self.counts.get(topic).is_some_and(|count| count.attitudes > 0)
    }

    /// Returns the names of all readable topics.
    pub(super) fn names(&self) -> Vec<&ForeignText> {
        self.counts.keys().map(|topic| &topic.name).collect()
    }
}
