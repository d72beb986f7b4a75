//! Sensor values of a tick, with their faults.

use crate::{Vector3, accel::Inclination, flags::Flags, gnss::Fix, gyro::Motion};

/// Sensor values of a tick, with their faults.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorTick {
    /// Start of the interval, ns.
    pub t_start_ns: i64,
    /// End of the interval, ns.
    pub t_end_ns: i64,
    /// Set if there is a gap in time before this tick, or if ticks before it were lost.
    pub is_after_gap: bool,
    /// Set if the stage of the gyro or the accelerometer was reset for this tick.
    pub is_sensor_stage_reset: bool,
    /// Motion over the interval, from a gyro stage; `None` if the rate is missing.
    pub motion: Option<Motion>,
    /// Faults of the rate.
    pub rate_faults: RateFaults,
    /// Specific force in body axes as measured, m/s²; `None` if it is missing.
    pub force_m_s2: Option<Vector3<f64>>,
    /// Inclination from an accelerometer stage; `None` if the force has no direction.
    pub inclination: Option<Inclination>,
    /// Faults detected in the specific force.
    pub force_faults: ForceFaults,
    /// Magnetic field in body axes, µT. Present only for a new sample.
    pub field_ut: Option<Vector3<f64>>,
    /// Fix of the satellite receiver. Present only at the tick at which it arrived.
    pub fix: Option<Fix>,
}

impl SensorTick {
    /// Returns the interval and the faults of a tick, without its sensor values.
    #[inline]
    pub fn from_flags(t_start_ns: i64, t_end_ns: i64, flags: Flags) -> Self {
        Self {
            t_start_ns,
            t_end_ns,
            is_after_gap: flags.any(Flags::GAP | Flags::LOST_BEFORE),
            is_sensor_stage_reset: flags.any(Flags::RESET),
            rate_faults: RateFaults {
                is_invalid: flags.any(Flags::RATE_INVALID),
                is_clipped: flags.any(Flags::RATE_CLIPPED),
                is_stuck: flags.any(Flags::RATE_STUCK),
            },
            force_faults: ForceFaults {
                is_invalid: flags.any(Flags::FORCE_INVALID),
                is_small: flags.any(Flags::FORCE_SMALL),
                is_stuck: flags.any(Flags::FORCE_STUCK),
            },
            ..Self::default()
        }
    }
}

/// Faults of a rate sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RateFaults {
    /// The rate is not finite.
    pub is_invalid: bool,
    /// The rate is outside the range of the gyro.
    pub is_clipped: bool,
    /// The gyro repeats a value.
    pub is_stuck: bool,
}

/// Faults of a specific force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ForceFaults {
    /// The specific force is not finite.
    pub is_invalid: bool,
    /// The force is too small to have a direction.
    pub is_small: bool,
    /// The accelerometer repeats a value.
    pub is_stuck: bool,
}
