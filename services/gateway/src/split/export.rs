//! Exporting side: from the bus into the cache, and from there to subscribers and queries.

use std::{
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::{self, JoinHandle},
    time::Duration,
};

use bus::Subscriber;
use graph::{Presence, Topic};
use launch::MAX_CACHE_TICKS;
use link::{IncomingQuery, Link, LinkError};
use messages::Ticked;
use runtime::{RuntimeError, ServiceContext, service_config::FIRST_EPOCH};
use swap::ReorderBuffer;
use wire::keys;

use super::{
    cache::Cache,
    frame::{Frame, FrameHeader},
    merge::Merge,
    progress::ProgressCheckpoints,
    record::{index_of, topics_in},
};
use crate::{locked::locked, shared::Shared, worker_pool::WorkerPool};

/// Maximum number of frames in one reply. These frames hold a few seconds of ticks. A client
/// requests the remaining ticks with another query.
const MAX_FRAMES_PER_REPLY: usize = 64;
/// Longest wait for new records.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Bus side of an export, which reads the ticks from the local bus.
pub(crate) struct Export {
    sources: Vec<Box<dyn Source>>,
    merge: Merge,
    progress: ProgressCheckpoints,
    run: u64,
    pub(crate) next_tick: u64,
    pub(crate) state: Arc<ExportState>,
}

/// State shared by the bus side ([`Export`]) and the network side, which runs in its own thread.
#[derive(Debug)]
pub(crate) struct ExportState {
    cache: Mutex<Cache>,
    grown: Condvar,
    header: FrameHeader,
    key: String,
}

impl Export {
    pub(crate) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let config = &context.config;
        let gateway = &config.launch.gateway;
        let mask = gateway.export.iter().filter_map(|topic| index_of(topic)).fold(0, |mask, index| mask | 1 << index);
        // Dense topics are polled first. A sparse message is published before the dense messages of
        // its tick, so it has arrived by the time the sparse topics are polled.
        let dense = topics_in(mask).filter(|(_, topic)| topic.is_dense);
        let order = dense.chain(topics_in(mask).filter(|(_, topic)| !topic.is_dense));
        let sources: Vec<_> =
            order.filter_map(|(index, topic)| source(context, index, topic.topic)).collect::<Result<_, _>>()?;
        let merge = match config.resume {
            None => Merge::new(mask, config.lateness_ticks()),
            Some(_) => {
                let backlog_end = sources.iter().map(|source| source.next_tick(context)).max().unwrap_or(0);
                Merge::with_unknown_start(mask, config.lateness_ticks(), backlog_end)
            }
        };
        let run = config.run_id();
        let topics = topics_in(mask).map(|(_, topic)| (topic.name.to_owned(), topic.fingerprint)).collect();
        let vehicle = gateway.vehicle.as_ref().unwrap_or(&config.launch.name);
        let state = ExportState {
            cache: Mutex::new(Cache::new(((gateway.cache_s * config.rate_hz) as usize).min(MAX_CACHE_TICKS))),
            grown: Condvar::new(),
            header: FrameHeader { run, rate_hz: config.rate_hz, topics, oldest_tick: 0, next_tick: 0, first_tick: 0 },
            key: keys::key(vehicle, keys::CARRY),
        };
        Ok(Self {
            sources,
            merge,
            progress: ProgressCheckpoints::open(context)?,
            run,
            next_tick: 0,
            state: Arc::new(state),
        })
    }

    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        for source in &mut self.sources {
            source.poll(&mut self.merge)?;
        }
        let before = self.next_tick;
        let mut cache = locked(&self.state.cache);
        while let Some(record) = self.merge.next_record() {
            self.next_tick = record.tick + 1;
            cache.push(record);
        }
        drop(cache);
        if self.next_tick != before {
            self.state.grown.notify_one();
        }
        self.progress.publish(context, self.next_tick, self.run)
    }

    /// Waits up to `limit` for a message on the topic that the next record needs.
    pub(crate) fn wait(&self, limit: Duration) {
        let awaited =
            self.merge.awaited_topic().and_then(|index| self.sources.iter().find(|source| source.index() == index));
        match awaited {
            Some(source) => source.wait(limit),
            None => thread::sleep(limit),
        }
    }
}

impl ExportState {
    /// Starts the thread that sends new records and responds to queries until the gateway stops.
    pub(crate) fn spawn(self: &Arc<Self>, link: &Link, shared: Arc<Shared>) -> Result<JoinHandle<()>, LinkError> {
        let outlet = link.raw_publisher(&self.key)?;
        let workers = WorkerPool::new(&shared.rejected_queries);
        let state = self.clone();
        let queryable = link.handle_queries(&self.key, move |query| {
            let state = state.clone();
            workers.spawn(query, move |query| state.answer(query));
        })?;
        let state = self.clone();
        Ok(thread::spawn(move || {
            let _queryable = queryable;
            let mut sent_tick = 0;
            loop {
                let is_stopping = shared.is_stopping();
                let Some((bytes, next_tick)) = state.next_frame(sent_tick) else {
                    if is_stopping {
                        break;
                    }
                    continue;
                };
                // If a frame cannot be sent, the importer requests its ticks later.
                let _ = outlet.send(&bytes);
                sent_tick = next_tick;
            }
        }))
    }

    /// Waits for new records and encodes them. Returns `None` if no record arrives in time.
    fn next_frame(&self, sent_tick: u64) -> Option<(Vec<u8>, u64)> {
        let is_idle = |cache: &mut Cache| cache.next_tick().is_none_or(|next_tick| next_tick <= sent_tick);
        let grown = self.grown.wait_timeout_while(locked(&self.cache), POLL_INTERVAL, is_idle);
        let (mut cache, _) = grown.unwrap_or_else(PoisonError::into_inner);
        (!is_idle(&mut cache)).then(|| self.frame(&cache, sent_tick, u64::MAX)).flatten()
    }

    /// Replies with the requested records that are cached. If none of them is cached, replies with
    /// an empty frame that reports the range of the cache.
    fn answer(&self, query: &IncomingQuery) {
        let (Some(from), Some(to)) = (query.parameter_u64("from"), query.parameter_u64("to")) else {
            return query.reject("missing tick range: query with ?from=TICK;to=TICK");
        };
        let mut tick = from;
        for _ in 0..MAX_FRAMES_PER_REPLY {
            let Some((bytes, next_tick)) = self.frame(&locked(&self.cache), tick, to) else { return };
            query.reply_raw(&self.key, bytes);
            if next_tick >= to || next_tick <= tick {
                return;
            }
            tick = next_tick;
        }
    }

    /// Encodes as many cached records of a tick range as fit into a frame.
    fn frame(&self, cache: &Cache, from_tick: u64, to_tick: u64) -> Option<(Vec<u8>, u64)> {
        let (oldest_tick, next_tick) = (cache.oldest_tick()?, cache.next_tick()?);
        let first_tick = from_tick.clamp(oldest_tick, next_tick);
        let header = FrameHeader { oldest_tick, next_tick, first_tick, ..self.header.clone() };
        Some(Frame::encode(&header, cache.iter_from(first_tick).take_while(|record| record.tick < to_tick)))
    }
}

/// Exported bus topic.
trait Source {
    fn poll(&mut self, merge: &mut Merge) -> Result<(), RuntimeError>;
    fn index(&self) -> usize;
    fn wait(&self, limit: Duration);
    fn next_tick(&self, context: &ServiceContext) -> u64;
}

fn source(context: &ServiceContext, index: usize, topic: Topic) -> Option<Result<Box<dyn Source>, RuntimeError>> {
    messages::dispatch!(topic,
        ticked M => Some(match topic.entry().presence {
            Presence::EveryTick => dense::<M>(context, index),
            Presence::Flagged(_) | Presence::NoTick => sparse::<M>(context, index),
        }),
        other M => None
    )
}

/// Creates a source of a dense topic. It yields each tick once and in order, even if the owner of
/// the slot changes.
fn dense<M: Ticked>(context: &ServiceContext, index: usize) -> Result<Box<dyn Source>, RuntimeError> {
    let lateness_ticks = context.config.lateness_ticks() / 2;
    let reorder_buffer: ReorderBuffer<M> = match context.config.resume {
        None => ReorderBuffer::new(0, FIRST_EPOCH, lateness_ticks),
        Some(_) => ReorderBuffer::with_unknown_start(FIRST_EPOCH, lateness_ticks),
    };
    Tap::<M>::open(context, index, Some(reorder_buffer))
}

/// Creates a source of a sparse topic, which has a single publisher.
fn sparse<M: Ticked>(context: &ServiceContext, index: usize) -> Result<Box<dyn Source>, RuntimeError> {
    Tap::<M>::open(context, index, None)
}

struct Tap<M: Ticked> {
    index: usize,
    subscriber: Subscriber<M>,
    buffer: usize,
    reorder_buffer: Option<ReorderBuffer<M>>,
}

impl<M: Ticked> Tap<M> {
    fn open(
        context: &ServiceContext,
        index: usize,
        reorder_buffer: Option<ReorderBuffer<M>>,
    ) -> Result<Box<dyn Source>, RuntimeError> {
        let buffer = context.config.buffer_ticks();
        // In a restarted gateway the subscriber also receives the messages that the topic still
        // holds, which refill the cache.
        Ok(Box::new(Self { index, subscriber: context.subscriber()?, buffer, reorder_buffer }))
    }
}

impl<M: Ticked> Source for Tap<M> {
    fn poll(&mut self, merge: &mut Merge) -> Result<(), RuntimeError> {
        let Self { index, subscriber, buffer, reorder_buffer } = self;
        let mut offer = |message: M| {
            let header = message.header();
            merge.offer(*index, header.tick, header.flags, bytemuck::bytes_of(&message));
        };
        Ok(subscriber.drain(*buffer, |message| match reorder_buffer {
            Some(reorder_buffer) => reorder_buffer.offer(message, &mut |message, _| offer(message)),
            None => offer(message),
        })?)
    }

    fn index(&self) -> usize {
        self.index
    }

    fn wait(&self, limit: Duration) {
        // The result is ignored, because the caller polls in either case.
        self.subscriber.wait(limit);
    }

    fn next_tick(&self, context: &ServiceContext) -> u64 {
        context.bus.next_tick(M::TOPIC)
    }
}
