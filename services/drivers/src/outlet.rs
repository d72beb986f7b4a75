//! Measurements as readings and fixes, with their times, to ingest.

use std::collections::VecDeque;

use bus::{BusError, Publisher};
use decoders::{DeviceTime, Measurement, Value};
use driver::{
    Stamp,
    clock_fit::{ClockFit, ClockHealth},
};
use launch::{Clock, Stream};
use messages::{ReceiverReading, SensorReading};
use runtime::{RuntimeError, ServiceContext};

/// What ingest has not taken yet, and what is to be sent after it.
pub(crate) struct Outlet {
    /// None where the readings are another's.
    sensor: Option<Publisher<SensorReading>>,
    receiver: Publisher<ReceiverReading>,
    clock: Clock,
    fit: ClockFit,
    interval_s: f64,
    /// Readings to which the device gave no time.
    unstamped: u64,
    /// Of a magnetometer that speaks for itself; it goes with the next reading.
    field_ut: Option<[f64; 3]>,
    waiting: VecDeque<Outgoing>,
    /// Readings that may be on their way at once; none where the source does not wait.
    limit: Option<u64>,
    sent: u64,
}

enum Outgoing {
    Reading(SensorReading),
    Fix(ReceiverReading),
}

impl Outlet {
    /// `stream`: what the source brings; none where it is not read here, but a receiver beside it.
    pub(crate) fn open(context: &ServiceContext, stream: Option<&Stream>) -> Result<Self, RuntimeError> {
        let sensor = stream.map(|_| context.publisher::<SensorReading>()).transpose()?;
        if let Some(sensor) = sensor.as_ref().filter(|_| context.config.resume.is_some()) {
            sensor.note_all_taken();
        }
        // Where one of the two processes dies, what was on its way may be counted wrong; for that there is the other half.
        let half = context.config.buffer_ticks() as u64 / 2;
        Ok(Self {
            sensor,
            receiver: context.publisher()?,
            clock: stream.map_or(Clock::Host, |stream| stream.clock),
            fit: stream.map_or_else(ClockFit::new, |stream| ClockFit::with_rate(stream.rate_hz)),
            interval_s: stream.map_or(0.0, |stream| 1.0 / stream.rate_hz),
            unstamped: 0,
            field_ut: None,
            waiting: VecDeque::new(),
            limit: context.config.lockstep().then_some(half.max(1)),
            sent: 0,
        })
    }

    /// Readings sent.
    pub(crate) fn sent(&self) -> u64 {
        self.sent
    }

    /// What is known of the device's clock, where it is fitted.
    pub(crate) fn clock_health(&self) -> ClockHealth {
        self.fit.health()
    }

    /// Takes a measurement that arrived at this time of CLOCK_MONOTONIC, ns.
    pub(crate) fn add(&mut self, measurement: &Measurement, arrival_ns: i64) {
        match measurement.value {
            Value::Imu { rate_rad_s, force_m_s2, field_ut } => {
                let t_sensor_ns = self.time_ns(measurement.time, arrival_ns);
                let field_ut = field_ut.or(self.field_ut.take()).unwrap_or([f64::NAN; 3]);
                self.waiting.push_back(Outgoing::Reading(SensorReading {
                    t_sensor_ns,
                    rate_rad_s,
                    force_m_s2,
                    field_ut,
                }));
            }
            Value::Field(field_ut) => self.field_ut = Some(field_ut),
            Value::Fix { velocity_m_s, sd_m_s, place } => {
                let told = |value: Option<f64>| value.unwrap_or(f64::NAN);
                self.waiting.push_back(Outgoing::Fix(ReceiverReading {
                    velocity_m_s,
                    velocity_sd_m_s: told(sd_m_s),
                    age_s: f64::NAN,
                    latitude_rad: told(place.latitude_rad),
                    longitude_rad: told(place.longitude_rad),
                    altitude_m: told(place.altitude_m),
                }));
            }
        }
    }

    /// Sends what there is room for; whether that is all.
    pub(crate) fn empty(&mut self) -> Result<bool, BusError> {
        let untaken = self.sensor.as_ref().map_or(0, Publisher::untaken);
        let mut room = self.limit.map_or(u64::MAX, |limit| limit.saturating_sub(untaken));
        let before = self.sent;
        while let Some(outgoing) = self.waiting.front() {
            match outgoing {
                Outgoing::Reading(_) if room == 0 => break,
                Outgoing::Reading(reading) => {
                    if let Some(sensor) = &self.sensor {
                        // Counted first: ingest may take it at once.
                        sensor.note_sent(1);
                        sensor.send(reading)?;
                    }
                    (room, self.sent) = (room - 1, self.sent + 1);
                }
                Outgoing::Fix(fix) => self.receiver.send(fix)?,
            }
            self.waiting.pop_front();
        }
        if self.sent != before {
            self.sensor.iter().for_each(Publisher::wake);
        }
        Ok(self.waiting.is_empty())
    }

    /// Hands what it holds to an ingest that has come.
    pub(crate) fn deliver_history(&self) -> Result<(), BusError> {
        self.sensor.iter().try_for_each(Publisher::deliver_history)?;
        self.receiver.deliver_history()
    }

    fn time_ns(&mut self, time: Option<DeviceTime>, arrival_ns: i64) -> i64 {
        let stamp = time.map(|time| match time {
            DeviceTime::Counter { now_ns, period_ns } => Stamp { count_ns: now_ns, period_ns: Some(period_ns) },
            DeviceTime::SinceBoot { now_ns } | DeviceTime::Unix { now_ns } => {
                Stamp { count_ns: now_ns, period_ns: None }
            }
        });
        match (self.clock, stamp) {
            (Clock::Device, Some(stamp)) => stamp.count_ns.cast_signed(),
            // What has no time of its own has that of its number.
            (Clock::Device, None) => {
                self.unstamped += 1;
                (self.unstamped as f64 * self.interval_s * 1e9) as i64
            }
            (Clock::Host, stamp) => self.fit.push(stamp, arrival_ns),
        }
    }

    /// The device was away, and something may be missing.
    pub(crate) fn interrupt(&mut self) {
        self.fit.interrupt();
    }
}
