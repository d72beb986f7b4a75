//! The exporting end: from the bus into the cache, and from there to whoever listens or asks.

use std::{
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::{self, JoinHandle},
    time::Duration,
};

use bus::Subscriber;
use graph::{Presence, Topic};
use launch::CACHE_TICKS_MAX;
use link::{Link, LinkError, Question};
use messages::Ticked;
use runtime::{RuntimeError, ServiceContext, service_config::FIRST_EPOCH};
use swap::ReorderBuffer;
use wire::keys;

use super::{
    Notes,
    cache::Cache,
    frame::{Frame, Head},
    merge::Merge,
    record::{place, places},
    run_of,
};
use crate::{Shared, locked, worker_pool::WorkerPool};

/// Frames in answer to one question: some seconds of ticks. Who wants more asks again.
const FRAMES_MAX: usize = 64;
/// Longest wait for something to send.
const TURN_LIMIT: Duration = Duration::from_millis(50);

/// The bus's side.
pub(crate) struct Export {
    sources: Vec<Box<dyn Source>>,
    merge: Merge,
    notes: Notes,
    run: u64,
    pub(crate) next_tick: u64,
    pub(crate) kept: Arc<Kept>,
}

/// What both sides know.
#[derive(Debug)]
pub(crate) struct Kept {
    cache: Mutex<Cache>,
    grown: Condvar,
    head: Head,
    key: String,
}

impl Export {
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let config = &context.config;
        let gateway = &config.launch.gateway;
        let mask = gateway.export.iter().filter_map(|topic| place(topic)).fold(0, |mask, place| mask | 1 << place);
        // Those with every tick first: what goes with a tick was published before it.
        let dense = places(mask).filter(|(_, topic)| topic.is_dense);
        let order = dense.chain(places(mask).filter(|(_, topic)| !topic.is_dense));
        let sources: Vec<_> =
            order.filter_map(|(place, topic)| source(context, place, topic.topic)).collect::<Result<_, _>>()?;
        let merge = match config.resume {
            None => Merge::starting(mask, config.lateness_ticks()),
            Some(_) => {
                let expected_until = sources.iter().map(|source| source.next_tick(context)).max().unwrap_or(0);
                Merge::joining(mask, config.lateness_ticks(), expected_until)
            }
        };
        let run = run_of(config.supervisor_pid);
        let topics = places(mask).map(|(_, topic)| (topic.name.to_owned(), topic.fingerprint)).collect();
        let vehicle = gateway.vehicle.as_ref().unwrap_or(&config.launch.name);
        let kept = Kept {
            cache: Mutex::new(Cache::new(((gateway.cache_s * config.rate_hz) as usize).min(CACHE_TICKS_MAX))),
            grown: Condvar::new(),
            head: Head { run, rate_hz: config.rate_hz, topics, oldest_tick: 0, next_tick: 0, first_tick: 0 },
            key: keys::key(vehicle, keys::CARRY),
        };
        Ok(Self { sources, merge, notes: Notes::open(context)?, run, next_tick: 0, kept: Arc::new(kept) })
    }

    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        for source in &mut self.sources {
            source.look(&mut self.merge)?;
        }
        let before = self.next_tick;
        let mut cache = locked(&self.kept.cache);
        while let Some(record) = self.merge.take() {
            self.next_tick = record.tick + 1;
            cache.push(record);
        }
        drop(cache);
        if self.next_tick != before {
            self.kept.grown.notify_one();
        }
        self.notes.publish(context, self.next_tick, self.run)
    }

    /// Sleeps until there is something of the topic that the next tick waits for, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        let lacking = self.merge.lacks().and_then(|place| self.sources.iter().find(|source| source.place() == place));
        match lacking {
            Some(source) => source.wait(limit),
            None => thread::sleep(limit),
        }
    }
}

impl Kept {
    /// Sends what the cache gets and answers who asks, until the gateway ends.
    pub(crate) fn carry(self: &Arc<Self>, link: &Link, shared: Arc<Shared>) -> Result<JoinHandle<()>, LinkError> {
        let outlet = link.carrier(&self.key)?;
        let workers = WorkerPool::new(&shared.turned_away);
        let kept = self.clone();
        let answering = link.answering(&self.key, move |question| {
            let kept = kept.clone();
            workers.see_to(question, move |question| kept.answer(question));
        })?;
        let kept = self.clone();
        Ok(thread::spawn(move || {
            let _answering = answering;
            let mut sent_tick = 0;
            loop {
                let ends = shared.ends();
                let Some((bytes, next_tick)) = kept.next_frame(sent_tick) else {
                    if ends {
                        break;
                    }
                    continue;
                };
                // What is not taken is asked for.
                let _ = outlet.send(&bytes);
                sent_tick = next_tick;
            }
        }))
    }

    /// The next records, once there are any.
    fn next_frame(&self, sent_tick: u64) -> Option<(Vec<u8>, u64)> {
        let nothing = |cache: &mut Cache| cache.next_tick().is_none_or(|next_tick| next_tick <= sent_tick);
        let grown = self.grown.wait_timeout_while(locked(&self.cache), TURN_LIMIT, nothing);
        let (mut cache, _) = grown.unwrap_or_else(PoisonError::into_inner);
        (!nothing(&mut cache)).then(|| self.frame(&cache, sent_tick, u64::MAX)).flatten()
    }

    /// The records asked for that are kept; without any, how far the cache reaches.
    fn answer(&self, question: &Question) {
        let (Some(from), Some(to)) = (question.number("from"), question.number("to")) else {
            return question.refuse("ask with ?from=TICK;to=TICK");
        };
        let mut tick = from;
        for _ in 0..FRAMES_MAX {
            let Some((bytes, next_tick)) = self.frame(&locked(&self.cache), tick, to) else { return };
            question.hand_over(&self.key, bytes);
            if next_tick >= to || next_tick <= tick {
                return;
            }
            tick = next_tick;
        }
    }

    /// The kept records from one tick to before another, as many as a frame takes.
    fn frame(&self, cache: &Cache, from_tick: u64, to_tick: u64) -> Option<(Vec<u8>, u64)> {
        let (oldest_tick, next_tick) = (cache.oldest_tick()?, cache.next_tick()?);
        let first_tick = from_tick.clamp(oldest_tick, next_tick);
        let head = Head { oldest_tick, next_tick, first_tick, ..self.head.clone() };
        Some(Frame::encode(&head, cache.from(first_tick).take_while(|record| record.tick < to_tick)))
    }
}

/// A topic of the bus.
trait Source {
    fn look(&mut self, merge: &mut Merge) -> Result<(), RuntimeError>;
    fn place(&self) -> usize;
    fn wait(&self, limit: Duration);
    fn next_tick(&self, context: &ServiceContext) -> u64;
}

fn source(context: &ServiceContext, place: usize, topic: Topic) -> Option<Result<Box<dyn Source>, RuntimeError>> {
    messages::dispatch!(topic,
        ticked M => Some(match topic.entry().presence {
            Presence::EveryTick => in_order::<M>(context, place),
            Presence::Flagged(_) | Presence::NoTick => aside::<M>(context, place),
        }),
        other M => None
    )
}

/// A topic with every tick: each once, in order, whoever fills the slot.
fn in_order<M: Ticked>(context: &ServiceContext, place: usize) -> Result<Box<dyn Source>, RuntimeError> {
    let lateness_ticks = context.config.lateness_ticks() / 2;
    let reorder_buffer: ReorderBuffer<M> = match context.config.resume {
        None => ReorderBuffer::starting(0, FIRST_EPOCH, lateness_ticks),
        Some(_) => ReorderBuffer::joining(FIRST_EPOCH, lateness_ticks),
    };
    Tap::<M>::open(context, place, Some(reorder_buffer))
}

/// A topic with some ticks, from one publisher.
fn aside<M: Ticked>(context: &ServiceContext, place: usize) -> Result<Box<dyn Source>, RuntimeError> {
    Tap::<M>::open(context, place, None)
}

struct Tap<M: Ticked> {
    place: usize,
    subscriber: Subscriber<M>,
    buffer: usize,
    reorder_buffer: Option<ReorderBuffer<M>>,
}

impl<M: Ticked> Tap<M> {
    fn open(
        context: &ServiceContext,
        place: usize,
        reorder_buffer: Option<ReorderBuffer<M>>,
    ) -> Result<Box<dyn Source>, RuntimeError> {
        let buffer = context.config.buffer_ticks();
        // In a later incarnation the cache is filled again from what the topics hold.
        Ok(Box::new(Self { place, subscriber: context.subscriber()?, buffer, reorder_buffer }))
    }
}

impl<M: Ticked> Source for Tap<M> {
    fn look(&mut self, merge: &mut Merge) -> Result<(), RuntimeError> {
        let Self { place, subscriber, buffer, reorder_buffer } = self;
        let mut offer = |message: M| {
            let header = message.header();
            merge.offer(*place, header.tick, header.flags, bytemuck::bytes_of(&message));
        };
        Ok(subscriber.drain(*buffer, |message| match reorder_buffer {
            Some(reorder_buffer) => reorder_buffer.offer(message, &mut |message, _| offer(message)),
            None => offer(message),
        })?)
    }

    fn place(&self) -> usize {
        self.place
    }

    fn wait(&self, limit: Duration) {
        // Woken or not, the caller looks.
        self.subscriber.wait(limit);
    }

    fn next_tick(&self, context: &ServiceContext) -> u64 {
        context.bus.next_tick(M::TOPIC)
    }
}
