//! Simulated bus: topics with any number of publishers and subscribers.
//!
//! The simulated bus gives the same guarantees as the real one, and no more. A subscriber has a
//! buffer for each publisher. In a full buffer, the oldest message is overwritten. Messages of one
//! publisher arrive in order, those of different publishers in any order. After a publisher has
//! exited, its buffered messages can still be read, but its history for late subscribers is lost. A
//! late subscriber receives the history of a publisher when that publisher runs next.

use std::collections::VecDeque;

use messages::{
    AccelPoint, AttitudeOutput, Checkpoint, Control, Credit, Difference, FusedState, GnssFix, GyroStep, Health,
    ImuSample, MagSample, Ticked,
};
use runtime::service_config::CONTROL_BUFFER;

use crate::random::Random;

/// Identifier of a subscriber, unique on the bus.
pub(crate) type SubscriberId = u32;

/// Incarnation under which the supervisor publishes and subscribes.
pub(crate) const SUPERVISOR: u32 = 0;

/// All topics of a system.
#[derive(Debug)]
pub(crate) struct Bus {
    pub(crate) imu: Topic<ImuSample>,
    pub(crate) mag: Topic<MagSample>,
    pub(crate) gnss: Topic<GnssFix>,
    pub(crate) gyro: Topic<GyroStep>,
    pub(crate) accel: Topic<AccelPoint>,
    pub(crate) fused: Topic<FusedState>,
    pub(crate) attitude: Topic<AttitudeOutput>,
    pub(crate) health: Topic<Health>,
    pub(crate) checkpoint: Topic<Checkpoint>,
    pub(crate) difference: Topic<Difference>,
    pub(crate) control: Topic<Control>,
    pub(crate) credit: Topic<Credit>,
    last_subscriber: SubscriberId,
}

impl Bus {
    /// Creates a bus. Topics of the data path hold `buffer_ticks` messages per publisher.
    pub(crate) fn new(buffer_ticks: usize) -> Self {
        Self {
            imu: Topic::new(buffer_ticks),
            mag: Topic::new(buffer_ticks),
            gnss: Topic::new(buffer_ticks),
            gyro: Topic::new(buffer_ticks),
            accel: Topic::new(buffer_ticks),
            fused: Topic::new(buffer_ticks),
            attitude: Topic::new(buffer_ticks),
            health: Topic::new(CONTROL_BUFFER),
            checkpoint: Topic::new(CONTROL_BUFFER),
            difference: Topic::new(CONTROL_BUFFER),
            control: Topic::new(CONTROL_BUFFER),
            credit: Topic::new(CONTROL_BUFFER),
            last_subscriber: 0,
        }
    }

    /// Returns the empty bus that a renewal creates. Each topic of the data path continues at its
    /// `next_tick`.
    pub(crate) fn renewed(&self) -> Self {
        let mut bus = Self::new(self.imu.buffer);
        bus.imu.next_tick = self.imu.next_tick;
        bus.gyro.next_tick = self.gyro.next_tick;
        bus.accel.next_tick = self.accel.next_tick;
        bus.fused.next_tick = self.fused.next_tick;
        bus.attitude.next_tick = self.attitude.next_tick;
        bus
    }

    /// Allocates the identifier of a new subscriber.
    pub(crate) fn next_subscriber(&mut self) -> SubscriberId {
        self.last_subscriber += 1;
        self.last_subscriber
    }

    /// Removes the publishers and subscribers of an exited process.
    pub(crate) fn remove_process(&mut self, incarnation: u32) {
        self.imu.remove_process(incarnation);
        self.mag.remove_process(incarnation);
        self.gnss.remove_process(incarnation);
        self.gyro.remove_process(incarnation);
        self.accel.remove_process(incarnation);
        self.fused.remove_process(incarnation);
        self.attitude.remove_process(incarnation);
        self.health.remove_process(incarnation);
        self.checkpoint.remove_process(incarnation);
        self.difference.remove_process(incarnation);
        self.control.remove_process(incarnation);
        self.credit.remove_process(incarnation);
    }
}

/// Topic with messages of one type.
#[derive(Debug)]
pub(crate) struct Topic<M> {
    buffer: usize,
    publishers: Vec<Publisher<M>>,
    subscribers: Vec<Subscriber<M>>,
    /// Number of the next tick to be published: the largest tick that any publisher has started to
    /// publish, plus one.
    pub(crate) next_tick: u64,
    /// Number of messages that were overwritten before they were read.
    pub(crate) overwritten: u64,
}

#[derive(Debug)]
struct Publisher<M> {
    incarnation: u32,
    history: VecDeque<M>,
    connected: Vec<SubscriberId>,
}

#[derive(Debug)]
struct Subscriber<M> {
    id: SubscriberId,
    incarnation: u32,
    /// Set if the subscriber also receives messages that were published before it subscribed.
    wants_history: bool,
    /// Unread messages of each publisher.
    queues: Vec<(u32, VecDeque<M>)>,
}

impl<M: Copy> Topic<M> {
    fn new(buffer: usize) -> Self {
        Self { buffer, publishers: Vec::new(), subscribers: Vec::new(), next_tick: 0, overwritten: 0 }
    }

    /// Adds a publisher.
    pub(crate) fn add_publisher(&mut self, incarnation: u32) {
        let (history, connected) = (VecDeque::new(), self.subscribers.iter().map(|subscriber| subscriber.id).collect());
        self.publishers.push(Publisher { incarnation, history, connected });
    }

    /// Adds a subscriber. If `wants_history` is set, it also receives the history of running
    /// publishers.
    pub(crate) fn subscribe(&mut self, id: SubscriberId, incarnation: u32, wants_history: bool) {
        self.subscribers.push(Subscriber { id, incarnation, wants_history, queues: Vec::new() });
    }

    /// Delivers the history of a publisher to subscribers that have joined since that publisher
    /// last ran.
    pub(crate) fn deliver_history(&mut self, incarnation: u32) {
        let Self { buffer, publishers, subscribers, overwritten, .. } = self;
        let Some(publisher) = publishers.iter_mut().find(|publisher| publisher.incarnation == incarnation) else {
            return;
        };
        for subscriber in subscribers.iter_mut() {
            if !publisher.connected.contains(&subscriber.id) {
                publisher.connected.push(subscriber.id);
                if subscriber.wants_history {
                    let held = publisher.history.iter();
                    held.for_each(|message| *overwritten += subscriber.push(incarnation, *message, *buffer));
                }
            }
        }
    }

    /// Sends a message to each subscriber in turn. Returns `false` if the publisher is killed
    /// before it has finished.
    ///
    /// `deliveries_left` is the number of deliveries after which the publisher is killed, or `None`
    /// if it is not to be killed.
    pub(crate) fn send(&mut self, incarnation: u32, message: M, deliveries_left: &mut Option<u32>) -> bool {
        self.deliver_history(incarnation);
        let Self { buffer, publishers, subscribers, overwritten, .. } = self;
        let Some(publisher) = publishers.iter_mut().find(|publisher| publisher.incarnation == incarnation) else {
            return true;
        };
        for subscriber in subscribers.iter_mut() {
            if let Some(remaining) = deliveries_left {
                if *remaining == 0 {
                    return false;
                }
                *remaining -= 1;
            }
            *overwritten += subscriber.push(incarnation, message, *buffer);
        }
        if publisher.history.len() == *buffer {
            publisher.history.pop_front();
        }
        publisher.history.push_back(message);
        true
    }

    /// Returns the next message for a subscriber, from a random publisher that has one.
    pub(crate) fn receive(&mut self, id: SubscriberId, random: &mut Random) -> Option<M> {
        let subscriber = self.subscribers.iter_mut().find(|subscriber| subscriber.id == id)?;
        let publishers = &self.publishers;
        let is_alive = |incarnation: u32| publishers.iter().any(|publisher| publisher.incarnation == incarnation);
        subscriber.queues.retain(|(publisher, queue)| !queue.is_empty() || is_alive(*publisher));
        let nonempty = subscriber.queues.iter().filter(|(_, queue)| !queue.is_empty()).count();
        if nonempty == 0 {
            return None;
        }
        let choice = if nonempty == 1 { 0 } else { random.between(0, nonempty as u64 - 1) as usize };
        let mut queues = subscriber.queues.iter_mut().filter(|(_, queue)| !queue.is_empty());
        queues.nth(choice)?.1.pop_front()
    }

    fn remove_process(&mut self, incarnation: u32) {
        self.publishers.retain(|publisher| publisher.incarnation != incarnation);
        self.subscribers.retain(|subscriber| subscriber.incarnation != incarnation);
    }
}

impl<M: Ticked> Topic<M> {
    /// Advances `next_tick` and sends a message. Returns `false` if the publisher is killed before
    /// it has finished.
    pub(crate) fn publish(&mut self, incarnation: u32, message: M, deliveries_left: &mut Option<u32>) -> bool {
        self.next_tick = self.next_tick.max(message.header().tick + 1);
        self.send(incarnation, message, deliveries_left)
    }
}

impl<M> Subscriber<M> {
    /// Queues a message. Returns the number of messages that were overwritten.
    fn push(&mut self, publisher: u32, message: M, buffer: usize) -> u64 {
        let index = self.queues.iter().position(|(incarnation, _)| *incarnation == publisher);
        let index = index.unwrap_or_else(|| {
            self.queues.push((publisher, VecDeque::new()));
            self.queues.len() - 1
        });
        let queue = &mut self.queues[index].1;
        queue.push_back(message);
        if queue.len() > buffer {
            queue.pop_front();
            return 1;
        }
        0
    }
}
