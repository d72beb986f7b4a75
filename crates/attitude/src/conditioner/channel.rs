//! Checks the values of one sensor channel.
//!
//! Input: values as reported by the sensor.
//!
//! Output: usable values, or `None`, with flags.
//!
//! Time: the duration of constant or invalid values is the sum of the intervals that the caller
//! passes.

use super::transform::SensorTransform;
use crate::{
    flags::Flags,
    gnss::{Fix, MAX_SPEED_M_S, ReceiverFix},
    magnetometer::RepeatFilter,
    state_words::StateWords,
};

/// Multiple of the measuring range beyond which a value is invalid rather than clipped.
const SANITY_FACTOR: f64 = 10.0;
/// Maximum plausible magnitude of an altitude, m. Altitudes beyond it are discarded.
const MAX_ALTITUDE_M: f64 = 1e6;

/// Returns the fix without implausible values, or `None` with a flag if its velocity is invalid.
#[inline]
pub(super) fn check_fix(fix: Option<ReceiverFix>) -> (Option<ReceiverFix>, Flags) {
    let Some(ReceiverFix { fix, longitude_rad, altitude_m }) = fix else { return (None, Flags::NONE) };
    // The comparison also rejects NaN.
    if !fix.velocity_m_s.iter().all(|x| x.abs() < MAX_SPEED_M_S) {
        return (None, Flags::FIX_INVALID);
    }
    let plausible = |value: Option<f64>, limit: f64| value.filter(|value| value.is_finite() && value.abs() <= limit);
    let fix = Fix {
        velocity_m_s: fix.velocity_m_s,
        sd_m_s: plausible(fix.sd_m_s, MAX_SPEED_M_S).filter(|sd| *sd > 0.0),
        age_s: plausible(fix.age_s, 10.0).filter(|age| *age >= 0.0),
        latitude_rad: plausible(fix.latitude_rad, core::f64::consts::FRAC_PI_2),
    };
    let longitude_rad = plausible(longitude_rad, core::f64::consts::PI);
    (Some(ReceiverFix { fix, longitude_rad, altitude_m: plausible(altitude_m, MAX_ALTITUDE_M) }), Flags::FIX)
}

/// Channel of the magnetometer.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldChannel {
    limit_ut: f64,
    repeat_filter: RepeatFilter,
}

impl FieldChannel {
    /// Creates a channel that rejects components of `limit_ut` and above.
    pub(super) fn new(limit_ut: f64) -> Self {
        Self { limit_ut, repeat_filter: RepeatFilter::default() }
    }

    /// Returns the magnetic field if it is a new valid sample, and its flags.
    ///
    /// The field is in the units of the sensor.
    #[inline]
    pub(super) fn check(
        &mut self,
        field_ut: Option<[f64; 3]>,
        transform: &SensorTransform,
    ) -> (Option<[f64; 3]>, Flags) {
        let Some(field_ut) = field_ut else { return (None, Flags::NONE) };
        if !transform.in_range_units(field_ut).iter().all(|x| x.abs() < self.limit_ut) {
            return (None, Flags::FIELD_INVALID);
        }
        let sample_ut = self.repeat_filter.new_sample(Some(field_ut.into()));
        (sample_ut.map(Into::into), Flags::FIELD.when(sample_ut.is_some()))
    }
}

/// Channel of one vector: rate or force.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VectorChannel {
    pub(super) limit: f64,
    pub(super) invalid: Flags,
    pub(super) clipped: Flags,
    pub(super) stuck: Flags,
    pub(super) stuck_ns: i64,
    pub(super) last_valid: [f64; 3],
    pub(super) repeated_ns: i64,
    pub(super) invalid_ns: i64,
}

impl VectorChannel {
    /// Returns the value to use, in the units of the sensor, and its flags. An invalid value is
    /// replaced by the last valid one.
    #[inline]
    pub(super) fn check(&mut self, value: [f64; 3], transform: &SensorTransform, dt_ns: i64) -> ([f64; 3], Flags) {
        let calibrated = transform.in_range_units(value);
        if !calibrated.iter().all(|x| x.abs() < self.limit * SANITY_FACTOR) {
            self.invalid_ns = self.invalid_ns.saturating_add(dt_ns);
            return (self.last_valid, self.invalid);
        }
        self.invalid_ns = 0;
        self.repeated_ns = if value == self.last_valid { self.repeated_ns.saturating_add(dt_ns) } else { 0 };
        self.last_valid = value;
        let is_clipped = calibrated.iter().any(|x| x.abs() >= self.limit);
        (value, self.clipped.when(is_clipped) | self.stuck.when(self.repeated_ns >= self.stuck_ns))
    }
}

impl StateWords for VectorChannel {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { limit: _, invalid: _, clipped: _, stuck: _, stuck_ns: _, last_valid, repeated_ns, invalid_ns } =
            self;
        last_valid.visit(visit);
        repeated_ns.visit(visit);
        invalid_ns.visit(visit);
    }
}

impl StateWords for FieldChannel {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { limit_ut: _, repeat_filter } = self;
        repeat_filter.visit(visit);
    }
}
