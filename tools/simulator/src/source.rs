//! Simulated ingest process.

use launch::Service;
use messages::{Checkpoint, Credit, GnssFix, Health, ImuSample, MagSample, State};
use runtime::{Pace, ServiceConfig, service_config::Resume};

use crate::{
    bus::{Bus, SubscriberId},
    flight::Flight,
    slots::PollContext,
};

const HEALTH_MS: u64 = 100;
const NS_PER_MS: u64 = 1_000_000;

/// Running source.
pub(crate) struct Source {
    incarnation: u32,
    epoch: u32,
    next_tick: u64,
    /// Tick at which catching up ends. Earlier ticks were published before a restart and are
    /// repeated without delay.
    catch_up_end_tick: u64,
    end_tick: u64,
    /// Interval between ticks, ms.
    period_ms: f64,
    /// Time in ns at which the first tick was due; 0 before the first tick.
    start_ns: u64,
    credit_ticks: u64,
    half_buffer_ticks: f64,
    checkpoint_ticks: u64,
    next_checkpoint: u64,
    credit_subscriber: SubscriberId,
    health_sent_ms: Option<u64>,
    health: Health,
}

impl Source {
    /// Opens the topics, and resumes at the tick that the configuration specifies.
    pub(crate) fn start(config: &ServiceConfig, bus: &mut Bus) -> Self {
        let incarnation = config.incarnation;
        let (next_tick, start_ns) = match config.resume {
            Some(Resume::Source { next_tick, start_ns, .. }) => (next_tick, start_ns),
            _ => (0, 0),
        };
        let catch_up_end_tick = config.catch_up_end_tick(next_tick, bus.imu.next_tick);
        let credit_subscriber = bus.next_subscriber();
        bus.credit.subscribe(credit_subscriber, incarnation, true);
        bus.imu.add_publisher(incarnation);
        bus.mag.add_publisher(incarnation);
        bus.gnss.add_publisher(incarnation);
        bus.health.add_publisher(incarnation);
        bus.checkpoint.add_publisher(incarnation);
        let speed = if let Pace::Speed(speed) = config.pace { speed } else { 1.0 };
        let health = Health { service: Service::Ingest as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
        Self {
            incarnation,
            epoch: config.epoch,
            next_tick,
            catch_up_end_tick,
            end_tick: config.max_ticks.unwrap_or(u64::MAX),
            period_ms: 1e3 / config.rate_hz / speed,
            start_ns,
            credit_ticks: 0,
            half_buffer_ticks: config.buffer_ticks() as f64 / 2.0,
            checkpoint_ticks: config.checkpoint_ticks(),
            next_checkpoint: 0,
            credit_subscriber,
            health_sent_ms: None,
            health,
        }
    }

    /// Polls the source once. Returns `false` if it is killed.
    pub(crate) fn poll(&mut self, flight: &Flight, context: &mut PollContext<'_>) -> bool {
        while let Some(Credit { ticks, ends }) = context.bus.credit.receive(self.credit_subscriber, context.random) {
            self.credit_ticks = self.credit_ticks.max(ticks);
            if ends != 0 {
                self.end_tick = self.end_tick.min(context.bus.imu.next_tick);
            }
        }
        context.bus.imu.deliver_history(self.incarnation);
        context.bus.mag.deliver_history(self.incarnation);
        context.bus.gnss.deliver_history(self.incarnation);
        while self.next_tick < self.end_tick.min(self.credit_ticks) && self.is_due(context.now_ms) {
            if !self.publish(flight, context) {
                return false;
            }
        }
        self.publish_health(context);
        context.deliveries_left.is_none()
    }

    /// Returns `true` if the next tick is due.
    ///
    /// Repeated ticks are due immediately. After a long stall the schedule is shifted, so that the
    /// backlog is not released at once.
    fn is_due(&mut self, now_ms: u64) -> bool {
        if self.next_tick < self.catch_up_end_tick {
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

    fn publish(&mut self, flight: &Flight, context: &mut PollContext<'_>) -> bool {
        let Some(sample) = flight.samples.get(self.next_tick as usize) else { return true };
        let mut header = sample.imu.header;
        (header.epoch, header.incarnation) = (self.epoch, self.incarnation);
        let (incarnation, deliveries_left) = (self.incarnation, &mut context.deliveries_left);
        // Magnetic field and fix are published before the IMU sample of the tick, so that no
        // subscriber has to wait for them.
        if let Some(mag) = sample.mag
            && !context.bus.mag.publish(incarnation, MagSample { header, ..mag }, deliveries_left)
        {
            return false;
        }
        if let Some(gnss) = sample.gnss
            && !context.bus.gnss.publish(incarnation, GnssFix { header, ..gnss }, deliveries_left)
        {
            return false;
        }
        if !context.bus.imu.publish(incarnation, ImuSample { header, ..sample.imu }, deliveries_left) {
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
        context.bus.checkpoint.send(incarnation, checkpoint, deliveries_left)
    }

    fn publish_health(&mut self, context: &mut PollContext<'_>) {
        let state = match self.next_tick {
            tick if tick >= self.end_tick => State::FINISHED,
            0 => State::READY,
            _ => State::RUNNING,
        };
        let is_due = self.health_sent_ms.is_none_or(|sent_ms| context.now_ms >= sent_ms + HEALTH_MS);
        if state != self.health.state || is_due {
            self.health_sent_ms = Some(context.now_ms);
            (self.health.state, self.health.ticks, self.health.next_tick) = (state, self.next_tick, self.next_tick);
            if !context.random.chance(context.lost_report_per_mille) {
                context.bus.health.send(self.incarnation, self.health, &mut None);
            }
        }
    }
}
