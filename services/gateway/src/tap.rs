//! Readers of bus topics, which reduce each topic to its configured rate and encode batches.

use std::{thread, time::Duration};

use bus::{BusError, Subscriber};
use graph::{Presence, Topic};
use launch::TopicRate;
use messages::Ticked;
use runtime::{
    ServiceContext, clock::monotonic_ns, decimator::Decimator, frames::attitude_to_frame, service_config::FIRST_EPOCH,
};
use swap::ReorderBuffer;
use wire::Payload;

use crate::queue::{Batch, Queue};

/// Taps of all topics that are sent to the network, in data-path order.
pub(crate) struct Taps(Vec<Box<dyn TopicTap>>);

impl Taps {
    /// Subscribes to every topic that has a rate in the launch file.
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, BusError> {
        let rates = &context.config.launch.gateway.rates;
        let rated = |topic: &Topic| Some((*topic, *rates.get(topic.name())?));
        let taps = Topic::ALL.iter().filter_map(rated).map(|(topic, rate)| tap(context, topic, rate));
        Ok(Self(taps.collect::<Result<_, _>>()?))
    }

    /// Reads new messages and pushes selected samples into the queue.
    pub(crate) fn poll(&mut self, queue: &Queue) -> Result<(), BusError> {
        self.0.iter_mut().try_for_each(|tap| tap.poll(queue))
    }

    /// Waits up to `limit` for a tick of the last dense topic on the data path that is tapped.
    pub(crate) fn wait(&self, limit: Duration) {
        match self.0.iter().rfind(|tap| tap.is_dense()) {
            Some(tap) => tap.wait(limit),
            None => thread::sleep(limit),
        }
    }

    /// Returns the number of samples selected.
    pub(crate) fn samples(&self) -> u64 {
        self.0.iter().map(|tap| tap.samples()).sum()
    }
}

trait TopicTap {
    fn poll(&mut self, queue: &Queue) -> Result<(), BusError>;
    fn is_dense(&self) -> bool;
    fn wait(&self, limit: Duration);
    fn samples(&self) -> u64;
}

fn tap(context: &ServiceContext, topic: Topic, rate: TopicRate) -> Result<Box<dyn TopicTap>, BusError> {
    if topic == Topic::Attitude {
        let frame = context.config.launch.output.frame;
        return ordered(context, rate, move |output| attitude_to_frame(frame, output));
    }
    messages::dispatch!(topic,
        ticked M => match topic.entry().presence {
            Presence::EveryTick => ordered::<M>(context, rate, |message| message),
            Presence::Flagged(_) | Presence::NoTick => unordered::<M>(context, rate),
        },
        other M => unordered::<M>(context, rate)
    )
}

/// Creates a tap of a dense topic. It yields each tick once and in order, even if the owner of the
/// slot changes.
///
/// Each message is converted with `convert`. A missing tick counts as overwritten on the bus,
/// because it was published but could not be read.
fn ordered<M: Ticked + Payload>(
    context: &ServiceContext,
    rate: TopicRate,
    convert: impl Fn(M) -> M + 'static,
) -> Result<Box<dyn TopicTap>, BusError> {
    let mut reorder_buffer = ReorderBuffer::with_unknown_start(FIRST_EPOCH, context.config.lateness_ticks() / 2);
    let mut has_started = false;
    let order = move |message: M, deliver: &mut dyn FnMut(M, u64)| {
        reorder_buffer
            .offer(message, &mut |message, missing| deliver(convert(message), if has_started { missing } else { 0 }));
        has_started |= reorder_buffer.sequence().ticks > 0;
    };
    Ok(Box::new(Tap::new(context, rate, order)?))
}

fn unordered<M: Payload>(context: &ServiceContext, rate: TopicRate) -> Result<Box<dyn TopicTap>, BusError> {
    Ok(Box::new(Tap::new(context, rate, |message: M, deliver: &mut dyn FnMut(M, u64)| deliver(message, 0))?))
}

struct Tap<M: Payload, O> {
    subscriber: Subscriber<M>,
    buffer: usize,
    order: O,
    decimator: Decimator,
    selected: Vec<M>,
    samples: u64,
    decimated: u64,
    overwritten: u64,
}

impl<M: Payload, O> Tap<M, O> {
    fn new(context: &ServiceContext, rate: TopicRate, order: O) -> Result<Self, BusError> {
        let buffer = context.config.buffer_size(M::TOPIC);
        Ok(Self {
            subscriber: context.bus.subscriber(buffer)?,
            buffer,
            order,
            decimator: Decimator::new(rate),
            selected: Vec::new(),
            samples: 0,
            decimated: 0,
            overwritten: 0,
        })
    }
}

impl<M: Payload, O: FnMut(M, &mut dyn FnMut(M, u64))> TopicTap for Tap<M, O> {
    fn poll(&mut self, queue: &Queue) -> Result<(), BusError> {
        let Self { subscriber, buffer, order, decimator, selected, samples, decimated, overwritten } = self;
        subscriber.drain(*buffer, |message| {
            order(message, &mut |message, missing| {
                *overwritten += missing;
                let time_ns = message.source_time_ns().unwrap_or_else(|| monotonic_ns().cast_signed());
                match decimator.accept(time_ns) {
                    true => selected.push(message),
                    false => *decimated += 1,
                }
            });
        })?;
        for chunk in selected.chunks(wire::batch::capacity(size_of::<M>() * 2)) {
            *samples += chunk.len() as u64;
            queue.push(Batch {
                topic_index: M::TOPIC.index,
                bytes: wire::encode_samples(chunk),
                samples: chunk.len() as u64,
                decimated: *decimated,
                overwritten: *overwritten,
            });
        }
        selected.clear();
        Ok(())
    }

    fn is_dense(&self) -> bool {
        M::TOPIC.presence == Presence::EveryTick
    }

    fn wait(&self, limit: Duration) {
        // The outcome is ignored, because the caller polls in either case.
        self.subscriber.wait(limit);
    }

    fn samples(&self) -> u64 {
        self.samples
    }
}
