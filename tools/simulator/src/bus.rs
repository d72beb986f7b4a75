//! The bus: topics with as many publishers and readers as there are processes.
//!
//! It promises what the real one does and no more. A reader has a buffer for each publisher, of which the oldest message is overwritten;
//! what a publisher sends arrives in order, across publishers in any order. What a dead publisher has sent can still be read; what it
//! held for readers that come late is gone with it. Late readers are handed it when the publisher next acts.

use std::collections::VecDeque;

use messages::{
    AccelPoint, AttitudeOutput, Checkpoint, Control, Credit, Difference, FusedState, GnssFix, GyroStep, Health,
    ImuSample, MagSample, Ticked,
};
use runtime::service_config::CONTROL_BUFFER;

use crate::random::Random;

/// The number of a reader on the whole bus.
pub(crate) type ReaderId = u32;

/// The supervisor publishes and reads as this incarnation.
pub(crate) const SUPERVISOR: u32 = 0;

/// The topics of a system.
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
    readers: ReaderId,
}

impl Bus {
    /// A bus whose topics of the path hold so many messages.
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
            readers: 0,
        }
    }

    /// Another bus of the same name: nothing is on it, and its topics are at the ticks that they had.
    pub(crate) fn renewed(&self) -> Self {
        let mut bus = Self::new(self.imu.buffer);
        bus.imu.next_tick = self.imu.next_tick;
        bus.gyro.next_tick = self.gyro.next_tick;
        bus.accel.next_tick = self.accel.next_tick;
        bus.fused.next_tick = self.fused.next_tick;
        bus.attitude.next_tick = self.attitude.next_tick;
        bus
    }

    /// The number of a new reader.
    pub(crate) fn next_reader(&mut self) -> ReaderId {
        self.readers += 1;
        self.readers
    }

    /// A process is no more.
    pub(crate) fn leave(&mut self, incarnation: u32) {
        self.imu.leave(incarnation);
        self.mag.leave(incarnation);
        self.gnss.leave(incarnation);
        self.gyro.leave(incarnation);
        self.accel.leave(incarnation);
        self.fused.leave(incarnation);
        self.attitude.leave(incarnation);
        self.health.leave(incarnation);
        self.checkpoint.leave(incarnation);
        self.difference.leave(incarnation);
        self.control.leave(incarnation);
        self.credit.leave(incarnation);
    }
}

/// A typed stream.
#[derive(Debug)]
pub(crate) struct Topic<M> {
    buffer: usize,
    publishers: Vec<Publisher<M>>,
    readers: Vec<Reader<M>>,
    /// The tick after the newest one that was ever about to be published.
    pub(crate) next_tick: u64,
    /// Messages overwritten before they were read.
    pub(crate) overwritten: u64,
}

#[derive(Debug)]
struct Publisher<M> {
    incarnation: u32,
    history: VecDeque<M>,
    connected: Vec<ReaderId>,
}

#[derive(Debug)]
struct Reader<M> {
    id: ReaderId,
    incarnation: u32,
    /// It asks for what was published before.
    late: bool,
    /// What each publisher has sent and it has not read.
    queues: Vec<(u32, VecDeque<M>)>,
}

impl<M: Copy> Topic<M> {
    fn new(buffer: usize) -> Self {
        Self { buffer, publishers: Vec::new(), readers: Vec::new(), next_tick: 0, overwritten: 0 }
    }

    /// A process will publish.
    pub(crate) fn publish_as(&mut self, incarnation: u32) {
        let (history, connected) = (VecDeque::new(), self.readers.iter().map(|reader| reader.id).collect());
        self.publishers.push(Publisher { incarnation, history, connected });
    }

    /// A process will read; with what living publishers hold where it comes late.
    pub(crate) fn read_as(&mut self, id: ReaderId, incarnation: u32, late: bool) {
        self.readers.push(Reader { id, incarnation, late, queues: Vec::new() });
    }

    /// A publisher acts: readers that have come since it did last are handed what it holds.
    pub(crate) fn deliver_history(&mut self, incarnation: u32) {
        let Self { buffer, publishers, readers, overwritten, .. } = self;
        let Some(publisher) = publishers.iter_mut().find(|publisher| publisher.incarnation == incarnation) else {
            return;
        };
        for reader in readers.iter_mut() {
            if !publisher.connected.contains(&reader.id) {
                publisher.connected.push(reader.id);
                if reader.late {
                    let held = publisher.history.iter();
                    held.for_each(|message| *overwritten += reader.put(incarnation, *message, *buffer));
                }
            }
        }
    }

    /// Sends a message to one reader after the other; `deliveries` is how many of them it lives to reach. Whether it lives on.
    pub(crate) fn send(&mut self, incarnation: u32, message: M, deliveries: &mut Option<u32>) -> bool {
        self.deliver_history(incarnation);
        let Self { buffer, publishers, readers, overwritten, .. } = self;
        let Some(publisher) = publishers.iter_mut().find(|publisher| publisher.incarnation == incarnation) else {
            return true;
        };
        for reader in readers.iter_mut() {
            if let Some(left) = deliveries {
                if *left == 0 {
                    return false;
                }
                *left -= 1;
            }
            *overwritten += reader.put(incarnation, message, *buffer);
        }
        if publisher.history.len() == *buffer {
            publisher.history.pop_front();
        }
        publisher.history.push_back(message);
        true
    }

    /// The next message for a reader, of any publisher.
    pub(crate) fn receive(&mut self, id: ReaderId, random: &mut Random) -> Option<M> {
        let reader = self.readers.iter_mut().find(|reader| reader.id == id)?;
        let publishers = &self.publishers;
        let lives = |incarnation: u32| publishers.iter().any(|publisher| publisher.incarnation == incarnation);
        reader.queues.retain(|(publisher, queue)| !queue.is_empty() || lives(*publisher));
        let full = reader.queues.iter().filter(|(_, queue)| !queue.is_empty()).count();
        if full == 0 {
            return None;
        }
        let turn = if full == 1 { 0 } else { random.between(0, full as u64 - 1) as usize };
        let mut queues = reader.queues.iter_mut().filter(|(_, queue)| !queue.is_empty());
        queues.nth(turn)?.1.pop_front()
    }

    fn leave(&mut self, incarnation: u32) {
        self.publishers.retain(|publisher| publisher.incarnation != incarnation);
        self.readers.retain(|reader| reader.incarnation != incarnation);
    }
}

impl<M: Ticked> Topic<M> {
    /// Notes and sends a message of the path.
    pub(crate) fn publish(&mut self, incarnation: u32, message: M, deliveries: &mut Option<u32>) -> bool {
        self.next_tick = self.next_tick.max(message.header().tick + 1);
        self.send(incarnation, message, deliveries)
    }
}

impl<M> Reader<M> {
    /// How many messages were overwritten by that.
    fn put(&mut self, publisher: u32, message: M, buffer: usize) -> u64 {
        let place = self.queues.iter().position(|(incarnation, _)| *incarnation == publisher);
        let place = place.unwrap_or_else(|| {
            self.queues.push((publisher, VecDeque::new()));
            self.queues.len() - 1
        });
        let queue = &mut self.queues[place].1;
        queue.push_back(message);
        if queue.len() > buffer {
            queue.pop_front();
            return 1;
        }
        0
    }
}
