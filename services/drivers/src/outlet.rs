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
    sensor: Publisher<SensorReading>,
    receiver: Publisher<ReceiverReading>,
    clock: Clock,
    fit: ClockFit,
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
    pub(crate) fn open(context: &ServiceContext, stream: &Stream) -> Result<Self, RuntimeError> {
        let sensor = context.publisher::<SensorReading>()?;
        if context.config.resume.is_some() {
            sensor.note_all_taken();
        }
        // Where one of the two processes dies, what was on its way may be counted wrong; for that there is the other half.
        let half = context.config.buffer_ticks() as u64 / 2;
        Ok(Self {
            sensor,
            receiver: context.publisher()?,
            clock: stream.clock,
            fit: ClockFit::new(),
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
            Value::Fix { velocity_m_s, sd_m_s, latitude_rad } => {
                let told = |value: Option<f64>| value.unwrap_or(f64::NAN);
                self.waiting.push_back(Outgoing::Fix(ReceiverReading {
                    velocity_m_s,
                    velocity_sd_m_s: told(sd_m_s),
                    age_s: f64::NAN,
                    latitude_rad: told(latitude_rad),
                    longitude_rad: f64::NAN,
                    altitude_m: f64::NAN,
                }));
            }
        }
    }

    /// Sends what there is room for; whether that is all.
    pub(crate) fn empty(&mut self) -> Result<bool, BusError> {
        let mut room = self.limit.map_or(u64::MAX, |limit| limit.saturating_sub(self.sensor.untaken()));
        let before = self.sent;
        while let Some(outgoing) = self.waiting.front() {
            match outgoing {
                Outgoing::Reading(_) if room == 0 => break,
                Outgoing::Reading(reading) => {
                    // Counted first: ingest may take it at once.
                    self.sensor.note_sent(1);
                    self.sensor.send(reading)?;
                    (room, self.sent) = (room - 1, self.sent + 1);
                }
                Outgoing::Fix(fix) => self.receiver.send(fix)?,
            }
            self.waiting.pop_front();
        }
        if self.sent != before {
            self.sensor.wake();
        }
        Ok(self.waiting.is_empty())
    }

    /// Hands what it holds to an ingest that has come.
    pub(crate) fn deliver_history(&self) -> Result<(), BusError> {
        self.sensor.deliver_history()?;
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
            _ => self.fit.push(stamp, arrival_ns),
        }
    }
}
