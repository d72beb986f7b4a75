//! The supervisor's place on the bus: its topics, its control socket, and who clears away what the dead leave.

use std::time::Duration;

use bus::{Bus, Publisher, SharedMemory, Subscriber, SystemName};
use control::ControlSocket;
use launch::Service;
use messages::{AttitudeOutput, Checkpoint, Control, Credit, Difference, FusedState, Health, Reference, SystemEvent};
use pipeline::Collector;
use runtime::{Input, Reader, ServiceConfig, service_config::BUFFER_BESIDE};
use supervision::Event;

use super::recorded::Recorded;
use crate::{UpError, input::InputTopics, processes::Exit, reaper::StaleNodeReaper};

/// More than all events that the topic holds.
const EVENTS_BYTES: u64 = 1 << 20;

pub(super) struct Attached {
    pub(super) socket: ControlSocket,
    pub(super) reaper: StaleNodeReaper,
    attitude: Reader<AttitudeOutput>,
    /// For a file of attitudes that has what only these tell.
    fused: Option<Reader<FusedState>>,
    reference: Subscriber<Reference>,
    health: Subscriber<Health>,
    checkpoints: Subscriber<Checkpoint>,
    /// Where shadows say how far they are, if a watch wants to know.
    differences: Option<Subscriber<Difference>>,
    credit: Publisher<Credit>,
    control: Publisher<Control>,
    events: Publisher<SystemEvent>,
    /// Every topic, where a recorder is there.
    pub(super) recorded: Option<Recorded>,
    /// What is judged, until the verdict.
    pub(super) input: Option<InputTopics>,
    buffer: usize,
    bus: Bus,
}

/// What is read beside what the supervisor needs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reads {
    /// The fused state of each tick, for the file of attitudes.
    pub(super) fused: bool,
    /// Every topic, for a recorder.
    pub(super) every_topic: bool,
    /// Samples and fields, to be judged.
    pub(super) input: bool,
}

impl Attached {
    /// The first attitude to come is that of `next_tick`.
    pub(super) fn open(
        system_name: &SystemName,
        config: &ServiceConfig,
        next_tick: u64,
        reads: Reads,
    ) -> Result<Self, UpError> {
        let bus = Bus::join(system_name, "supervisor")?;
        let buffer = config.buffer_ticks();
        let watched = !config.launch.watch.is_empty();
        Ok(Self {
            attitude: Reader::new(bus.subscriber(buffer)?, next_tick, config),
            fused: match reads.fused {
                true => Some(Reader::new(bus.subscriber(buffer)?, next_tick, config)),
                false => None,
            },
            reference: bus.subscriber(buffer)?,
            health: bus.subscriber(BUFFER_BESIDE)?,
            checkpoints: bus.subscriber(BUFFER_BESIDE)?,
            differences: watched.then(|| bus.subscriber(BUFFER_BESIDE)).transpose()?,
            credit: bus.publisher(BUFFER_BESIDE)?,
            control: bus.publisher(BUFFER_BESIDE)?,
            events: bus.publisher(BUFFER_BESIDE)?,
            recorded: reads.every_topic.then(|| Recorded::open(&bus, config)).transpose()?,
            input: if reads.input { InputTopics::open(&bus, config)? } else { None },
            socket: ControlSocket::open(system_name)?,
            reaper: StaleNodeReaper::new(system_name.clone())?,
            buffer,
            bus,
        })
    }

    /// Takes the attitudes that have come.
    pub(super) fn collect(&self, collector: &mut Collector) -> Result<(), UpError> {
        let take_references =
            |collector: &mut Collector| self.reference.drain(self.buffer, |reference| collector.reference(reference));
        let mut taken = take_references(collector);
        // Each is counted as it is taken, for after an outage there are as many as a topic holds.
        self.attitude.drain(self.buffer, &mut |output: AttitudeOutput| {
            // A reference is published before its tick, so that of this one is there.
            if taken.is_ok() && collector.lacks_reference(output.header.tick) {
                taken = take_references(collector);
            }
            collector.attitude(&output);
        })?;
        // Each was published before the attitude that was made of it.
        if let Some(fused) = &self.fused {
            fused.drain(self.buffer, &mut |state| collector.fused(&state))?;
        }
        Ok(taken?)
    }

    /// Takes what still waits for ticks before it: they do not come any more.
    pub(super) fn finish(&self, collector: &mut Collector) {
        self.attitude.finish(&mut |output| collector.attitude(&output));
        self.fused.iter().for_each(|fused| fused.finish(&mut |state| collector.fused(&state)));
    }

    /// What the services have said, and how far each has published.
    pub(super) fn read(&mut self) -> Result<Vec<Event>, UpError> {
        let mut events = Vec::new();
        // Readers that have come late are handed what was published before.
        self.credit.deliver_history()?;
        self.control.deliver_history()?;
        let limit = BUFFER_BESIDE * Service::ALL.len();
        self.health.drain(limit, |health| events.push(Event::Health(health)))?;
        self.checkpoints.drain(limit, |checkpoint| events.push(Event::Checkpoint(Box::new(checkpoint))))?;
        if let Some(differences) = &self.differences {
            differences.drain(BUFFER_BESIDE, |difference| events.push(Event::Difference(difference)))?;
        }
        let published = Service::PATH.map(|service| Event::Published { service, next_tick: self.published(service) });
        events.extend(published);
        Ok(events)
    }

    /// The tick after the newest one that a service has published.
    pub(super) fn published(&self, service: Service) -> u64 {
        service.output().map_or(0, |topic| self.bus.next_tick(topic.entry()))
    }

    /// A decision that nobody hears is not confirmed, and taken back.
    pub(super) fn publish(&self, control: &Control) {
        let _ = self.control.send(control);
    }

    /// An event that nobody hears is no matter. Where the shared memory is full it is left out: whoever touches a part of it that is not there
    /// yet is ended, and the supervisor has to outlive that. The next one's number tells of it.
    pub(super) fn tell(&self, event: &SystemEvent) {
        if SharedMemory::now().is_none_or(|memory| memory.free >= EVENTS_BYTES) {
            let _ = self.events.send(event);
        }
    }

    pub(super) fn grant(&self, credit: Credit) -> Result<(), UpError> {
        self.credit.send(&credit)?;
        self.credit.wake();
        Ok(())
    }

    /// Sleeps until an attitude comes, no longer than `limit`.
    pub(super) fn wait(&self, limit: Duration) {
        Input::<AttitudeOutput>::wait(&self.attitude, limit);
    }
}

impl From<Exit> for Event {
    fn from(exit: Exit) -> Self {
        let Exit { incarnation, how, stderr } = exit;
        Self::Exited { incarnation, how, stderr }
    }
}
