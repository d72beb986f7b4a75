//! Connection of the supervisor to the bus: its topics, its control socket and the reaper.

use std::time::Duration;

use bus::{Bus, IdleWaker, Publisher, SharedMemory, Subscriber, SystemName};
use control::ControlSocket;
use launch::Service;
use messages::{AttitudeOutput, Checkpoint, Control, Credit, Difference, FusedState, Health, Reference, SystemEvent};
use pipeline::Collector;
use runtime::{OrderedSubscriber, ServiceConfig, SlotInput, service_config::CONTROL_BUFFER};
use supervision::Event;

use super::recorded_topics::RecordedTopics;
use crate::{error::UpError, input::InputTopics, processes::Exit, reaper::StaleNodeReaper};

/// Minimum free shared memory for publishing an event, in bytes. This is more than the topic
/// `event` occupies.
const EVENTS_BYTES: u64 = 1 << 20;

pub(super) struct BusConnection {
    pub(super) socket: ControlSocket,
    pub(super) reaper: StaleNodeReaper,
    attitude: OrderedSubscriber<AttitudeOutput>,
    /// Fused states, for the columns of the output file that only these messages provide.
    fused: Option<OrderedSubscriber<FusedState>>,
    reference: Subscriber<Reference>,
    health: Subscriber<Health>,
    checkpoints: Subscriber<Checkpoint>,
    /// Differences published by shadows; `None` if the launch file has no watch.
    differences: Option<Subscriber<Difference>>,
    credit: Publisher<Credit>,
    control: Publisher<Control>,
    events: Publisher<SystemEvent>,
    /// All topics for the recorder, if there is one.
    pub(super) recorded: Option<RecordedTopics>,
    /// Topics of the input check; `None` once the check is finished, or if another host runs it.
    pub(super) input: Option<InputTopics>,
    buffer: usize,
    idle_waker: IdleWaker,
    bus: Bus,
}

/// Optional subscriptions of the supervisor.
#[derive(Debug, Clone, Copy)]
pub(super) struct OptionalInputs {
    /// `true` to subscribe to the fused state of each tick, for the output file.
    pub(super) fused: bool,
    /// `true` to subscribe to every topic, for a recorder.
    pub(super) every_topic: bool,
    /// `true` to subscribe to samples and magnetic fields, for the input check.
    pub(super) input: bool,
}

impl BusConnection {
    /// Connects to the bus. The first attitude expected is that of tick `next_tick`.
    pub(super) fn open(
        system_name: &SystemName,
        config: &ServiceConfig,
        next_tick: u64,
        optional: OptionalInputs,
    ) -> Result<Self, UpError> {
        let bus = Bus::join(system_name, "supervisor")?;
        let buffer = config.buffer_ticks();
        let has_watches = !config.launch.watch.is_empty();
        Ok(Self {
            attitude: OrderedSubscriber::new(bus.subscriber(buffer)?, next_tick, config),
            fused: match optional.fused {
                true => Some(OrderedSubscriber::new(bus.subscriber(buffer)?, next_tick, config)),
                false => None,
            },
            reference: bus.subscriber(buffer)?,
            health: bus.subscriber(CONTROL_BUFFER)?,
            checkpoints: bus.subscriber(CONTROL_BUFFER)?,
            differences: has_watches.then(|| bus.subscriber(CONTROL_BUFFER)).transpose()?,
            credit: bus.publisher(CONTROL_BUFFER)?,
            control: bus.publisher(CONTROL_BUFFER)?,
            events: bus.publisher(CONTROL_BUFFER)?,
            recorded: optional.every_topic.then(|| RecordedTopics::open(&bus, config)).transpose()?,
            input: if optional.input { InputTopics::open(&bus, config)? } else { None },
            socket: ControlSocket::open(system_name)?,
            reaper: StaleNodeReaper::new(system_name.clone())?,
            buffer,
            idle_waker: bus.idle_waker(),
            bus,
        })
    }

    /// Collects the attitudes received.
    pub(super) fn collect(&self, collector: &mut Collector) -> Result<(), UpError> {
        let collect_references = |collector: &mut Collector| {
            self.reference.drain(self.buffer, |reference| collector.record_reference(reference))
        };
        let mut result = collect_references(collector);
        // Each attitude is recorded as soon as it is read. Attitudes are not gathered first,
        // because a full topic buffer of attitudes may be waiting after an outage.
        self.attitude.drain(self.buffer, &mut |output: AttitudeOutput| {
            // A reference attitude is published before the estimated attitude of its tick, so the
            // reference has arrived.
            if result.is_ok() && collector.awaits_reference(output.header.tick) {
                result = collect_references(collector);
            }
            collector.record_attitude(&output);
        })?;
        // Each fused state was published before its attitude.
        if let Some(fused) = &self.fused {
            fused.drain(self.buffer, &mut |state| collector.record_fused(&state))?;
        }
        Ok(result?)
    }

    /// Collects the attitudes that were waiting for missing ticks, because those ticks will no
    /// longer arrive.
    pub(super) fn finish(&self, collector: &mut Collector) {
        self.attitude.finish(&mut |output| collector.record_attitude(&output));
        self.fused.iter().for_each(|fused| fused.finish(&mut |state| collector.record_fused(&state)));
    }

    /// Returns the messages of the services, and the tick after the newest one published by each
    /// service of the data path.
    pub(super) fn poll_events(&mut self) -> Result<Vec<Event>, UpError> {
        let mut events = Vec::new();
        // Subscribers that have connected late receive the earlier messages.
        self.credit.deliver_history()?;
        self.control.deliver_history()?;
        let limit = CONTROL_BUFFER * Service::ALL.len();
        self.health.drain(limit, |health| events.push(Event::Health(health)))?;
        self.checkpoints.drain(limit, |checkpoint| events.push(Event::Checkpoint(Box::new(checkpoint))))?;
        if let Some(differences) = &self.differences {
            differences.drain(CONTROL_BUFFER, |difference| events.push(Event::Difference(difference)))?;
        }
        let published = Service::PATH.map(|service| Event::Published { service, next_tick: self.published(service) });
        events.extend(published);
        Ok(events)
    }

    /// Returns the tick after the newest one published by a service.
    pub(super) fn published(&self, service: Service) -> u64 {
        service.output().map_or(0, |topic| self.bus.next_tick(topic.entry()))
    }

    /// Publishes an ownership decision. A decision that is not delivered is not confirmed, and is
    /// therefore reverted.
    pub(super) fn publish_control(&self, control: &Control) {
        let _ = self.control.send(control);
    }

    /// Publishes an event, unless the shared memory is nearly full.
    ///
    /// Access to memory that cannot be allocated would kill the supervisor. A gap in the event
    /// numbers reveals the omission.
    pub(super) fn publish_event(&self, event: &SystemEvent) {
        if SharedMemory::query().is_none_or(|memory| memory.free_bytes >= EVENTS_BYTES) {
            let _ = self.events.send(event);
        }
    }

    pub(super) fn publish_credit(&self, credit: Credit) -> Result<(), UpError> {
        self.credit.send(&credit)?;
        self.credit.wake();
        Ok(())
    }

    /// Wakes the services that have waited since the previous call, so that they report their
    /// health and check all inputs.
    pub(super) fn wake_idle(&mut self) {
        self.idle_waker.wake();
    }

    /// Wakes all services, because a process that has exited may not have woken its subscribers.
    pub(super) fn wake_after_exit(&self) {
        self.idle_waker.wake_after_exit();
    }

    /// Sleeps until an attitude arrives, for at most `timeout`.
    pub(super) fn wait(&self, timeout: Duration) {
        SlotInput::<AttitudeOutput>::wait(&self.attitude, Some(timeout));
    }
}

impl From<Exit> for Event {
    fn from(exit: Exit) -> Self {
        let Exit { incarnation, exit_status, stderr } = exit;
        Self::Exited { incarnation, exit_status, stderr }
    }
}
