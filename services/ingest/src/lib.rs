//! The service `ingest`: publishes the readings of a source as checked, numbered samples.
//!
//! Input: a simulation, a recording, or readings from the bus.
//!
//! Output: one [`ImuSample`] per tick, and the true attitude if the source provides it.
//!
//! Time: readings are published when they are due. In lockstep, they also wait until the
//! subscribers have room.
//!
//! Failure: see [`mod@readings::conditioner`].
#![forbid(unsafe_code)]

mod feed;
mod raw_reading_publisher;

use std::{num::NonZeroUsize, thread::available_parallelism, time::Duration};

use bus::{BusError, Publisher, Subscriber};
use bytemuck::Zeroable as _;
use launch::Service;
use messages::{
    Checkpoint, Credit, Flags, GnssFix, Header, Health, ImuSample, MagSample, Message, Reference, SensorReading, State,
};
use readings::{
    conditioner,
    conditioner::{Conditioner, Sample},
    source::{Reading, Readings, SourceError, Truth},
};
use runtime::{
    BriefWait, Pace, PacingTimer, RuntimeError, ServiceConfig, ServiceContext,
    clock::monotonic_ns,
    service_config::{CONTROL_BUFFER, Resume},
};

use feed::BusFeed;
use raw_reading_publisher::RawReadingPublisher;

/// Maximum number of samples published before the subscribers are woken.
const MAX_BATCH_SAMPLES: usize = 64;
/// Number of successive rejected readings after which the other processes are served.
const REJECTED_PER_CHECK: u64 = 1024;
/// Maximum sleep, so that health is published and a stop request is noticed in time.
const MAX_SLEEP: Duration = Duration::from_millis(50);
/// Shortest interval between samples at which the processor is yielded to the subscribers, s.
///
/// At shorter intervals, the other processors stay awake and start the subscribers without delay.
/// Yields save 5 % of the processor time of a system at 1 kHz to 4 kHz. At 8 kHz they save 2 %, but
/// increase the latency by 7 %.
const MIN_YIELD_INTERVAL_S: f64 = 2e-4;

/// Error that ended the service.
#[derive(Debug, thiserror::Error)]
pub enum IngestError {
    /// The service loop or the bus failed.
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

/// Runs the service until it is stopped. After its source has ended, it serves late subscribers.
///
/// # Errors
///
/// Returns an error if the bus or the source fails.
pub fn run() -> Result<(), IngestError> {
    let context = ServiceContext::join(Service::Ingest)?;
    let mut ingest = match context.config.launch.ingest.source {
        source if source.is_repeatable() => {
            let mut paced = PacedIngest::start(context)?;
            while paced.run_round()? {}
            paced.ingest
        }
        _ => {
            let mut ingest = Ingest::new(context)?;
            ingest.relay_bus()?;
            ingest
        }
    };
    ingest.finish()
}

/// Publishes the readings of a simulation or a recording when they are due.
pub struct PacedIngest {
    ingest: Ingest,
    readings: Readings,
    /// Next sample; `None` at the end of the source.
    next: Option<Sample>,
    /// End of the first sample's interval on the source's clock, ns.
    first_ns: i64,
    timer: PacingTimer,
    /// Yields the processor to the subscribers of a sample; `None` if that has no benefit.
    ///
    /// The kernel starts some of the subscribers on the processor of this service. Without a yield,
    /// they would start only after the next sample is computed, or interrupt this service. `fuser`
    /// would wait for them, and often sleep twice per tick.
    brief_wait: Option<BriefWait>,
}

impl PacedIngest {
    /// Opens the source and the topics. Recomputes the ticks that an earlier incarnation published,
    /// to restore the conditioner's state.
    ///
    /// # Errors
    ///
    /// Returns an error if the bus or the source fails.
    pub fn start(context: ServiceContext) -> Result<Self, IngestError> {
        let mut ingest = Ingest::new(context)?;
        let mut readings = Readings::open(&ingest.context.config.launch)?;
        ingest.publish_health(State::READY)?;
        ingest.context.bus.wake_all();
        let mut next = ingest.read(&mut readings, State::READY)?;
        let first_ns = next.as_ref().map_or(0, |sample| sample.imu.header.t_end_ns);
        while let (false, Some(_)) =
            (ingest.context.should_stop(), next.take_if(|sample| sample.imu.header.tick < ingest.resume_tick))
        {
            next = ingest.read(&mut readings, State::READY)?;
            ingest.publish_health(State::READY)?;
        }
        let processors = available_parallelism().map_or(1, NonZeroUsize::get);
        let brief_wait = should_yield(&ingest.context.config, processors).then(BriefWait::default);
        Ok(Self { ingest, readings, next, first_ns, timer: PacingTimer::for_current_thread(), brief_wait })
    }

    /// Waits until the next sample is due and may be published, and publishes it. At maximum speed,
    /// publishes a batch of samples. May return earlier without publishing.
    ///
    /// Returns `false` once there is nothing more to publish.
    ///
    /// # Errors
    ///
    /// Returns an error if the bus or the source fails.
    pub fn run_round(&mut self) -> Result<bool, IngestError> {
        let Self { ingest, readings, next, first_ns, timer, brief_wait } = self;
        let (false, Some(sample)) = (ingest.context.should_stop(), &*next) else { return Ok(false) };
        ingest.drain_credit()?;
        ingest.deliver_history()?;
        let (tick, t_end_ns) = (sample.imu.header.tick, sample.imu.header.t_end_ns);
        if ingest.end_tick.is_some_and(|end_tick| tick >= end_tick) {
            return Ok(false);
        }
        if tick >= ingest.allowed_ticks {
            ingest.publish_health(if ingest.published_ticks > 0 { State::RUNNING } else { State::READY })?;
            ingest.context.wait::<Credit>(&ingest.credit);
            return Ok(true);
        }
        let now_ns = monotonic_ns();
        let due_ns = match ingest.context.config.pace {
            Pace::Max => 0,
            Pace::Speed(_) if tick < ingest.catch_up_end_tick => 0,
            Pace::Speed(speed) => ingest.due_ns(t_end_ns - *first_ns, speed, now_ns),
        };
        let has_slept = now_ns < due_ns;
        if has_slept {
            timer.sleep_until_ns(due_ns, MAX_SLEEP);
            // A signal or the limit ends the sleep early.
            if monotonic_ns() < due_ns {
                ingest.publish_health(State::RUNNING)?;
                return Ok(true);
            }
        }
        let batch = if ingest.context.config.pace == Pace::Max { MAX_BATCH_SAMPLES } else { 1 };
        let mut following = Ok(());
        for _ in 0..batch {
            let Some(sample) = next.take_if(|sample| sample.imu.header.tick < ingest.allowed_ticks) else {
                break;
            };
            ingest.publish(sample)?;
            if batch == 1 {
                // The subscribers process this sample while the next one is computed.
                ingest.imu.wake();
                brief_wait.iter_mut().filter(|_| has_slept).for_each(BriefWait::yield_once);
            }
            following = ingest.read(readings, State::RUNNING).map(|sample| *next = sample);
            if following.is_err() {
                break;
            }
        }
        if batch > 1 {
            ingest.imu.wake();
        }
        following?;
        ingest.publish_health(State::RUNNING)?;
        Ok(true)
    }
}

/// Returns `true` if a service with this configuration should yield the processor after each sample
/// for which it has slept. With a single processor, a yield would only add a system call to the
/// switches between the services.
fn should_yield(config: &ServiceConfig, processors: usize) -> bool {
    let is_interval_long = match config.pace {
        Pace::Speed(speed) => config.rate_hz * speed * MIN_YIELD_INTERVAL_S <= 1.0,
        Pace::Max => false,
    };
    is_interval_long && processors > 1
}

struct Ingest {
    context: ServiceContext,
    conditioner: Conditioner,
    imu: Publisher<ImuSample>,
    mag: Publisher<MagSample>,
    gnss: Publisher<GnssFix>,
    reference: Publisher<Reference>,
    /// Publisher of the raw readings; `None` unless the recorded flight has to be replayable.
    raw_readings: Option<RawReadingPublisher>,
    checkpoints: Publisher<Checkpoint>,
    /// Newest checkpoint; all zeros before the first one.
    checkpoint: Box<Checkpoint>,
    credit: Subscriber<Credit>,
    /// First tick that this incarnation publishes. A previous incarnation has published the ticks
    /// before it.
    resume_tick: u64,
    /// Ticks before this one may still be missing at some subscribers and are published without
    /// pacing.
    catch_up_end_tick: u64,
    /// Time at which the first tick was due on CLOCK_MONOTONIC, ns; 0 before the first tick.
    start_ns: u64,
    next_checkpoint_tick: u64,
    allowed_ticks: u64,
    /// Publication ends before this tick. `None` until a stop has been requested.
    end_tick: Option<u64>,
    published_ticks: u64,
    /// Number of readings that were overwritten before they were received.
    lost_readings: u64,
    flags: Flags,
}

impl Ingest {
    fn new(context: ServiceContext) -> Result<Self, IngestError> {
        let mut conditioner = conditioner(&context.config)?;
        let (mut resume_tick, mut catch_up_end_tick, mut start_ns) = (0, 0, 0);
        if let Some(Resume::Source { next_tick, start_ns: since_ns, offset_ns }) = context.config.resume {
            (resume_tick, start_ns) = (next_tick, since_ns);
            catch_up_end_tick = context.config.catch_up_end_tick(resume_tick, context.bus.next_tick(ImuSample::TOPIC));
            if !context.config.launch.ingest.source.is_repeatable() {
                resume_tick = context.bus.next_tick(ImuSample::TOPIC);
                conditioner.resume_at(resume_tick, offset_ns);
            }
        }
        Ok(Self {
            conditioner,
            raw_readings: match context.config.publishes_readings {
                true => Some(RawReadingPublisher::new(context.publisher()?, &context.config, resume_tick)),
                false => None,
            },
            checkpoints: context.bus.publisher(CONTROL_BUFFER)?,
            checkpoint: Box::new(Checkpoint::zeroed()),
            resume_tick,
            catch_up_end_tick,
            start_ns,
            next_checkpoint_tick: 0,
            imu: context.publisher()?,
            mag: context.publisher()?,
            gnss: context.publisher()?,
            reference: context.bus.publisher(context.config.buffer_ticks())?,
            credit: context.bus.late_subscriber(CONTROL_BUFFER)?,
            context,
            allowed_ticks: 0,
            end_tick: None,
            published_ticks: resume_tick,
            lost_readings: 0,
            flags: Flags::NONE,
        })
    }

    /// Returns the time at which a reading is due on CLOCK_MONOTONIC, ns.
    ///
    /// `after_first_ns` is the time from the first reading to this one on the source's clock, ns.
    /// After a system stall the schedule is shifted, because the backlog could exceed what a topic
    /// buffers.
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

    /// Publishes the readings of the topic `sensor` as they arrive, until the drivers have
    /// finished.
    fn relay_bus(&mut self) -> Result<(), IngestError> {
        let mut feed = BusFeed::open(&self.context)?;
        self.publish_health(State::READY)?;
        while !self.context.should_stop() {
            self.drain_credit()?;
            self.deliver_history()?;
            if self.end_tick.is_some() || self.published_ticks >= self.max_ticks() {
                break;
            }
            self.publish_health(if self.published_ticks > 0 { State::RUNNING } else { State::READY })?;
            if self.published_ticks >= self.allowed_ticks {
                self.context.wait::<Credit>(&self.credit);
                continue;
            }
            let has_ended = feed.has_ended()?;
            let room = self.allowed_ticks.min(self.max_ticks()) - self.published_ticks;
            let (mut published, mut handled) = (Ok(()), 0);
            feed.drain(room.min(MAX_BATCH_SAMPLES as u64) as usize, |reading| {
                handled += 1;
                if published.is_ok() {
                    published = self.process(&reading).and_then(|sample| match sample {
                        Some(sample) => self.publish(sample),
                        None => Ok(()),
                    });
                }
            })?;
            published?;
            self.lost_readings = feed.overwritten();
            self.imu.wake();
            if has_ended && handled == 0 {
                break;
            }
            self.context.wait::<SensorReading>(&feed.sensor);
        }
        Ok(())
    }

    /// Reports the end of the source and serves late subscribers until the service is stopped.
    fn finish(&mut self) -> Result<(), IngestError> {
        while !self.context.should_stop() {
            self.deliver_history()?;
            self.publish_health(State::FINISHED)?;
            self.context.wait::<Credit>(&self.credit);
        }
        let counts = self.counts();
        Ok(self.context.publish_final_health(counts)?)
    }

    /// Returns the sample of the next reading that the conditioner accepts, or `None` if no more
    /// samples follow or are needed.
    ///
    /// A fault can remove all readings of several days. While none is accepted, the other processes
    /// are served and health is published with `state`.
    fn read(&mut self, readings: &mut Readings, state: State) -> Result<Option<Sample>, IngestError> {
        if self.conditioner.ticks() >= self.max_ticks() {
            return Ok(None);
        }
        for (count, reading) in (1_u64..).zip(readings) {
            let reading: Reading = reading?;
            if let Some(sample) = self.process(&reading)? {
                return Ok(Some(sample));
            }
            if count.is_multiple_of(REJECTED_PER_CHECK) {
                self.drain_credit()?;
                self.deliver_history()?;
                self.publish_health(state)?;
                let needs_no_sample = self.end_tick.is_some_and(|end_tick| self.conditioner.ticks() >= end_tick);
                if self.context.should_stop() || needs_no_sample {
                    return Ok(None);
                }
            }
        }
        Ok(None)
    }

    /// Publishes the raw reading, if requested. Returns the sample of the reading, or `None` if the
    /// reading is rejected.
    fn process(&mut self, reading: &Reading) -> Result<Option<Sample>, IngestError> {
        let Self { raw_readings, conditioner, .. } = self;
        if let Some(raw_readings) = raw_readings {
            raw_readings.publish(reading, conditioner)?;
        }
        Ok(conditioner.condition(reading))
    }

    fn publish(&mut self, sample: Sample) -> Result<(), IngestError> {
        let Sample { mut imu, mag, gnss, reference } = sample;
        if let Some(Truth { quaternion, scored }) = reference {
            let Header { tick, t_end_ns, .. } = imu.header;
            self.reference.send(&Reference { tick, t_end_ns, scored: scored.into(), quaternion })?;
        }
        self.flags |= imu.header.flags;
        self.context.stamp(&mut imu.header);
        imu.header.t_born_ns = imu.header.t_sent_ns;
        // The magnetic field and the fix are published before the sample of their tick, so that
        // subscribers need not wait for them.
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

    /// Publishes at regular intervals the state from which another incarnation can resume.
    fn publish_checkpoint(&mut self) -> Result<(), IngestError> {
        if self.published_ticks < self.next_checkpoint_tick {
            return Ok(());
        }
        self.next_checkpoint_tick = self.published_ticks + self.context.config.checkpoint_ticks();
        let Self { checkpoint, .. } = self;
        checkpoint.next_tick = self.published_ticks;
        checkpoint.service = Service::Ingest as u32;
        checkpoint.incarnation = self.context.config.incarnation;
        checkpoint.slot_words = 2;
        checkpoint.words[..2].copy_from_slice(&[self.start_ns, self.conditioner.offset_ns().cast_unsigned()]);
        checkpoint.checksum = checkpoint.compute_checksum();
        Ok(self.checkpoints.send_checkpoint(checkpoint)?)
    }

    /// Delivers the history of the topics to new subscribers.
    fn deliver_history(&self) -> Result<(), IngestError> {
        self.imu.deliver_history()?;
        self.mag.deliver_history()?;
        Ok(self.gnss.deliver_history()?)
    }

    fn drain_credit(&mut self) -> Result<(), IngestError> {
        let Self { credit, allowed_ticks, end_tick, imu, .. } = self;
        Ok(credit.drain(CONTROL_BUFFER, |credit| {
            *allowed_ticks = credit.ticks.max(*allowed_ticks);
            // Publication ends at the topic's next tick, even if this incarnation has not reached
            // that tick yet. This incarnation therefore still repeats all ticks that an earlier one
            // has published.
            *end_tick = end_tick.or((credit.ends != 0).then(|| imu.next_tick()));
        })?)
    }

    fn publish_health(&mut self, state: State) -> Result<(), IngestError> {
        let counts = self.counts();
        Ok(self.context.publish_health(state, counts)?)
    }

    /// Returns a function that writes the current counts into a health message.
    fn counts(&self) -> impl FnOnce(&mut Health) + use<> {
        let (ticks, lost, flags) = (self.published_ticks, self.lost_readings, self.flags);
        let rejected = self.conditioner.rejected();
        move |health| {
            (health.ticks, health.next_tick, health.flags) = (ticks, ticks, flags);
            (health.lost, health.refused) = (lost, rejected);
        }
    }

    fn max_ticks(&self) -> u64 {
        self.context.config.max_ticks.unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use launch::Launch;

    use super::*;

    fn yields(rate_hz: f64, pace: Pace, processors: usize) -> bool {
        should_yield(&ServiceConfig::standalone(Launch::default(), rate_hz, pace), processors)
    }

    #[test]
    fn ingest_yields_only_at_low_rates_with_several_processors() {
        assert!(yields(5000.0, Pace::Speed(1.0), 2));
        assert!(yields(1000.0, Pace::Speed(5.0), 2));
        assert!(!yields(5001.0, Pace::Speed(1.0), 2));
        assert!(!yields(1000.0, Pace::Speed(6.0), 2));
        assert!(!yields(1.0, Pace::Max, 2));
        assert!(!yields(1000.0, Pace::Speed(1.0), 1));
    }
}
