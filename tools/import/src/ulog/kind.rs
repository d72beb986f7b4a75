//! Kinds of series in a ULog.

use crate::sensor_state::SensorState;

/// Kind of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Rate and force of the sensor that the autopilot chose.
    Combined,
    /// Magnetic field in the messages of [`Kind::Combined`] in an old log.
    CombinedField,
    /// Rate and force of one sensor, integrated over an interval.
    Integrated,
    Rate,
    Force,
    Field,
    /// Magnetic field without calibration.
    RawField,
    Attitude,
    Fix,
    /// Fix from one of several receivers.
    RawFix,
    /// Health of all inertial sensors.
    Health,
}

impl Kind {
    /// Topics that are read, with the kinds of series in each.
    pub(super) const TOPICS: [(&str, &[Self]); 10] = [
        ("sensor_combined", &[Self::Combined, Self::CombinedField]),
        ("vehicle_imu", &[Self::Integrated]),
        ("sensor_gyro", &[Self::Rate]),
        ("sensor_accel", &[Self::Force]),
        ("vehicle_magnetometer", &[Self::Field]),
        ("sensor_mag", &[Self::RawField]),
        ("vehicle_attitude", &[Self::Attitude]),
        ("vehicle_gps_position", &[Self::Fix]),
        ("sensor_gps", &[Self::RawFix]),
        ("sensors_status_imu", &[Self::Health]),
    ];

    /// Returns the kinds of series in a topic.
    pub(super) fn of_topic(topic: &str) -> &'static [Self] {
        Self::TOPICS.iter().find(|(name, _)| *name == topic).map_or(&[], |(_, kinds)| kinds)
    }

    /// Returns the topic of the series.
    pub(super) fn topic(self) -> &'static str {
        Self::TOPICS.iter().find(|(_, kinds)| kinds.contains(&self)).map_or("", |(name, _)| name)
    }

    /// Returns the name of the samples, as a plural noun.
    pub(super) fn samples(self) -> &'static str {
        match self {
            Self::Integrated => "vehicle_imu samples",
            Self::Rate => "sensor_gyro samples",
            Self::Force => "sensor_accel samples",
            _ => "sensor_combined samples",
        }
    }

    /// Returns the state of a sensor before its first sample.
    pub(super) fn new_state(self) -> SensorState {
        match self {
            Self::Fix | Self::RawFix | Self::Attitude => SensorState::of_receiver(),
            _ => SensorState::default(),
        }
    }
}
