//! A topic of the bus, thinned out to its rate and put into batches.

use std::{thread, time::Duration};

use bus::{BusError, Subscriber};
use graph::{Presence, Topic};
use launch::Rate;
use messages::Ticked;
use runtime::{ServiceContext, clock::monotonic_ns, frames::attitude_in, service_config::FIRST_EPOCH};
use swap::ReorderBuffer;
use wire::Payload;

use crate::{
    decimator::Decimator,
    queue::{Batch, Queue},
};

/// The topics that go out, in the order of the path.
pub(crate) struct Taps(Vec<Box<dyn Tapping>>);

impl Taps {
    /// Opens every topic that the launch file gives a rate.
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, BusError> {
        let rates = &context.config.launch.gateway.rates;
        let rated = |topic: &Topic| Some((*topic, *rates.get(topic.name())?));
        let taps = Topic::ALL.iter().filter_map(rated).map(|(topic, rate)| tap(context, topic, rate));
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

fn tap(context: &ServiceContext, topic: Topic, rate: Rate) -> Result<Box<dyn Tapping>, BusError> {
    if topic == Topic::Attitude {
        let frame = context.config.launch.output.frame;
        return in_order(context, rate, move |output| attitude_in(frame, output));
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
    rate: Rate,
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

fn in_any_order<M: Payload>(context: &ServiceContext, rate: Rate) -> Result<Box<dyn Tapping>, BusError> {
    Ok(Box::new(Tap::new(context, rate, |message: M, deliver: &mut dyn FnMut(M, u64)| deliver(message, 0))?))
}

struct Tap<M: Payload, O> {
    subscriber: Subscriber<M>,
    buffer: usize,
    rate_hz: f64,
    order: O,
    decimator: Decimator,
    taken: Vec<M>,
    samples: u64,
    decimated: u64,
    overwritten: u64,
}

impl<M: Payload, O> Tap<M, O> {
    fn new(context: &ServiceContext, rate: Rate, order: O) -> Result<Self, BusError> {
        let buffer = context.config.buffer(M::TOPIC);
        Ok(Self {
            subscriber: context.bus.subscriber(buffer)?,
            buffer,
            rate_hz: context.config.rate_hz,
            order,
            decimator: Decimator::to(rate),
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
                let time_ns = message.source_time_ns(*rate_hz).unwrap_or_else(|| monotonic_ns().cast_signed());
                match decimator.keeps(time_ns) {
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
