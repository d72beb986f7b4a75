//! Importing side: from the network to the bus, in tick order.

use std::{
    ops::Range,
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use bus::{BusError, Publisher, Subscriber};
use control::ControlRequest;
use graph::Topic;
use launch::Service;
use link::{Link, LinkError, MessageStream};
use messages::{Credit, Ticked};
use runtime::{
    RuntimeError, ServiceContext,
    service_config::{CONTROL_BUFFER, Resume},
};
use wire::{DecodeError, keys};

use super::{
    frame::Frame,
    losses::LossLog,
    progress::ProgressCheckpoints,
    reassembly::{Delivery, Reassembly},
    record::{CARRIED_TOPICS, Record, index_of},
};
use crate::{
    locked::locked,
    shared::{Shared, notify_supervisor},
};

/// Longest wait for a frame.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Time without a frame after which the importer requests all ticks that it has not delivered yet.
const SILENCE_TIMEOUT: Duration = Duration::from_millis(500);
/// Minimum interval between two requests for missing ticks.
const REQUEST_INTERVAL: Duration = Duration::from_millis(100);
/// Time to wait for a reply.
const REPLY_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum number of frames processed between two checks for missing ticks.
const MAX_FRAMES_PER_POLL: usize = 256;
/// Time without credit after which ticks are published anyway. It limits the time for which a
/// stalled slot blocks the other slots.
const CREDIT_TIMEOUT: Duration = Duration::from_secs(5);

/// Minimum interval between reports of lost ticks.
const LOSS_REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Bus side of an import, which publishes the ticks on the local bus.
pub(crate) struct Import {
    publishers: Vec<Option<Box<dyn TopicPublisher>>>,
    credit: Subscriber<Credit>,
    /// Tick up to which the local slots grant credit; `None` until every slot has opened its
    /// topics.
    granted_tick: Option<u64>,
    window_ticks: u64,
    /// Publication ends before this tick. `None` until the end of the system has been requested.
    end_tick: Option<u64>,
    /// Start of a window of ticks that may be published without credit. After a loss or a timeout,
    /// the window starts at the next tick to be published.
    floor_tick: u64,
    /// Last time at which publication made progress or was not limited by credit.
    blocked_since: Instant,
    progress: ProgressCheckpoints,
    pub(crate) next_tick: u64,
    pub(crate) lost: u64,
    losses: LossLog,
    losses_reported: Instant,
    shared: Arc<Shared>,
    pub(crate) state: Arc<ImportState>,
}

/// State shared by the bus side ([`Import`]) and the network side, which runs in its own thread.
#[derive(Debug)]
pub(crate) struct ImportState {
    reassembly: Mutex<Reassembly>,
    arrived: Condvar,
    key: String,
}

impl Import {
    pub(crate) fn open(
        context: &ServiceContext,
        shared: Arc<Shared>,
        import: &launch::Import,
    ) -> Result<Self, RuntimeError> {
        let config = &context.config;
        let checkpoint = config.resume.as_ref().and_then(Resume::checkpoint);
        let (next_tick, run) =
            checkpoint.map_or((0, None), |checkpoint| (checkpoint.next_tick, Some(checkpoint.words[0])));
        let mask = import.topics.iter().filter_map(|topic| index_of(topic)).fold(0, |mask, index| mask | 1 << index);
        let end_tick = config.max_ticks.unwrap_or(u64::MAX);
        let reassembly = Reassembly::new(mask, config.rate_hz, run, next_tick, end_tick);
        let publishers = CARRIED_TOPICS.iter().enumerate();
        let publishers = publishers
            .map(|(index, topic)| (mask & (1 << index) != 0).then(|| publisher(context, topic.topic)).flatten());
        Ok(Self {
            publishers: publishers.map(Option::transpose).collect::<Result<_, _>>()?,
            credit: context.bus.late_subscriber(CONTROL_BUFFER)?,
            granted_tick: None,
            end_tick: None,
            window_ticks: config.window_ticks(),
            floor_tick: next_tick,
            blocked_since: Instant::now(),
            progress: ProgressCheckpoints::open(context)?,
            next_tick,
            lost: 0,
            losses: LossLog::default(),
            losses_reported: Instant::now(),
            shared,
            state: Arc::new(ImportState {
                reassembly: Mutex::new(reassembly),
                arrived: Condvar::new(),
                key: keys::key(&import.vehicle, keys::CARRY),
            }),
        })
    }

    /// Publishes available ticks as far as the local slots grant credit.
    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        for publisher in self.publishers.iter().flatten() {
            publisher.deliver_history()?;
        }
        let Self { credit, granted_tick, end_tick, publishers, .. } = self;
        credit.drain(CONTROL_BUFFER, |credit| {
            *granted_tick = (*granted_tick).max(Some(credit.ticks));
            let published = || publishers.iter().flatten().map(|publisher| publisher.next_tick()).max().unwrap_or(0);
            *end_tick = end_tick.or_else(|| (credit.ends != 0).then(published));
        })?;
        let before = self.next_tick;
        while self.next_tick < self.publish_end() {
            let Some(delivery) = locked(&self.state.reassembly).next_delivery() else { break };
            match delivery {
                Delivery::Record(record) => self.publish(&record)?,
                Delivery::Lost(span) => self.record_loss(span),
            }
        }
        if self.next_tick < self.publish_end() || self.next_tick != before {
            self.blocked_since = Instant::now();
        } else if self.blocked_since.elapsed() > CREDIT_TIMEOUT {
            self.floor_tick = self.next_tick;
        }
        if self.next_tick != before {
            self.publishers.iter().flatten().for_each(|publisher| publisher.wake());
        }
        if self.losses_reported.elapsed() > LOSS_REPORT_INTERVAL
            && let Some(line) = self.losses.take_summary(self.lost)
        {
            self.losses_reported = Instant::now();
            notify_supervisor(
                self.shared.clone(),
                ControlRequest::Announce { service: Service::Gateway.name().into(), line },
            );
        }
        let run = locked(&self.state.reassembly).run();
        run.map_or(Ok(()), |run| self.progress.publish(context, self.next_tick, run))
    }

    fn publish(&mut self, record: &Record) -> Result<(), BusError> {
        for (index, message) in record.messages() {
            if let Some(Some(publisher)) = self.publishers.get(index) {
                publisher.publish(message)?;
            }
        }
        self.next_tick = record.tick + 1;
        Ok(())
    }

    fn record_loss(&mut self, span: Range<u64>) {
        self.lost += span.end - span.start;
        (self.next_tick, self.floor_tick) = (span.end, span.end);
        self.losses.add(span);
    }

    /// Returns the tick before which ticks may be published.
    ///
    /// After a link outage, more ticks may be available than a topic buffers. Publication is
    /// therefore limited by the credit of the local slots, unless they have stalled.
    fn publish_end(&self) -> u64 {
        let granted = |granted_tick: u64| granted_tick.max(self.floor_tick.saturating_add(self.window_ticks));
        self.granted_tick.map_or(0, granted).min(self.end_tick.unwrap_or(u64::MAX))
    }

    /// Returns `true` if nothing more will be published.
    pub(crate) fn is_finished(&self) -> bool {
        self.end_tick.is_some_and(|end_tick| self.next_tick >= end_tick) || self.state.is_complete()
    }
}

impl ImportState {
    /// Returns `true` if all ticks have been delivered.
    pub(crate) fn is_complete(&self) -> bool {
        locked(&self.reassembly).is_complete()
    }

    /// Waits up to `limit` until a tick can be published or is lost.
    pub(crate) fn wait(&self, limit: Duration) {
        // The outcome is ignored, because the caller polls in either case.
        let arrived =
            self.arrived.wait_timeout_while(locked(&self.reassembly), limit, |reassembly| !reassembly.is_ready());
        drop(arrived.unwrap_or_else(PoisonError::into_inner));
    }

    /// Starts the thread that receives frames and requests missing ticks until the gateway stops.
    pub(crate) fn spawn(self: &Arc<Self>, link: Link, shared: Arc<Shared>) -> Result<JoinHandle<()>, LinkError> {
        let (stream, state) = (link.subscribe(&self.key)?, self.clone());
        Ok(thread::spawn(move || {
            state.receive(&stream, &link, &shared);
            link.close();
        }))
    }

    fn receive(&self, stream: &MessageStream, link: &Link, shared: &Arc<Shared>) {
        let (mut last_received, mut last_request) = (Instant::now(), Instant::now());
        let mut last_error = None;
        while !shared.is_stopping() {
            let mut limit = POLL_INTERVAL;
            for _ in 0..MAX_FRAMES_PER_POLL {
                let Some(arrival) = stream.next(limit) else { break };
                (last_received, limit) = (Instant::now(), Duration::ZERO);
                self.handle_frame(&arrival.bytes, shared, &mut last_error);
            }
            let (missing, next_tick) = {
                let reassembly = locked(&self.reassembly);
                (reassembly.missing(), reassembly.next_tick())
            };
            let all_newer = (last_received.elapsed() > SILENCE_TIMEOUT).then_some(next_tick..u64::MAX);
            let Some(span) = missing.or(all_newer).filter(|_| last_request.elapsed() > REQUEST_INTERVAL) else {
                continue;
            };
            last_request = Instant::now();
            let selector = format!("{}?from={};to={}", self.key, span.start, span.end);
            // A failed request is repeated after `REQUEST_INTERVAL`.
            for (_, bytes) in link.query(&selector, Vec::new(), REPLY_TIMEOUT).unwrap_or_default() {
                last_received = Instant::now();
                self.handle_frame(&bytes, shared, &mut last_error);
            }
        }
    }

    /// Processes a frame. An error is counted, and is announced if it differs from the previous
    /// one.
    fn handle_frame(&self, bytes: &[u8], shared: &Arc<Shared>, last_error: &mut Option<String>) {
        let rejected = match Frame::decode(bytes) {
            Ok(frame) => locked(&self.reassembly).offer(frame).err().map(|error| error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        self.arrived.notify_one();
        let Some(error) = rejected else { return };
        locked(&shared.decode_errors).count(&DecodeError::Malformed { message: "frame", cause: error.clone() });
        if last_error.as_ref() != Some(&error) {
            notify_supervisor(
                shared.clone(),
                ControlRequest::Announce { service: Service::Gateway.name().into(), line: error.clone() },
            );
            *last_error = Some(error);
        }
    }
}

/// Publisher of an imported topic on the bus.
trait TopicPublisher {
    fn publish(&self, message: &[u8]) -> Result<(), BusError>;
    fn next_tick(&self) -> u64;
    fn deliver_history(&self) -> Result<(), BusError>;
    fn wake(&self);
}

fn publisher(context: &ServiceContext, topic: Topic) -> Option<Result<Box<dyn TopicPublisher>, RuntimeError>> {
    messages::dispatch!(topic,
        ticked M => Some(context.publisher::<M>().map(|publisher| Box::new(publisher) as Box<dyn TopicPublisher>)),
        other M => None
    )
}

impl<M: Ticked> TopicPublisher for Publisher<M> {
    fn publish(&self, message: &[u8]) -> Result<(), BusError> {
        // The size of the message was checked when the frame was decoded, so the conversion cannot
        // fail.
        let Ok(message) = bytemuck::try_pod_read_unaligned::<M>(message) else { return Ok(()) };
        self.set_next_tick_after(message.header().tick);
        self.send(&message)
    }

    fn next_tick(&self) -> u64 {
        Self::next_tick(self)
    }

    fn deliver_history(&self) -> Result<(), BusError> {
        Self::deliver_history(self)
    }

    fn wake(&self) {
        Self::wake(self);
    }
}
