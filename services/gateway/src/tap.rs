//! A topic of the bus, thinned out to its rate and put into batches.

use std::{cell::RefCell, rc::Rc, thread, time::Duration};

use attitude::frames::Frame;
use bus::{BusError, Subscriber};
use graph::{Presence, Topic};
use launch::Rate;
use messages::{AttitudeOutput, Ticked};
use runtime::{ServiceContext, clock::monotonic_ns, frames::attitude_in, service_config::FIRST_EPOCH};
use swap::ReorderBuffer;
use wire::Payload;

use crate::{
    decimator::Decimator,
    mavlink::Mavlink,
    queue::{Batch, Queue},
};

/// A ground station, which the tap of the attitude tells.
pub(crate) type Ground = Rc<RefCell<Mavlink>>;

/// The topics that go out, in the order of the path.
pub(crate) struct Taps(Vec<Box<dyn Tapping>>);

impl Taps {
    /// Opens every topic that the launch file gives a rate, and the attitude for a ground station.
    pub(crate) fn open(context: &ServiceContext, ground: Option<&Ground>) -> Result<Self, BusError> {
        let rates = &context.config.launch.gateway.rates;
        let rate = |topic: Topic| rates.get(topic.name()).copied();
        let is_wanted = |topic: Topic| rate(topic).is_some() || (topic == Topic::Attitude && ground.is_some());
        let wanted = Topic::ALL.iter().copied().filter(|topic| is_wanted(*topic));
        let taps = wanted.map(|topic| tap(context, topic, rate(topic), ground));
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

/// Without a rate nothing of the topic goes into the queue.
fn tap(
    context: &ServiceContext,
    topic: Topic,
    rate: Option<Rate>,
    ground: Option<&Ground>,
) -> Result<Box<dyn Tapping>, BusError> {
    if topic == Topic::Attitude {
        let frame = context.config.launch.output.frame;
        let (ground, rate_hz) = (ground.cloned(), context.config.rate_hz);
        return in_order(context, rate, move |output: AttitudeOutput| {
            if let Some(ground) = &ground {
                ground.borrow_mut().take(&attitude_in(Frame::NedFrd, output), time_ns(&output, rate_hz));
            }
            attitude_in(frame, output)
        });
    }
    messages::dispatch!(topic,
        ticked M => match topic.entry().presence {
            Presence::EveryTick => in_order::<M>(context, rate, |message| message),
            Presence::Flagged(_) | Presence::NoTick => in_any_order::<M>(context, rate),
        },
        other M => in_any_order::<M>(context, rate)
    )
}

/// A topic with every tick: each once, in order, whoever fills the slot, and as `given` makes it; what is missing was overwritten before it was taken.
fn in_order<M: Ticked + Payload>(
    context: &ServiceContext,
    rate: Option<Rate>,
    given: impl Fn(M) -> M + 'static,
) -> Result<Box<dyn Tapping>, BusError> {
    let mut reorder_buffer = ReorderBuffer::joining(FIRST_EPOCH, context.config.lateness_ticks() / 2);
    let mut joined = false;
    let order = move |message: M, deliver: &mut dyn FnMut(M, u64)| {
        reorder_buffer
            .offer(message, &mut |message, missing| deliver(given(message), if joined { missing } else { 0 }));
        joined |= reorder_buffer.sequence().ticks > 0;
    };
    Ok(Box::new(Tap::new(context, rate, order)?))
}

fn in_any_order<M: Payload>(context: &ServiceContext, rate: Option<Rate>) -> Result<Box<dyn Tapping>, BusError> {
    Ok(Box::new(Tap::new(context, rate, |message: M, deliver: &mut dyn FnMut(M, u64)| deliver(message, 0))?))
}

struct Tap<M: Payload, O> {
    subscriber: Subscriber<M>,
    buffer: usize,
    rate_hz: f64,
    order: O,
    decimator: Option<Decimator>,
    taken: Vec<M>,
    samples: u64,
    decimated: u64,
    overwritten: u64,
}

impl<M: Payload, O> Tap<M, O> {
    fn new(context: &ServiceContext, rate: Option<Rate>, order: O) -> Result<Self, BusError> {
        let buffer = context.config.buffer(M::TOPIC);
        Ok(Self {
            subscriber: context.bus.subscriber(buffer)?,
            buffer,
            rate_hz: context.config.rate_hz,
            order,
            decimator: rate.map(Decimator::to),
            taken: Vec::new(),
            samples: 0,
            decimated: 0,
            overwritten: 0,
        })
    }
}

impl<M: Payload, O: FnMut(M, &mut dyn FnMut(M, u64))> Tapping for Tap<M, O> {
    fn look(&mut self, queue: &Queue) -> Result<(), BusError> {
        let Self { subscriber, buffer, rate_hz, order, decimator, taken, samples, decimated, overwritten } = self;
        subscriber.drain(*buffer, |message| {
            order(message, &mut |message, missing| {
                *overwritten += missing;
                match decimator.as_mut().is_some_and(|decimator| decimator.keeps(time_ns(&message, *rate_hz))) {
                    true => taken.push(message),
                    false => *decimated += 1,
                }
            });
        })?;
        for some in taken.chunks(wire::batch::room(size_of::<M>() * 2)) {
            *samples += some.len() as u64;
            queue.push(Batch {
                topic: M::TOPIC.place,
                bytes: wire::samples(some),
                samples: some.len() as u64,
                decimated: *decimated,
                overwritten: *overwritten,
            });
        }
        taken.clear();
        Ok(())
    }

    fn has_every_tick(&self) -> bool {
        M::TOPIC.presence == Presence::EveryTick
    }

    fn wait(&self, limit: Duration) {
        // Woken or not, the caller looks.
        self.subscriber.wait(limit);
    }

    fn samples(&self) -> u64 {
        self.samples
    }
}

/// The source's time where the message has one, else this machine's.
fn time_ns<M: Payload>(message: &M, rate_hz: f64) -> i64 {
    message.source_time_ns(rate_hz).unwrap_or_else(|| monotonic_ns().cast_signed())
}
