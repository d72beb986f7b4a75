//! The process that brings samples in, on the simulated bus.

use launch::Service;
use messages::{Checkpoint, Credit, GnssFix, Health, ImuSample, MagSample, State};
use runtime::{Pace, ServiceConfig, service_config::Resume};

use crate::{
    bus::{Bus, ReaderId},
    flight::Flight,
    slots::Turn,
};

const HEALTH_MS: u64 = 100;
const NS_PER_MS: u64 = 1_000_000;

/// The source at work.
pub(crate) struct Source {
    incarnation: u32,
    epoch: u32,
    next_tick: u64,
    /// What had been published is given again at once, up to this tick.
    again_until: u64,
    ticks: u64,
    /// Milliseconds from one tick to the next.
    period_ms: f64,
    /// When the first tick was due, ns; 0 before.
    start_ns: u64,
    allowed_ticks: u64,
    half_buffer_ticks: f64,
    checkpoint_ticks: u64,
    next_checkpoint: u64,
    credit: ReaderId,
    said_ms: Option<u64>,
    health: Health,
}

impl Source {
    /// It has opened its topics and made again what it had published.
    pub(crate) fn begin(config: &ServiceConfig, bus: &mut Bus) -> Self {
        let incarnation = config.incarnation;
        let (next_tick, start_ns) = match config.resume {
            Some(Resume::Source { next_tick, start_ns, .. }) => (next_tick, start_ns),
            _ => (0, 0),
        };
        let again_until = config.catch_up_end_tick(next_tick, bus.imu.next_tick);
        let credit = bus.next_reader();
        bus.credit.read_as(credit, incarnation, true);
        bus.imu.publish_as(incarnation);
        bus.mag.publish_as(incarnation);
        bus.gnss.publish_as(incarnation);
        bus.health.publish_as(incarnation);
        bus.checkpoint.publish_as(incarnation);
        let speed = if let Pace::Speed(speed) = config.pace { speed } else { 1.0 };
        let health = Health { service: Service::Ingest as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
        Self {
            incarnation,
            epoch: config.epoch,
            next_tick,
            again_until,
            ticks: config.max_ticks.unwrap_or(u64::MAX),
            period_ms: 1e3 / config.rate_hz / speed,
            start_ns,
            allowed_ticks: 0,
            half_buffer_ticks: config.buffer_ticks() as f64 / 2.0,
            checkpoint_ticks: config.checkpoint_ticks(),
            next_checkpoint: 0,
            credit,
            said_ms: None,
            health,
        }
    }

    /// One turn of its loop; whether it lives to its end.
    pub(crate) fn poll(&mut self, flight: &Flight, turn: &mut Turn<'_>) -> bool {
        while let Some(Credit { ticks, ends }) = turn.bus.credit.receive(self.credit, turn.random) {
            self.allowed_ticks = self.allowed_ticks.max(ticks);
            if ends != 0 {
                self.ticks = self.ticks.min(turn.bus.imu.next_tick);
            }
        }
        turn.bus.imu.deliver_history(self.incarnation);
        turn.bus.mag.deliver_history(self.incarnation);
        turn.bus.gnss.deliver_history(self.incarnation);
        while self.next_tick < self.ticks.min(self.allowed_ticks) && self.is_due(turn.now_ms) {
            if !self.publish(flight, turn) {
                return false;
            }
        }
        self.publish_health(turn);
        turn.deliveries.is_none()
    }

    /// What was published before comes at once. What stood still with the machine goes on from where it was.
    fn is_due(&mut self, now_ms: u64) -> bool {
        if self.next_tick < self.again_until {
            return true;
        }
        let now_ns = (now_ms + 1) * NS_PER_MS;
        let after_first_ns = (self.next_tick as f64 * self.period_ms * NS_PER_MS as f64) as u64;
        if self.start_ns == 0 {
            self.start_ns = now_ns.saturating_sub(after_first_ns);
        }
        let due_ns = self.start_ns + after_first_ns;
        let late_ns = now_ns.saturating_sub(due_ns);
        if late_ns as f64 / (NS_PER_MS as f64 * self.period_ms) >= self.half_buffer_ticks {
            self.start_ns += late_ns;
        }
        now_ns >= due_ns
    }

    fn publish(&mut self, flight: &Flight, turn: &mut Turn<'_>) -> bool {
        let Some(sample) = flight.samples.get(self.next_tick as usize) else { return true };
        let mut header = sample.imu.header;
        (header.epoch, header.incarnation) = (self.epoch, self.incarnation);
        let (incarnation, left) = (self.incarnation, &mut turn.deliveries);
        // Before the tick that they go with, so that nobody has to wait for them.
        if let Some(mag) = sample.mag
            && !turn.bus.mag.publish(incarnation, MagSample { header, ..mag }, left)
        {
            return false;
        }
        if let Some(gnss) = sample.gnss
            && !turn.bus.gnss.publish(incarnation, GnssFix { header, ..gnss }, left)
        {
            return false;
        }
        if !turn.bus.imu.publish(incarnation, ImuSample { header, ..sample.imu }, left) {
            return false;
        }
        self.next_tick += 1;
        if self.next_tick < self.next_checkpoint {
            return true;
        }
        self.next_checkpoint = self.next_tick + self.checkpoint_ticks;
        let mut checkpoint = Checkpoint {
            next_tick: self.next_tick,
            service: Service::Ingest as u32,
            incarnation,
            slot_words: 2,
            ..bytemuck::Zeroable::zeroed()
        };
        checkpoint.words[0] = self.start_ns;
        checkpoint.checksum = checkpoint.compute_checksum();
        turn.bus.checkpoint.send(incarnation, checkpoint, left)
    }

    fn publish_health(&mut self, turn: &mut Turn<'_>) {
        let state = match self.next_tick {
            tick if tick >= self.ticks => State::FINISHED,
            0 => State::READY,
            _ => State::RUNNING,
        };
        if state != self.health.state || self.said_ms.is_none_or(|said_ms| turn.now_ms >= said_ms + HEALTH_MS) {
            self.said_ms = Some(turn.now_ms);
            (self.health.state, self.health.ticks, self.health.next_tick) = (state, self.next_tick, self.next_tick);
            if !turn.random.happens(turn.drop_per_mille) {
                turn.bus.health.send(self.incarnation, self.health, &mut None);
            }
        }
    }
}
