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
    /// Names of all topics that are read.
    pub(super) const TOPICS: [&str; 10] = [
        "sensor_combined",
        "vehicle_imu",
        "sensor_gyro",
        "sensor_accel",
        "vehicle_magnetometer",
        "sensor_mag",
        "vehicle_attitude",
        "vehicle_gps_position",
        "sensor_gps",
        "sensors_status_imu",
    ];

    /// Returns the kinds of series in a topic.
    pub(super) fn of_topic(topic: &str) -> &'static [Self] {
        match topic {
            "sensor_combined" => &[Self::Combined, Self::CombinedField],
            "vehicle_imu" => &[Self::Integrated],
            "sensor_gyro" => &[Self::Rate],
            "sensor_accel" => &[Self::Force],
            "vehicle_magnetometer" => &[Self::Field],
            "sensor_mag" => &[Self::RawField],
            "vehicle_attitude" => &[Self::Attitude],
            "vehicle_gps_position" => &[Self::Fix],
            "sensor_gps" => &[Self::RawFix],
            "sensors_status_imu" => &[Self::Health],
            _ => &[],
        }
    }

    /// Returns the topic of the series.
    pub(super) fn topic(self) -> &'static str {
        match self {
            Self::Combined | Self::CombinedField => "sensor_combined",
            Self::Integrated => "vehicle_imu",
            Self::Rate => "sensor_gyro",
            Self::Force => "sensor_accel",
            Self::Field => "vehicle_magnetometer",
            Self::RawField => "sensor_mag",
            Self::Attitude => "vehicle_attitude",
            Self::Fix => "vehicle_gps_position",
            Self::RawFix => "sensor_gps",
            Self::Health => "sensors_status_imu",
        }
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
