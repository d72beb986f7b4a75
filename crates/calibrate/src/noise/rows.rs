//! Readings of both sensors as rows of six values.

/// Total number of axes of gyro and accelerometer.
pub(super) const AXES: usize = 6;

/// Reading, or mean of successive readings.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub(super) t_ns: i64,
    /// Rate in rad/s and specific force in m/s².
    pub(super) values: [f64; AXES],
}

impl Row {
    /// Returns the mean of two successive rows.
    pub(super) fn mean_of_pair(pair: &[Self]) -> Self {
        let values = std::array::from_fn(|i| 0.5 * (pair[0].values[i] + pair[1].values[i]));
        Self { t_ns: pair[0].t_ns + (pair[1].t_ns - pair[0].t_ns) / 2, values }
    }
}

/// Axis of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    Gyro(usize),
    Accel(usize),
}

impl Axis {
    pub(super) const ALL: [Self; AXES] =
        [Self::Gyro(0), Self::Gyro(1), Self::Gyro(2), Self::Accel(0), Self::Accel(1), Self::Accel(2)];

    pub(super) fn is_gyro(self) -> bool {
        matches!(self, Self::Gyro(_))
    }

    /// Returns the index in a [`Row`].
    pub(super) fn index(self) -> usize {
        match self {
            Self::Gyro(axis) => axis,
            Self::Accel(axis) => 3 + axis,
        }
    }

    pub(super) fn name(self) -> &'static str {
        ["x", "y", "z"][self.index() % 3]
    }

    pub(super) fn sensor(self) -> &'static str {
        if self.is_gyro() { "gyro" } else { "accelerometer" }
    }

    /// Returns the unit of displayed values, and the factor that converts a value of a [`Row`] to
    /// it.
    pub(super) fn unit(self) -> (&'static str, f64) {
        if self.is_gyro() { ("°/s", 1f64.to_degrees()) } else { ("m/s²", 1.0) }
    }
}

/// Returns the time between two readings, s.
pub(super) fn seconds(first: &Row, last: &Row) -> f64 {
    (last.t_ns - first.t_ns) as f64 * 1e-9
}
