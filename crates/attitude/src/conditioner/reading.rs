//! Input and output of the conditioner.

use crate::{
    flags::Flags,
    gnss::{Fix, ReceiverFix},
};

/// Reading as reported by the sensors. Any value may be NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time on the source's clock, ns.
    pub t_ns: i64,
    /// Body rate in sensor axes, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force in sensor axes, m/s².
    pub force_m_s2: [f64; 3],
    /// Magnetic field in sensor axes, µT; `None` if the reading has no field sample.
    pub field_ut: Option<[f64; 3]>,
    /// Fix received since the previous reading.
    pub fix: Option<ReceiverFix>,
}

impl Reading {
    /// Returns the reading with each −0 replaced by 0.
    ///
    /// This is necessary because protobuf omits the sign of zero, and a flight replay must process
    /// the same bits.
    #[inline]
    pub fn without_negative_zero(&self) -> Self {
        let Self { t_ns, rate_rad_s, force_m_s2, field_ut, fix } = *self;
        let vector = |values: [f64; 3]| values.map(|value| value + 0.0);
        let optional = |value: Option<f64>| value.map(|value| value + 0.0);
        Self {
            t_ns,
            rate_rad_s: vector(rate_rad_s),
            force_m_s2: vector(force_m_s2),
            field_ut: field_ut.map(vector),
            fix: fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| ReceiverFix {
                fix: Fix {
                    velocity_m_s: vector(fix.velocity_m_s.into()).into(),
                    sd_m_s: optional(fix.sd_m_s),
                    age_s: optional(fix.age_s),
                    latitude_rad: optional(fix.latitude_rad),
                },
                longitude_rad: optional(longitude_rad),
                altitude_m: optional(altitude_m),
            }),
        }
    }
}

/// Checked sample of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Number of the sample. Samples are numbered consecutively from 0.
    pub tick: u64,
    /// Start of the interval, ns.
    pub t_start_ns: i64,
    /// End of the interval, ns; increases with every tick.
    pub t_end_ns: i64,
    /// Faults of the reading.
    pub flags: Flags,
    /// Body rate in body axes, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force in body axes, m/s²; points up at rest.
    pub force_m_s2: [f64; 3],
    /// Magnetic field in body axes, µT, if the reading has a new valid one.
    pub field_ut: Option<[f64; 3]>,
    /// Fix, if one arrived and is valid.
    pub fix: Option<ReceiverFix>,
}
