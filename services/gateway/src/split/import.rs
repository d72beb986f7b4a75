//! The importing end: from the network, in the order of ticks, to the bus.

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
use link::{Link, LinkError, Stream};
use messages::{Credit, Ticked};
use runtime::{
    RuntimeError, ServiceContext,
    service_config::{BUFFER_BESIDE, Resume},
};
use wire::{Refusal, keys};

use super::{
    Notes,
    arrivals::{Arrivals, Turn},
    frame::Frame,
    losses::Losses,
    record::{CARRIED_TOPICS, Record, place},
};
use crate::{Shared, locked, notify_supervisor};

/// Longest wait for a frame.
const TURN_LIMIT: Duration = Duration::from_millis(50);
/// Without a frame for so long one asks whether there are any.
const SILENCE: Duration = Duration::from_millis(500);
/// From one question to the next.
const ASK_INTERVAL: Duration = Duration::from_millis(100);
/// For how long an answer is waited for.
const ANSWER_LIMIT: Duration = Duration::from_secs(2);
/// Frames taken before one looks whether something is missing.
const FRAMES_MAX: usize = 256;
/// Slots here that stand still hold up the others for so long.
const HOLD_LIMIT: Duration = Duration::from_secs(5);

/// Between two lines for people about what was lost.
const TELL_INTERVAL: Duration = Duration::from_secs(1);

/// The bus's side.
pub(crate) struct Import {
    outlets: Vec<Option<Box<dyn Outlet>>>,
    credit: Subscriber<Credit>,
    /// How far the slots here can take ticks; `None` until each has opened its topics.
    granted_tick: Option<u64>,
    window_ticks: u64,
    /// The system is to end: ticks from this one on are not published.
    end_tick: Option<u64>,
    /// A window from here on needs no leave: nothing before it is to come.
    floor_tick: u64,
    /// Since when nothing could be published for want of leave.
    held_since: Instant,
    notes: Notes,
    pub(crate) next_tick: u64,
    pub(crate) lost: u64,
    losses: Losses,
    told: Instant,
    shared: Arc<Shared>,
    pub(crate) intake: Arc<Intake>,
}

/// What both sides know.
#[derive(Debug)]
pub(crate) struct Intake {
    arrivals: Mutex<Arrivals>,
    come: Condvar,
    key: String,
}

impl Import {
    pub(crate) fn open(
        context: &ServiceContext,
        shared: Arc<Shared>,
        import: &launch::Import,
    ) -> Result<Self, RuntimeError> {
        let config = &context.config;
        let earlier = match &config.resume {
            Some(Resume::Checkpoint(record)) => record.checkpoint(),
            _ => None,
        };
        let (next_tick, run) = earlier.map_or((0, None), |earlier| (earlier.next_tick, Some(earlier.words[0])));
        let mask = import.topics.iter().filter_map(|topic| place(topic)).fold(0, |mask, place| mask | 1 << place);
        let end_tick = config.ticks_max.unwrap_or(u64::MAX);
        let arrivals = Arrivals::new(mask, config.rate_hz, run, next_tick, end_tick);
        let outlets = CARRIED_TOPICS.iter().enumerate();
        let outlets =
            outlets.map(|(place, topic)| (mask & (1 << place) != 0).then(|| outlet(context, topic.topic)).flatten());
        Ok(Self {
            outlets: outlets.map(Option::transpose).collect::<Result<_, _>>()?,
            credit: context.bus.late_subscriber(BUFFER_BESIDE)?,
            granted_tick: None,
            end_tick: None,
            window_ticks: config.window_ticks(),
            floor_tick: next_tick,
            held_since: Instant::now(),
            notes: Notes::open(context)?,
            next_tick,
            lost: 0,
            losses: Losses::default(),
            told: Instant::now(),
            shared,
            intake: Arc::new(Intake {
                arrivals: Mutex::new(arrivals),
                come: Condvar::new(),
                key: keys::key(&import.vehicle, keys::CARRY),
            }),
        })
    }

    /// Publishes what has its turn, no further than the slots here can take it.
    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        for outlet in self.outlets.iter().flatten() {
            outlet.deliver_history()?;
        }
        let Self { credit, granted_tick, end_tick, outlets, .. } = self;
        credit.drain(BUFFER_BESIDE, |credit| {
            *granted_tick = (*granted_tick).max(Some(credit.ticks));
            let published = || outlets.iter().flatten().map(|outlet| outlet.next_tick()).max().unwrap_or(0);
            *end_tick = end_tick.or_else(|| (credit.ends != 0).then(published));
        })?;
        let before = self.next_tick;
        while self.next_tick < self.limit_tick() {
            let Some(turn) = locked(&self.intake.arrivals).take() else { break };
            match turn {
                Turn::Record(record) => self.publish(&record)?,
                Turn::Lost(span) => self.lose(span),
            }
        }
        if self.next_tick < self.limit_tick() || self.next_tick != before {
            self.held_since = Instant::now();
        } else if self.held_since.elapsed() > HOLD_LIMIT {
            self.floor_tick = self.next_tick;
        }
        if self.next_tick != before {
            self.outlets.iter().flatten().for_each(|outlet| outlet.wake());
        }
        if self.told.elapsed() > TELL_INTERVAL
            && let Some(what) = self.losses.take_line(self.lost)
        {
            self.told = Instant::now();
            notify_supervisor(
                self.shared.clone(),
                ControlRequest::Tell { service: Service::Gateway.name().into(), what },
            );
        }
        let run = locked(&self.intake.arrivals).run();
        run.map_or(Ok(()), |run| self.notes.publish(context, self.next_tick, run))
    }

    fn publish(&mut self, record: &Record) -> Result<(), BusError> {
        for (place, message) in record.messages() {
            if let Some(Some(outlet)) = self.outlets.get(place) {
                outlet.publish(message)?;
            }
        }
        self.next_tick = record.tick + 1;
        Ok(())
    }

    fn lose(&mut self, span: Range<u64>) {
        self.lost += span.end - span.start;
        (self.next_tick, self.floor_tick) = (span.end, span.end);
        self.losses.add(span);
    }

    /// After a cut more comes at once than a topic holds: the slots here give leave, unless they stand still.
    fn limit_tick(&self) -> u64 {
        let granted = |granted_tick: u64| granted_tick.max(self.floor_tick.saturating_add(self.window_ticks));
        self.granted_tick.map_or(0, granted).min(self.end_tick.unwrap_or(u64::MAX))
    }

    /// Nothing more is published.
    pub(crate) fn is_finished(&self) -> bool {
        self.end_tick.is_some_and(|end_tick| self.next_tick >= end_tick) || self.intake.is_whole()
    }
}

impl Intake {
    /// Nothing more is wanted.
    pub(crate) fn is_whole(&self) -> bool {
        locked(&self.arrivals).is_whole()
    }

    /// Sleeps until something has its turn, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        // Whether something came or not, the caller looks.
        let come = self.come.wait_timeout_while(locked(&self.arrivals), limit, |arrivals| !arrivals.is_ready());
        drop(come.unwrap_or_else(PoisonError::into_inner));
    }

    /// Takes frames and asks for what is missing, until the gateway ends.
    pub(crate) fn carry(self: &Arc<Self>, link: Link, shared: Arc<Shared>) -> Result<JoinHandle<()>, LinkError> {
        let (stream, intake) = (link.stream(&self.key)?, self.clone());
        Ok(thread::spawn(move || {
            intake.receive(&stream, &link, &shared);
            link.close();
        }))
    }

    fn receive(&self, stream: &Stream, link: &Link, shared: &Arc<Shared>) {
        let (mut heard, mut asked) = (Instant::now(), Instant::now());
        let mut complaint = None;
        while !shared.ends() {
            let mut limit = TURN_LIMIT;
            for _ in 0..FRAMES_MAX {
                let Some(arrival) = stream.next(limit) else { break };
                (heard, limit) = (Instant::now(), Duration::ZERO);
                self.take(&arrival.bytes, shared, &mut complaint);
            }
            let (missing, next_tick) = {
                let arrivals = locked(&self.arrivals);
                (arrivals.missing(), arrivals.next_tick())
            };
            let silent = (heard.elapsed() > SILENCE).then_some(next_tick..u64::MAX);
            let Some(span) = missing.or(silent).filter(|_| asked.elapsed() > ASK_INTERVAL) else { continue };
            asked = Instant::now();
            let question = format!("{}?from={};to={}", self.key, span.start, span.end);
            // No answer is as good as an error: it is asked again.
            for (_, bytes) in link.ask(&question, Vec::new(), ANSWER_LIMIT).unwrap_or_default() {
                heard = Instant::now();
                self.take(&bytes, shared, &mut complaint);
            }
        }
    }

    /// Takes a frame; what is wrong with it is counted, and said when it is something new.
    fn take(&self, bytes: &[u8], shared: &Arc<Shared>, complaint: &mut Option<String>) {
        let refused = match Frame::decode(bytes) {
            Ok(frame) => locked(&self.arrivals).offer(frame).err().map(|error| error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        self.come.notify_one();
        let Some(what) = refused else { return };
        locked(&shared.refusals).count(&Refusal::Malformed { message: "frame", cause: what.clone() });
        if complaint.as_ref() != Some(&what) {
            notify_supervisor(
                shared.clone(),
                ControlRequest::Tell { service: Service::Gateway.name().into(), what: what.clone() },
            );
            *complaint = Some(what);
        }
    }
}

/// A topic of the bus.
trait Outlet {
    fn publish(&self, message: &[u8]) -> Result<(), BusError>;
    fn next_tick(&self) -> u64;
    fn deliver_history(&self) -> Result<(), BusError>;
    fn wake(&self);
}

fn outlet(context: &ServiceContext, topic: Topic) -> Option<Result<Box<dyn Outlet>, RuntimeError>> {
    messages::dispatch!(topic,
        ticked M => Some(context.publisher::<M>().map(|publisher| Box::new(publisher) as Box<dyn Outlet>)),
        other M => None
    )
}

impl<M: Ticked> Outlet for Publisher<M> {
    fn publish(&self, message: &[u8]) -> Result<(), BusError> {
        // Its length was that of the topic when the frame was read.
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
