//! The service `ingest`: from a source to `imu`, checked and numbered.
//!
//! Input: a simulation, a recording, or readings from the bus. Output: one [`ImuSample`] per tick, and the true attitude where it is
//! known. Time: readings are published when they are due; in lockstep not before the readers have room. Failure: see [`mod@conditioner`].
#![forbid(unsafe_code)]

mod channel;
pub mod conditioner;
mod feed;
pub mod retaken;
mod script;
pub mod source;
mod taken;

use std::time::Duration;

use bus::{BusError, Publisher, Subscriber};
use launch::Service;
use messages::{
    Checkpoint, Credit, Flags, GnssFix, Health, ImuSample, MagSample, Message, Reference, SensorReading, State,
};
use runtime::{
    Pace, RuntimeError, ServiceConfig, ServiceContext,
    clock::{monotonic_ns, sleep_until_ns},
    service_config::{CONTROL_BUFFER, Resume},
};

use conditioner::{Conditioner, Sample};
use feed::Feed;
use source::{Reading, Readings, SourceError, Truth};
use taken::TakenReadings;

/// Samples sent at most before the readers are woken.
const BATCH: usize = 64;
/// Longest sleep before the service looks whether it is to end.
const SLEEP_LIMIT: Duration = Duration::from_millis(50);

/// Why ingest ended.
#[derive(Debug, thiserror::Error)]
pub enum IngestError {
    /// The loop or the bus failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The source failed.
    #[error(transparent)]
    Source(#[from] SourceError),
}

impl From<BusError> for IngestError {
    fn from(cause: BusError) -> Self {
        Self::Runtime(cause.into())
    }
}

/// The conditioner for the source that `config` names.
pub fn conditioner(config: &ServiceConfig) -> Result<Conditioner, SourceError> {
    Ok(Conditioner::new(&config.launch.ingest, config.rate_hz, config.gyro_samples())?)
}

/// The service.
pub fn run() -> Result<(), IngestError> {
    let mut ingest = Ingest::join()?;
    match ingest.context.config.launch.ingest.source {
        source if source.is_repeatable() => ingest.pace()?,
        _ => ingest.relay()?,
    }
    ingest.finish()
}

struct Ingest {
    context: ServiceContext,
    conditioner: Conditioner,
    imu: Publisher<ImuSample>,
    mag: Publisher<MagSample>,
    gnss: Publisher<GnssFix>,
    reference: Publisher<Reference>,
    /// Where somebody wants to replay the flight.
    taken: Option<TakenReadings>,
    checkpoints: Publisher<Checkpoint>,
    credit: Subscriber<Credit>,
    /// Ticks before this one were published by an earlier incarnation,
    first_tick: u64,
    /// and are made again up to this one: readers may lack them, so they come at once, as far as a topic holds them.
    again_until: u64,
    /// When the first tick was due, CLOCK_MONOTONIC, ns; 0 before.
    start_ns: u64,
    next_checkpoint: u64,
    allowed_ticks: u64,
    /// The system is to end: ticks from this one on are not published.
    end_tick: Option<u64>,
    published_ticks: u64,
    flags: Flags,
}

impl Ingest {
    fn join() -> Result<Self, IngestError> {
        let context = ServiceContext::join(Service::Ingest)?;
        runtime::clock::minimise_timer_slack();
        let mut conditioner = conditioner(&context.config)?;
        let (mut first_tick, mut again_until, mut start_ns) = (0, 0, 0);
        if let Some(Resume::Source { next_tick, start_ns: since_ns, offset_ns }) = context.config.resume {
            (first_tick, start_ns) = (next_tick, since_ns);
            again_until = context.config.catch_up_end_tick(first_tick, context.bus.next_tick(ImuSample::TOPIC));
            if !context.config.launch.ingest.source.is_repeatable() {
                first_tick = context.bus.next_tick(ImuSample::TOPIC);
                conditioner.continue_at(first_tick, offset_ns);
            }
        }
        Ok(Self {
            conditioner,
            taken: match context.config.publishes_readings {
                true => Some(TakenReadings::new(context.publisher()?, &context.config, first_tick)),
                false => None,
            },
            checkpoints: context.bus.publisher(CONTROL_BUFFER)?,
            first_tick,
            again_until,
            start_ns,
            next_checkpoint: 0,
            imu: context.publisher()?,
            mag: context.publisher()?,
            gnss: context.publisher()?,
            reference: context.bus.publisher(context.config.buffer_ticks())?,
            credit: context.bus.late_subscriber(CONTROL_BUFFER)?,
            context,
            allowed_ticks: 0,
            end_tick: None,
            published_ticks: first_tick,
            flags: Flags::NONE,
        })
    }

    /// Publishes the readings of a simulation or a recording when they are due.
    fn pace(&mut self) -> Result<(), IngestError> {
        let mut readings = Readings::open(&self.context.config.launch)?;
        self.publish_health(State::READY)?;
        self.context.bus.wake_all();
        let mut next = self.read(&mut readings)?;
        let Some(first_ns) = next.as_ref().map(|sample| sample.imu.header.t_end_ns) else { return Ok(()) };
        // What an earlier incarnation has published is made again, for the sake of what comes after it.
        while let (false, Some(_)) =
            (self.context.should_stop(), next.take_if(|sample| sample.imu.header.tick < self.first_tick))
        {
            next = self.read(&mut readings)?;
            self.publish_health(State::READY)?;
        }
        while let (false, Some(sample)) = (self.context.should_stop(), &next) {
            self.drain_credit()?;
            self.deliver_history()?;
            if self.end_tick.is_some_and(|end_tick| sample.imu.header.tick >= end_tick) {
                break;
            }
            if sample.imu.header.tick >= self.allowed_ticks {
                self.publish_health(if self.published_ticks > 0 { State::RUNNING } else { State::READY })?;
                self.context.wait::<Credit>(&self.credit);
                continue;
            }
            let t_end_ns = sample.imu.header.t_end_ns;
            let now_ns = monotonic_ns();
            let due_ns = match self.context.config.pace {
                Pace::Max => 0,
                Pace::Speed(_) if sample.imu.header.tick < self.again_until => 0,
                Pace::Speed(speed) => self.due_ns(t_end_ns - first_ns, speed, now_ns),
            };
            if now_ns < due_ns {
                sleep_until_ns(due_ns, SLEEP_LIMIT);
                self.publish_health(State::RUNNING)?;
                continue;
            }
            let batch = if self.context.config.pace == Pace::Max { BATCH } else { 1 };
            for _ in 0..batch {
                let Some(sample) = next.take_if(|sample| sample.imu.header.tick < self.allowed_ticks) else {
                    break;
                };
                self.publish(sample)?;
                if batch == 1 {
                    // Before the next reading is made: that one is due later.
                    self.imu.wake();
                }
                next = self.read(&mut readings)?;
            }
            if batch > 1 {
                self.imu.wake();
            }
            self.publish_health(State::RUNNING)?;
        }
        Ok(())
    }

    /// When a reading is due that was taken so long after the first. What stood still with the machine goes on from where it was: the
    /// readings of that time would come at once, more of them than a reader that has just been replaced can be given.
    fn due_ns(&mut self, after_first_ns: i64, speed: f64, now_ns: u64) -> u64 {
        let ServiceConfig { rate_hz, .. } = self.context.config;
        let after_first_ns = (after_first_ns as f64 / speed) as u64;
        if self.start_ns == 0 {
            self.start_ns = now_ns.saturating_sub(after_first_ns);
        }
        let due_ns = self.start_ns + after_first_ns;
        let late_ns = now_ns.saturating_sub(due_ns);
        let late_ticks = late_ns as f64 * 1e-9 * speed * rate_hz;
        if late_ticks < self.context.config.buffer_ticks() as f64 / 2.0 {
            return due_ns;
        }
        self.start_ns += late_ns;
        now_ns
    }

    /// Publishes the readings of the topic `sensor` as they come; of the drivers until they are at the end of what they read.
    fn relay(&mut self) -> Result<(), IngestError> {
        let mut feed = Feed::open(&self.context)?;
        self.publish_health(State::READY)?;
        while !self.context.should_stop() {
            self.drain_credit()?;
            self.deliver_history()?;
            if self.end_tick.is_some() || self.published_ticks >= self.ticks_max() {
                break;
            }
            self.publish_health(if self.published_ticks > 0 { State::RUNNING } else { State::READY })?;
            if self.published_ticks >= self.allowed_ticks {
                self.context.wait::<Credit>(&self.credit);
                continue;
            }
            let has_ended = feed.has_ended()?;
            let room = self.allowed_ticks.min(self.ticks_max()) - self.published_ticks;
            let (mut published, mut taken) = (Ok(()), 0);
            feed.drain(room.min(BATCH as u64) as usize, |reading| {
                taken += 1;
                if published.is_ok() {
                    published = self.take(&reading).and_then(|sample| match sample {
                        Some(sample) => self.publish(sample),
                        None => Ok(()),
                    });
                }
            })?;
            published?;
            self.imu.wake();
            if has_ended && taken == 0 {
                break;
            }
            self.context.wait::<SensorReading>(&feed.sensor);
        }
        Ok(())
    }

    /// The source is at its end, unless the service was asked to end before; it stays until the last reader has what it sent.
    fn finish(&mut self) -> Result<(), IngestError> {
        while !self.context.should_stop() {
            self.deliver_history()?;
            self.publish_health(State::FINISHED)?;
            self.context.wait::<Credit>(&self.credit);
        }
        let counts = self.counts();
        Ok(self.context.publish_final_health(counts)?)
    }

    /// The next reading that can be placed, as a sample.
    fn read(&mut self, readings: &mut Readings) -> Result<Option<Sample>, IngestError> {
        if self.conditioner.ticks() >= self.ticks_max() {
            return Ok(None);
        }
        for reading in readings {
            let reading: Reading = reading?;
            if let Some(sample) = self.take(&reading)? {
                return Ok(Some(sample));
            }
        }
        Ok(None)
    }

    /// The sample of a reading, if it can be placed.
    fn take(&mut self, reading: &Reading) -> Result<Option<Sample>, IngestError> {
        let Self { taken, conditioner, .. } = self;
        if let Some(taken) = taken {
            taken.publish(reading, conditioner)?;
        }
        Ok(conditioner.condition(reading))
    }

    fn publish(&mut self, sample: Sample) -> Result<(), IngestError> {
        let Sample { mut imu, mag, gnss, reference } = sample;
        if let Some(Truth { quaternion, scored }) = reference {
            let tick = imu.header.tick;
            self.reference.send(&Reference { tick, scored: scored.into(), quaternion })?;
        }
        self.flags |= imu.header.flags;
        self.context.stamp(&mut imu.header);
        imu.header.t_born_ns = imu.header.t_sent_ns;
        // Before the tick that they go with, so that nobody has to wait for them.
        if let Some(mag) = mag {
            self.mag.send(&MagSample { header: imu.header, ..mag })?;
            self.mag.wake();
        }
        if let Some(gnss) = gnss {
            self.gnss.send(&GnssFix { header: imu.header, ..gnss })?;
            self.gnss.wake();
        }
        self.imu.set_next_tick_after(imu.header.tick);
        self.imu.send(&imu)?;
        self.published_ticks += 1;
        self.publish_checkpoint()
    }

    /// Tells from time to time what another incarnation needs to go on.
    fn publish_checkpoint(&mut self) -> Result<(), IngestError> {
        if self.published_ticks < self.next_checkpoint {
            return Ok(());
        }
        self.next_checkpoint = self.published_ticks + self.context.config.checkpoint_ticks();
        let mut checkpoint = Checkpoint {
            next_tick: self.published_ticks,
            service: Service::Ingest as u32,
            incarnation: self.context.config.incarnation,
            slot_words: 2,
            ..bytemuck::Zeroable::zeroed()
        };
        checkpoint.words[..2].copy_from_slice(&[self.start_ns, self.conditioner.offset_ns().cast_unsigned()]);
        checkpoint.checksum = checkpoint.compute_checksum();
        Ok(self.checkpoints.send(&checkpoint)?)
    }

    /// Hands what the topics hold to readers that have come.
    fn deliver_history(&self) -> Result<(), IngestError> {
        self.imu.deliver_history()?;
        self.mag.deliver_history()?;
        Ok(self.gnss.deliver_history()?)
    }

    fn drain_credit(&mut self) -> Result<(), IngestError> {
        let Self { credit, allowed_ticks, end_tick, imu, .. } = self;
        Ok(credit.drain(CONTROL_BUFFER, |credit| {
            *allowed_ticks = credit.ticks.max(*allowed_ticks);
            // What an earlier incarnation has published is made again.
            *end_tick = end_tick.or((credit.ends != 0).then(|| imu.next_tick()));
        })?)
    }

    fn publish_health(&mut self, state: State) -> Result<(), IngestError> {
        let counts = self.counts();
        Ok(self.context.publish_health(state, counts)?)
    }

    /// How far it is.
    fn counts(&self) -> impl FnOnce(&mut Health) + use<> {
        let (ticks, refused, flags) = (self.published_ticks, self.conditioner.refused(), self.flags);
        move |health| (health.ticks, health.next_tick, health.refused, health.flags) = (ticks, ticks, refused, flags)
    }

    fn ticks_max(&self) -> u64 {
        self.context.config.max_ticks.unwrap_or(u64::MAX)
    }
}
