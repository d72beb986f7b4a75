//! Conversion of measurements to readings and fixes with timestamps.

use control::Diagnostic;
use decoders::{DeviceTime, Measurement, Value};
use driver::{
    Stamp,
    clock_fit::{ClockFit, ClockHealth},
};
use launch::{Clock, DEFAULT_RATE_HZ, Stream};
use mapping::counter::{narrow_period_ns, wrap_ns};
use messages::{ReceiverReading, SensorReading};

/// Converted measurement.
#[derive(Debug, Clone, Copy)]
pub enum DeviceReading {
    /// Reading of the sensors.
    Sensor(SensorReading),
    /// Fix of a receiver.
    Fix(ReceiverReading),
}

/// Converter of the measurements of one source.
pub(crate) struct ReadingConverter {
    clock: Clock,
    fit: ClockFit,
    /// Clock of the device, if its timestamps are used unchanged.
    device_clock: DeviceClock,
    interval_s: f64,
    /// `false` if no rate is declared, so that `interval_s` is the interval of the default rate.
    has_declared_rate: bool,
    /// Number of readings without a device timestamp.
    unstamped_count: u64,
    /// Magnetic field that arrived separately and will be combined with the next reading.
    field_ut: Option<[f64; 3]>,
}

/// Clock of a device with a counter that wraps.
#[derive(Debug, Default)]
struct DeviceClock {
    last_ns: Option<i64>,
    offset_ns: i64,
    /// Most recent forward step between two consecutive timestamps, ns.
    interval_ns: i64,
    /// Period of a counter that wraps early, ns. Determined from the step at which it wraps; `None`
    /// until then.
    narrow_period_ns: Option<i64>,
}

impl DeviceClock {
    /// Returns the timestamp, continued across wraps of the counter.
    fn unwrapped_ns(&mut self, stamp: Stamp) -> i64 {
        let period_ns = stamp.period_ns.and_then(|period_ns| i64::try_from(period_ns).ok());
        let count_ns = stamp.count_ns.cast_signed();
        if let (None, None, Some(last_ns)) = (period_ns, self.narrow_period_ns, self.last_ns) {
            self.narrow_period_ns = narrow_period_ns(self.interval_ns, last_ns, count_ns);
            self.interval_ns = if count_ns > last_ns { count_ns.saturating_sub(last_ns) } else { self.interval_ns };
        }
        let period_ns = period_ns.or(self.narrow_period_ns);
        let wrapped_ns = self.last_ns.and_then(|last_ns| wrap_ns(period_ns, last_ns, count_ns));
        self.offset_ns = self.offset_ns.saturating_add(wrapped_ns.unwrap_or(0));
        self.last_ns = Some(count_ns);
        count_ns.saturating_add(self.offset_ns)
    }
}

impl ReadingConverter {
    /// Creates a converter. `stream` describes the source, or is `None` if only a receiver is read.
    pub(crate) fn new(stream: Option<&Stream>) -> Self {
        Self {
            clock: stream.map_or(Clock::Host, |stream| stream.clock),
            fit: stream.and_then(|stream| stream.rate_hz).map_or_else(ClockFit::new, ClockFit::with_rate),
            device_clock: DeviceClock::default(),
            interval_s: 1.0 / stream.and_then(|stream| stream.rate_hz).unwrap_or(DEFAULT_RATE_HZ),
            has_declared_rate: stream.is_none_or(|stream| stream.rate_hz.is_some()),
            unstamped_count: 0,
            field_ut: None,
        }
    }

    /// Returns the state of the device's clock. It stays at its initial value unless the clock is
    /// fitted.
    pub(crate) fn clock_health(&self) -> ClockHealth {
        self.fit.health()
    }

    /// Returns a problem if readings have no timestamps and no rate is declared. They are then
    /// spaced at the default rate.
    pub(crate) fn rate_problem(&self) -> Option<Diagnostic> {
        (!self.has_declared_rate && self.unstamped_count > 0).then(|| Diagnostic {
            kind: "assumed-rate".into(),
            found: format!("the readings have no times; {DEFAULT_RATE_HZ:.0} Hz is assumed").into(),
            remedy: "set rate_hz to the rate of the sensor, or send a time in the column t".into(),
        })
    }

    /// Converts a measurement that arrived at `arrival_ns` on CLOCK_MONOTONIC. Returns `None` for a
    /// magnetic field, which becomes part of the next reading.
    pub(crate) fn convert(&mut self, measurement: &Measurement, arrival_ns: i64) -> Option<DeviceReading> {
        match measurement.value {
            Value::Imu { rate_rad_s, force_m_s2, field_ut } => {
                let t_sensor_ns = self.sensor_time_ns(measurement.time, arrival_ns);
                let field_ut = field_ut.or(self.field_ut.take()).unwrap_or([f64::NAN; 3]);
                Some(DeviceReading::Sensor(SensorReading { t_sensor_ns, rate_rad_s, force_m_s2, field_ut }))
            }
            Value::Field(field_ut) => {
                self.field_ut = Some(field_ut);
                None
            }
            Value::Fix { velocity_m_s, sd_m_s, position } => {
                let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
                Some(DeviceReading::Fix(ReceiverReading {
                    velocity_m_s,
                    velocity_sd_m_s: or_nan(sd_m_s),
                    age_s: f64::NAN,
                    latitude_rad: or_nan(position.latitude_rad),
                    longitude_rad: or_nan(position.longitude_rad),
                    altitude_m: or_nan(position.altitude_m),
                }))
            }
        }
    }

    fn sensor_time_ns(&mut self, time: Option<DeviceTime>, arrival_ns: i64) -> i64 {
        let stamp = time.map(|time| match time {
            DeviceTime::Counter { now_ns, period_ns } => Stamp { count_ns: now_ns, period_ns: Some(period_ns) },
            DeviceTime::SinceBoot { now_ns } | DeviceTime::Unix { now_ns } => {
                Stamp { count_ns: now_ns, period_ns: None }
            }
        });
        match (self.clock, stamp) {
            (Clock::Device, Some(stamp)) => self.device_clock.unwrapped_ns(stamp),
            // If there is no timestamp, the time is derived from the number of readings so far.
            (Clock::Device, None) => {
                self.unstamped_count += 1;
                (self.unstamped_count as f64 * self.interval_s * 1e9) as i64
            }
            (Clock::Host, stamp) => self.fit.push(stamp, arrival_ns),
        }
    }

    /// Restarts the clock fit after a gap in the measurements.
    pub(crate) fn mark_gap(&mut self) {
        self.fit.mark_gap();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_counter_continues_across_wraps() {
        let mut clock = DeviceClock::default();
        let mut at = |count_ns, period_ns| clock.unwrapped_ns(Stamp { count_ns, period_ns });
        assert_eq!([at(900, Some(1000)), at(100, Some(1000)), at(300, Some(1000))], [900, 1100, 1300]);
        let mut clock = DeviceClock::default();
        let period_ns = (1 << 32) * 1000;
        let mut at = |count_ns| clock.unwrapped_ns(Stamp { count_ns, period_ns: None });
        assert_eq!([at(period_ns - 10), at(10)], [period_ns as i64 - 10, period_ns as i64 + 10]);
        assert_eq!(at(5), period_ns as i64 + 5, "a step back stays one");
    }
}
