//! Publication of measurements to ingest, as readings and fixes with timestamps.

use std::collections::VecDeque;

use bus::{BusError, Publisher};
use control::Diagnostic;
use decoders::{DeviceTime, Measurement, Value};
use driver::{
    Stamp,
    clock_fit::{ClockFit, ClockHealth},
};
use launch::{Clock, DEFAULT_RATE_HZ, Stream};
use mapping::counter::{narrow_period_ns, wrap_ns};
use messages::{ReceiverReading, SensorReading};
use runtime::{RuntimeError, ServiceContext};

/// Publisher of readings and fixes, with a queue of those that ingest has no room for yet.
pub(crate) struct ReadingPublisher {
    /// Publisher of readings; `None` if another program publishes them.
    sensor: Option<Publisher<SensorReading>>,
    receiver: Publisher<ReceiverReading>,
    clock: Clock,
    fit: ClockFit,
    /// Clock of the device, if its timestamps are used unchanged.
    device_clock: DeviceClock,
    interval_s: f64,
    /// `false` if `interval_s` is that of the default rate.
    has_declared_rate: bool,
    /// Number of readings without a device timestamp.
    unstamped_count: u64,
    /// Magnetic field that arrived separately and will be combined with the next reading.
    field_ut: Option<[f64; 3]>,
    queue: VecDeque<Outgoing>,
    /// Maximum number of readings that are sent but not yet consumed by ingest; `None` if the
    /// source is not paced by ingest.
    max_in_flight: Option<u64>,
    sent: u64,
}

/// Clock of a device with a counter that wraps.
#[derive(Debug, Default)]
struct DeviceClock {
    last_ns: Option<i64>,
    offset_ns: i64,
    /// Step between the last two readings that went forward, ns.
    interval_ns: i64,
    /// Period of a narrow counter, found by the step across its wrap.
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

enum Outgoing {
    Reading(SensorReading),
    Fix(ReceiverReading),
}

impl ReadingPublisher {
    /// Opens the publisher. `stream` describes the source, or is `None` if the service reads only a
    /// receiver.
    pub(crate) fn open(context: &ServiceContext, stream: Option<&Stream>) -> Result<Self, RuntimeError> {
        let sensor = stream.map(|_| context.publisher::<SensorReading>()).transpose()?;
        if let Some(sensor) = sensor.as_ref().filter(|_| context.config.resume.is_some()) {
            sensor.mark_all_consumed();
        }
        // Only half of the buffer is used. The number of readings in flight may be miscounted if
        // either process dies, and the other half of the buffer absorbs the error.
        let half_buffer = context.config.buffer_ticks() as u64 / 2;
        Ok(Self {
            sensor,
            receiver: context.publisher()?,
            clock: stream.map_or(Clock::Host, |stream| stream.clock),
            fit: stream.and_then(|stream| stream.rate_hz).map_or_else(ClockFit::new, ClockFit::with_rate),
            device_clock: DeviceClock::default(),
            interval_s: 1.0 / stream.and_then(|stream| stream.rate_hz).unwrap_or(DEFAULT_RATE_HZ),
            has_declared_rate: stream.is_none_or(|stream| stream.rate_hz.is_some()),
            unstamped_count: 0,
            field_ut: None,
            queue: VecDeque::new(),
            max_in_flight: context.config.is_lockstep().then_some(half_buffer.max(1)),
            sent: 0,
        })
    }

    /// Returns the number of readings sent.
    pub(crate) fn sent(&self) -> u64 {
        self.sent
    }

    /// Returns the state of the device's clock. It stays at its initial value unless the clock is
    /// fitted.
    pub(crate) fn clock_health(&self) -> ClockHealth {
        self.fit.health()
    }

    /// Returns a problem if readings without times are spaced by the default rate, because none is
    /// declared.
    pub(crate) fn rate_problem(&self) -> Option<Diagnostic> {
        (!self.has_declared_rate && self.unstamped_count > 0).then(|| Diagnostic {
            kind: "assumed-rate".into(),
            found: format!("the readings have no times; {DEFAULT_RATE_HZ:.0} Hz is assumed").into(),
            remedy: "set rate_hz to the rate of the sensor, or send a time in the column t".into(),
        })
    }

    /// Queues a measurement that arrived at `arrival_ns` on CLOCK_MONOTONIC.
    pub(crate) fn push(&mut self, measurement: &Measurement, arrival_ns: i64) {
        match measurement.value {
            Value::Imu { rate_rad_s, force_m_s2, field_ut } => {
                let t_sensor_ns = self.sensor_time_ns(measurement.time, arrival_ns);
                let field_ut = field_ut.or(self.field_ut.take()).unwrap_or([f64::NAN; 3]);
                self.queue.push_back(Outgoing::Reading(SensorReading {
                    t_sensor_ns,
                    rate_rad_s,
                    force_m_s2,
                    field_ut,
                }));
            }
            Value::Field(field_ut) => self.field_ut = Some(field_ut),
            Value::Fix { velocity_m_s, sd_m_s, position } => {
                let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
                self.queue.push_back(Outgoing::Fix(ReceiverReading {
                    velocity_m_s,
                    velocity_sd_m_s: or_nan(sd_m_s),
                    age_s: f64::NAN,
                    latitude_rad: or_nan(position.latitude_rad),
                    longitude_rad: or_nan(position.longitude_rad),
                    altitude_m: or_nan(position.altitude_m),
                }));
            }
        }
    }

    /// Sends as many queued messages as ingest has room for. Returns `true` if the queue is empty.
    pub(crate) fn flush(&mut self) -> Result<bool, BusError> {
        let unconsumed = self.sensor.as_ref().map_or(0, Publisher::unconsumed);
        let mut room = self.max_in_flight.map_or(u64::MAX, |max_in_flight| max_in_flight.saturating_sub(unconsumed));
        let previously_sent = self.sent;
        while let Some(outgoing) = self.queue.front() {
            match outgoing {
                Outgoing::Reading(_) if room == 0 => break,
                Outgoing::Reading(reading) => {
                    if let Some(sensor) = &self.sensor {
                        // The reading is counted after it is sent, so that ingest finds every
                        // counted reading in the topic unless it was overwritten.
                        sensor.send(reading)?;
                        sensor.add_sent(1);
                    }
                    (room, self.sent) = (room - 1, self.sent + 1);
                }
                Outgoing::Fix(fix) => self.receiver.send(fix)?,
            }
            self.queue.pop_front();
        }
        if self.sent != previously_sent {
            self.sensor.iter().for_each(Publisher::wake);
        }
        Ok(self.queue.is_empty())
    }

    /// Delivers the publishers' history to a newly joined ingest.
    pub(crate) fn deliver_history(&self) -> Result<(), BusError> {
        self.sensor.iter().try_for_each(Publisher::deliver_history)?;
        self.receiver.deliver_history()
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
            // If there is no timestamp, the time is derived from the reading number.
            (Clock::Device, None) => {
                self.unstamped_count += 1;
                (self.unstamped_count as f64 * self.interval_s * 1e9) as i64
            }
            (Clock::Host, stamp) => self.fit.push(stamp, arrival_ns),
        }
    }

    /// Restarts the clock fit, because measurements may be missing.
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
