//! One channel of a sensor: what to go on with, and what is to be said about it.
//!
//! Input: a value as the sensor gives it. Output: a value that can be used, or none, with flags. Time: how long a value has stood or
//! been missing is counted from the intervals given. Failure: none.

use attitude::gnss::Fix;
use messages::Flags;

use crate::source::ReceiverFix;

/// A value this many times beyond the range is not a measurement.
const SENSE: f64 = 10.0;
/// A fix that says more than this of a speed is not one, m/s: nothing that is guided by us is faster.
const MAX_SPEED_M_S: f64 = 3000.0;
/// An altitude beyond this is not told, m.
const MAX_ALTITUDE_M: f64 = 1e6;

/// A fix that makes sense; what does not is left out, flagged.
pub(crate) fn checked(fix: Option<ReceiverFix>) -> (Option<ReceiverFix>, Flags) {
    let Some(ReceiverFix { fix, longitude_rad, altitude_m }) = fix else { return (None, Flags::NONE) };
    // The comparison also refuses what is not a number.
    if !fix.velocity_m_s.iter().all(|x| x.abs() < MAX_SPEED_M_S) {
        return (None, Flags::FIX_INVALID);
    }
    let sound = |value: Option<f64>, limit: f64| value.filter(|value| value.is_finite() && value.abs() <= limit);
    let fix = Fix {
        velocity_m_s: fix.velocity_m_s,
        sd_m_s: sound(fix.sd_m_s, MAX_SPEED_M_S).filter(|sd| *sd > 0.0),
        age_s: sound(fix.age_s, 10.0).filter(|age| *age >= 0.0),
        latitude_rad: sound(fix.latitude_rad, std::f64::consts::FRAC_PI_2),
    };
    let longitude_rad = sound(longitude_rad, std::f64::consts::PI);
    (Some(ReceiverFix { fix, longitude_rad, altitude_m: sound(altitude_m, MAX_ALTITUDE_M) }), Flags::FIX)
}

/// The magnetometer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FieldChannel {
    pub(crate) limit_ut: f64,
    pub(crate) last_ut: Option<[f64; 3]>,
}

impl FieldChannel {
    /// The field where it is a new sample, and what is to be said about it.
    pub(crate) fn check(&mut self, field_ut: Option<[f64; 3]>) -> (Option<[f64; 3]>, Flags) {
        let Some(field_ut) = field_ut else { return (None, Flags::NONE) };
        if !field_ut.iter().all(|x| x.abs() < self.limit_ut) {
            return (None, Flags::FIELD_INVALID);
        }
        // A magnetometer is slower than a gyro; a recording repeats it until it has something new to say.
        if self.last_ut.replace(field_ut) == Some(field_ut) {
            return (None, Flags::NONE);
        }
        (Some(field_ut), Flags::FIELD)
    }
}

/// One vector of the sensor.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Channel {
    pub(crate) limit: f64,
    pub(crate) invalid: Flags,
    pub(crate) clipped: Flags,
    pub(crate) stuck: Flags,
    pub(crate) stuck_ns: i64,
    pub(crate) good: [f64; 3],
    pub(crate) repeated_ns: i64,
    pub(crate) invalid_ns: i64,
}

impl Channel {
    /// The value to go on with, and what is to be said about it.
    pub(crate) fn check(&mut self, value: [f64; 3], dt_ns: i64) -> ([f64; 3], Flags) {
        if !value.iter().all(|x| x.abs() < self.limit * SENSE) {
            self.invalid_ns = self.invalid_ns.saturating_add(dt_ns);
            return (self.good, self.invalid);
        }
        self.invalid_ns = 0;
        self.repeated_ns = if value == self.good { self.repeated_ns.saturating_add(dt_ns) } else { 0 };
        self.good = value;
        let clipped = value.iter().any(|x| x.abs() >= self.limit);
        (value, self.clipped.when(clipped) | self.stuck.when(self.repeated_ns >= self.stuck_ns))
    }
}
