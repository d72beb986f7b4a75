//! The service `ingest`: from a source to `imu`, checked and numbered.
//!
//! Input: a simulation, a recording, or readings from the bus. Output: one [`ImuSample`] per tick, and the true attitude where it is
//! known. Time: readings are published when they are due; in lockstep not before the readers have room. Failure: see [`mod@conditioner`].
#![forbid(unsafe_code)]

mod channel;
pub mod conditioner;
mod script;
pub mod source;

use std::time::Duration;

use bus::{BusError, Publisher, Subscriber};
use launch::{Service, Source};
use messages::{
    Checkpoint, Credit, Flags, GnssFix, Health, ImuSample, MagSample, ReceiverReading, Reference, SensorReading, State,
};
use runtime::{
    Member, Orders, Pace, RuntimeError,
    clock::{monotonic_ns, sleep_until_ns},
    orders::{BUFFER_BESIDE, Resume},
};

use conditioner::{Conditioner, Sample};
use source::{Reading, Readings, SourceError, Truth, fix_of};

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

/// The conditioner for the source that `orders` name.
pub fn conditioner(orders: &Orders) -> Result<Conditioner, SourceError> {
    Ok(Conditioner::new(&orders.launch.ingest, orders.rate_hz, orders.gyro_samples())?)
}

/// The service.
pub fn run() -> Result<(), IngestError> {
    let mut ingest = Ingest::join()?;
    match ingest.member.orders.launch.ingest.source {
        Source::Bus => ingest.relay()?,
        Source::Sim | Source::Replay => ingest.pace()?,
    }
    ingest.finish()
}

struct Ingest {
    member: Member,
    conditioner: Conditioner,
    imu: Publisher<ImuSample>,
    mag: Publisher<MagSample>,
    gnss: Publisher<GnssFix>,
    reference: Publisher<Reference>,
    checkpoints: Publisher<Checkpoint>,
    credit: Subscriber<Credit>,
    /// Ticks before this one were published by an earlier life.
    first_tick: u64,
    /// When the first tick was due, CLOCK_MONOTONIC, ns; 0 before.
    start_ns: u64,
    next_checkpoint: u64,
    allowed_ticks: u64,
    published_ticks: u64,
    flags: Flags,
}

impl Ingest {
    fn join() -> Result<Self, IngestError> {
        let member = Member::join(Service::Ingest)?;
        runtime::clock::wake_on_time();
        let mut conditioner = conditioner(&member.orders)?;
        let (mut first_tick, mut start_ns) = (0, 0);
        if let Some(Resume::Source { next_tick, start_ns: since_ns, offset_ns }) = member.orders.resume {
            (first_tick, start_ns) = (next_tick, since_ns);
            if member.orders.launch.ingest.source == Source::Bus {
                first_tick = member.bus.next_tick::<ImuSample>();
                conditioner.continue_at(first_tick, offset_ns);
            }
        }
        Ok(Self {
            conditioner,
            checkpoints: member.bus.publisher(BUFFER_BESIDE)?,
            first_tick,
            start_ns,
            next_checkpoint: 0,
            imu: member.publisher()?,
            mag: member.publisher()?,
            gnss: member.publisher()?,
            reference: member.bus.publisher(member.orders.buffer_ticks())?,
            credit: member.bus.late_subscriber(BUFFER_BESIDE)?,
            member,
            allowed_ticks: 0,
            published_ticks: first_tick,
            flags: Flags::NONE,
        })
    }

    /// Publishes the readings of a simulation or a recording when they are due.
    fn pace(&mut self) -> Result<(), IngestError> {
        let mut readings = Readings::open(&self.member.orders.launch)?;
        self.say(State::READY)?;
        self.member.bus.wake_all();
        let mut next = self.read(&mut readings)?;
        let Some(first_ns) = next.as_ref().map(|(sample, _)| sample.imu.header.t_end_ns) else { return Ok(()) };
        // What an earlier life has published is made again, for the sake of what comes after it.
        while let (false, Some(_)) =
            (self.member.ends(), next.take_if(|(sample, _)| sample.imu.header.tick < self.first_tick))
        {
            next = self.read(&mut readings)?;
            self.say(State::READY)?;
        }
        while let (false, Some((sample, _))) = (self.member.ends(), &next) {
            self.drain_credit()?;
            self.greet()?;
            if sample.imu.header.tick >= self.allowed_ticks {
                self.say(if self.published_ticks > 0 { State::RUNNING } else { State::READY })?;
                self.member.wait::<Credit>(&self.credit);
                continue;
            }
            let t_end_ns = sample.imu.header.t_end_ns;
            let now_ns = monotonic_ns();
            if self.start_ns == 0 {
                self.start_ns = now_ns;
            }
            let due_ns = match self.member.orders.pace {
                Pace::Max => 0,
                Pace::Speed(speed) => self.due_ns(t_end_ns - first_ns, speed, now_ns),
            };
            if now_ns < due_ns {
                sleep_until_ns(due_ns, SLEEP_LIMIT);
                self.say(State::RUNNING)?;
                continue;
            }
            let batch = if self.member.orders.pace == Pace::Max { BATCH } else { 1 };
            for _ in 0..batch {
                let Some((sample, truth)) = next.take_if(|(sample, _)| sample.imu.header.tick < self.allowed_ticks)
                else {
                    break;
                };
                self.publish(sample, truth)?;
                if batch == 1 {
                    // Before the next reading is made: that one is due later.
                    self.imu.wake();
                }
                next = self.read(&mut readings)?;
            }
            if batch > 1 {
                self.imu.wake();
            }
            self.say(State::RUNNING)?;
        }
        Ok(())
    }

    /// When a reading is due that was taken so long after the first. What stood still with the machine goes on from where it was: the
    /// readings of that time would come at once, more of them than a reader that has just been replaced can be given.
    fn due_ns(&mut self, after_first_ns: i64, speed: f64, now_ns: u64) -> u64 {
        let Orders { rate_hz, .. } = self.member.orders;
        let due_ns = self.start_ns + (after_first_ns as f64 / speed) as u64;
        let late_ns = now_ns.saturating_sub(due_ns);
        let late_ticks = late_ns as f64 * 1e-9 * speed * rate_hz;
        if late_ticks < self.member.orders.buffer_ticks() as f64 / 2.0 {
            return due_ns;
        }
        self.start_ns += late_ns;
        now_ns
    }

    /// Publishes the readings of the topic `sensor` as they come.
    fn relay(&mut self) -> Result<(), IngestError> {
        let sensor: Subscriber<SensorReading> = self.member.subscriber()?;
        let receiver: Subscriber<ReceiverReading> = self.member.subscriber()?;
        self.say(State::READY)?;
        while !self.member.ends() {
            self.drain_credit()?;
            self.greet()?;
            self.say(if self.published_ticks > 0 { State::RUNNING } else { State::READY })?;
            if self.published_ticks >= self.allowed_ticks {
                self.member.wait::<Credit>(&self.credit);
                continue;
            }
            let (mut published, mut fix) = (Ok(()), None);
            receiver.drain(BATCH, |reading| fix = Some(fix_of(reading)))?;
            sensor.drain(BATCH, |reading| {
                let reading = Reading { fix: fix.take(), ..reading.into() };
                if let (true, Some(sample)) = (published.is_ok(), self.conditioner.condition(&reading)) {
                    published = self.publish(sample, None);
                }
            })?;
            published?;
            self.imu.wake();
            self.member.wait::<SensorReading>(&sensor);
        }
        Ok(())
    }

    /// Unless the service was asked to end before, the source is at its end; it stays until the last reader has what it sent.
    fn finish(&mut self) -> Result<(), IngestError> {
        while !self.member.ends() {
            self.greet()?;
            self.say(State::FINISHED)?;
            self.member.wait::<Credit>(&self.credit);
        }
        let standing = self.standing();
        Ok(self.member.say_last(standing)?)
    }

    /// The next reading that can be placed, as a sample.
    fn read(&mut self, readings: &mut Readings) -> Result<Option<(Sample, Option<Truth>)>, IngestError> {
        if self.conditioner.ticks() >= self.ticks_max() {
            return Ok(None);
        }
        for reading in readings {
            let reading: Reading = reading?;
            if let Some(sample) = self.conditioner.condition(&reading) {
                return Ok(Some((sample, reading.reference)));
            }
        }
        Ok(None)
    }

    fn publish(&mut self, sample: Sample, truth: Option<Truth>) -> Result<(), IngestError> {
        let Sample { mut imu, mag, gnss } = sample;
        if let Some(Truth { quaternion, scored }) = truth {
            let tick = imu.header.tick;
            self.reference.send(&Reference { tick, scored: scored.into(), quaternion })?;
        }
        self.flags |= imu.header.flags;
        self.member.stamp(&mut imu.header);
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
        self.imu.note(imu.header.tick);
        self.imu.send(&imu)?;
        self.published_ticks += 1;
        self.note()
    }

    /// Tells from time to time what another life needs to go on.
    fn note(&mut self) -> Result<(), IngestError> {
        if self.published_ticks < self.next_checkpoint {
            return Ok(());
        }
        self.next_checkpoint = self.published_ticks + self.member.orders.checkpoint_ticks();
        let mut checkpoint = Checkpoint {
            next_tick: self.published_ticks,
            service: Service::Ingest as u32,
            incarnation: self.member.orders.incarnation,
            slot_words: 2,
            ..bytemuck::Zeroable::zeroed()
        };
        checkpoint.words[..2].copy_from_slice(&[self.start_ns, self.conditioner.offset_ns().cast_unsigned()]);
        checkpoint.checksum = checkpoint.sum();
        Ok(self.checkpoints.send(&checkpoint)?)
    }

    /// Hands what the topics hold to readers that have come.
    fn greet(&self) -> Result<(), IngestError> {
        self.imu.greet()?;
        self.mag.greet()?;
        Ok(self.gnss.greet()?)
    }

    fn drain_credit(&mut self) -> Result<(), IngestError> {
        let allowed_ticks = &mut self.allowed_ticks;
        Ok(self.credit.drain(BUFFER_BESIDE, |credit| *allowed_ticks = credit.ticks.max(*allowed_ticks))?)
    }

    fn say(&mut self, state: State) -> Result<(), IngestError> {
        let standing = self.standing();
        Ok(self.member.say(state, standing)?)
    }

    /// How far it is.
    fn standing(&self) -> impl FnOnce(&mut Health) + use<> {
        let (ticks, refused, flags) = (self.published_ticks, self.conditioner.refused(), self.flags);
        move |health| (health.ticks, health.next_tick, health.refused, health.flags) = (ticks, ticks, refused, flags)
    }

    fn ticks_max(&self) -> u64 {
        self.member.orders.ticks_max.unwrap_or(u64::MAX)
    }
}
