//! A topic of the bus, thinned out to its rate and put into parcels.

use std::{thread, time::Duration};

use bus::{BusError, Subscriber};
use launch::Rate;
use messages::{
    AccelPoint, AttitudeOutput, Checkpoint, Control, Credit, Difference, EVERY_TICK, FusedState, GnssFix, GyroStep,
    Health, ImuSample, MagSample, Message, ReceiverReading, Reference, SensorReading, TOPICS, Ticked,
};
use runtime::{Member, clock::monotonic_ns, orders::BUFFER_BESIDE, service::FIRST_EPOCH};
use swap::Inlet;
use wire::Payload;

use crate::{
    queue::{Parcel, Queue},
    thinning::Thinning,
};

/// The topics that go out, in the order of the path.
pub(crate) struct Taps(Vec<Box<dyn Tapping>>);

impl Taps {
    /// Opens every topic that the launch file gives a rate.
    pub(crate) fn open(member: &Member) -> Result<Self, BusError> {
        let rates = &member.orders.launch.gateway.rates;
        let rated = |(topic, name): (usize, &&str)| Some((topic, *rates.get(*name)?));
        let taps = TOPICS.iter().enumerate().filter_map(rated).map(|(topic, rate)| tap(member, topic, rate));
        Ok(Self(taps.collect::<Result<_, _>>()?))
    }

    /// Takes what has come.
    pub(crate) fn look(&mut self, queue: &Queue) -> Result<(), BusError> {
        self.0.iter_mut().try_for_each(|tap| tap.look(queue))
    }

    /// Sleeps until a tick has come as far along the path as topics go out, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        match self.0.iter().rfind(|tap| tap.has_every_tick()) {
            Some(tap) => tap.wait(limit),
            None => thread::sleep(limit),
        }
    }

    /// Samples taken to go out.
    pub(crate) fn samples(&self) -> u64 {
        self.0.iter().map(|tap| tap.samples()).sum()
    }
}

trait Tapping {
    fn look(&mut self, queue: &Queue) -> Result<(), BusError>;
    fn has_every_tick(&self) -> bool;
    fn wait(&self, limit: Duration);
    fn samples(&self) -> u64;
}

fn tap(member: &Member, topic: usize, rate: Rate) -> Result<Box<dyn Tapping>, BusError> {
    let name = TOPICS.get(topic).copied().unwrap_or_default();
    let path = member.orders.buffer_ticks();
    let rate_hz = member.orders.rate_hz;
    Ok(match name {
        SensorReading::TOPIC => {
            Box::new(Tap::new(member, topic, rate, path, in_any_order, |it: &SensorReading| it.t_sensor_ns)?)
        }
        ReceiverReading::TOPIC => Box::new(Tap::new(member, topic, rate, path, in_any_order, now::<ReceiverReading>)?),
        ImuSample::TOPIC => in_order::<ImuSample>(member, topic, rate)?,
        MagSample::TOPIC => Box::new(Tap::new(member, topic, rate, path, in_any_order, end_of::<MagSample>)?),
        GnssFix::TOPIC => Box::new(Tap::new(member, topic, rate, path, in_any_order, end_of::<GnssFix>)?),
        Reference::TOPIC => {
            let time = move |it: &Reference| (it.tick as f64 * 1e9 / rate_hz) as i64;
            Box::new(Tap::new(member, topic, rate, path, in_any_order, time)?)
        }
        GyroStep::TOPIC => in_order::<GyroStep>(member, topic, rate)?,
        AccelPoint::TOPIC => in_order::<AccelPoint>(member, topic, rate)?,
        FusedState::TOPIC => in_order::<FusedState>(member, topic, rate)?,
        AttitudeOutput::TOPIC => in_order::<AttitudeOutput>(member, topic, rate)?,
        Credit::TOPIC => Box::new(Tap::new(member, topic, rate, BUFFER_BESIDE, in_any_order, now::<Credit>)?),
        Checkpoint::TOPIC => Box::new(Tap::new(member, topic, rate, BUFFER_BESIDE, in_any_order, now::<Checkpoint>)?),
        Difference::TOPIC => Box::new(Tap::new(member, topic, rate, BUFFER_BESIDE, in_any_order, now::<Difference>)?),
        Control::TOPIC => Box::new(Tap::new(member, topic, rate, BUFFER_BESIDE, in_any_order, now::<Control>)?),
        _ => Box::new(Tap::new(member, topic, rate, BUFFER_BESIDE, in_any_order, now::<Health>)?),
    })
}

/// A topic with every tick: each once, in order, whoever fills the slot; what is missing was overwritten before it was taken.
fn in_order<M: Ticked + Payload>(member: &Member, topic: usize, rate: Rate) -> Result<Box<dyn Tapping>, BusError> {
    let mut inlet = Inlet::joining(FIRST_EPOCH, member.orders.lateness_ticks() / 2);
    let mut joined = false;
    let order = move |message: M, deliver: &mut dyn FnMut(M, u64)| {
        inlet.offer(message, &mut |message, missing| deliver(message, if joined { missing } else { 0 }));
        joined |= inlet.counts().ticks > 0;
    };
    Ok(Box::new(Tap::new(member, topic, rate, member.orders.buffer_ticks(), order, end_of::<M>)?))
}

fn in_any_order<M>(message: M, deliver: &mut dyn FnMut(M, u64)) {
    deliver(message, 0);
}

fn end_of<M: Ticked>(message: &M) -> i64 {
    message.header().t_end_ns
}

fn now<M>(_: &M) -> i64 {
    monotonic_ns().cast_signed()
}

struct Tap<M: Payload, O, T> {
    topic: usize,
    subscriber: Subscriber<M>,
    buffer: usize,
    order: O,
    time_ns: T,
    thinning: Thinning,
    taken: Vec<M>,
    samples: u64,
    left_out: u64,
    overwritten: u64,
}

impl<M: Payload, O, T> Tap<M, O, T> {
    fn new(member: &Member, topic: usize, rate: Rate, buffer: usize, order: O, time_ns: T) -> Result<Self, BusError> {
        Ok(Self {
            topic,
            subscriber: member.bus.subscriber(buffer)?,
            buffer,
            order,
            time_ns,
            thinning: Thinning::to(rate),
            taken: Vec::new(),
            samples: 0,
            left_out: 0,
            overwritten: 0,
        })
    }
}

impl<M, O, T> Tapping for Tap<M, O, T>
where
    M: Payload,
    O: FnMut(M, &mut dyn FnMut(M, u64)),
    T: Fn(&M) -> i64,
{
    fn look(&mut self, queue: &Queue) -> Result<(), BusError> {
        let Self { topic, subscriber, buffer, order, time_ns, thinning, taken, samples, left_out, overwritten } = self;
        subscriber.drain(*buffer, |message| {
            order(message, &mut |message, missing| {
                *overwritten += missing;
                match thinning.keeps(time_ns(&message)) {
                    true => taken.push(message),
                    false => *left_out += 1,
                }
            });
        })?;
        for some in taken.chunks(wire::batch::room(size_of::<M>() * 2)) {
            *samples += some.len() as u64;
            queue.push(Parcel {
                topic: *topic,
                bytes: wire::samples(some),
                samples: some.len() as u64,
                left_out: *left_out,
                overwritten: *overwritten,
            });
        }
        taken.clear();
        Ok(())
    }

    fn has_every_tick(&self) -> bool {
        EVERY_TICK.contains(&M::TOPIC)
    }

    fn wait(&self, limit: Duration) {
        // Woken or not, the caller looks.
        self.subscriber.wait(limit);
    }

    fn samples(&self) -> u64 {
        self.samples
    }
}
