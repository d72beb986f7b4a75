//! Collector of the attitudes. Like the supervisor's collector, it delivers each tick once and in
//! order.

use std::convert::Infallible;

use messages::{AttitudeOutput, Ticked};
use runtime::{Sequence, ServiceConfig, ordered_subscriber::OrderedStream};
use supervision::OutputProgress;

use crate::{
    bus::{Bus, SUPERVISOR, SubscriberId},
    random::Random,
};

/// Collector of the attitudes of a run.
pub(crate) struct Collector {
    subscriber: SubscriberId,
    stream: OrderedStream<AttitudeOutput>,
    pub(crate) sequence: Sequence,
    /// Received attitudes, without the values that differ from run to run.
    pub(crate) attitudes: Vec<AttitudeOutput>,
    /// Epoch of the newest attitude.
    epoch: u32,
    /// Number of attitudes with an epoch older than that of the preceding attitude. They occur when
    /// two stages publish alternately.
    pub(crate) superseded: u64,
}

impl Collector {
    /// Creates a collector that starts at `next_tick`.
    pub(crate) fn new(bus: &mut Bus, next_tick: u64, config: &ServiceConfig) -> Self {
        let (subscriber, stream) = subscribe(bus, next_tick, config);
        Self { subscriber, stream, sequence: Sequence::default(), attitudes: Vec::new(), epoch: 0, superseded: 0 }
    }

    /// Subscribes again after the bus was renewed.
    pub(crate) fn reconnect(&mut self, bus: &mut Bus, config: &ServiceConfig) {
        (self.subscriber, self.stream) = subscribe(bus, self.sequence.next_tick, config);
        self.epoch = 0;
    }

    /// Reads all available attitudes.
    pub(crate) fn collect(&mut self, bus: &mut Bus, random: &mut Random) {
        let Self { subscriber, stream, .. } = self;
        let mut outputs = Vec::new();
        let read = |count, stage: &mut dyn FnMut(AttitudeOutput)| -> Result<(), Infallible> {
            std::iter::from_fn(|| bus.attitude.receive(*subscriber, random)).take(count).for_each(stage);
            Ok(())
        };
        let Ok(()) = stream.advance(usize::MAX, read, &mut |output| outputs.push(output));
        outputs.into_iter().for_each(|output| self.record(output));
    }

    /// Records the attitudes that are held back because earlier ticks are missing. Called at the
    /// end of a run, when no more attitudes will arrive.
    pub(crate) fn finish(&mut self) {
        let mut outputs = Vec::new();
        self.stream.finish(&mut |output| outputs.push(output));
        outputs.into_iter().for_each(|output| self.record(output));
    }

    fn record(&mut self, output: AttitudeOutput) {
        if self.sequence.admit(&output.header).is_some() {
            self.superseded += u64::from(output.header.epoch < self.epoch);
            self.epoch = output.header.epoch;
            self.attitudes.push(output.canonical());
        }
    }

    /// Returns the output progress that the supervisor's core receives.
    pub(crate) fn progress(&self) -> OutputProgress {
        let Sequence { next_tick, lost, duplicated, .. } = self.sequence;
        OutputProgress { next_tick, lost, not_recorded: 0, duplicated, max_gap_ns: 0, last_swap: None }
    }
}

fn subscribe(bus: &mut Bus, next_tick: u64, config: &ServiceConfig) -> (SubscriberId, OrderedStream<AttitudeOutput>) {
    let subscriber = bus.next_subscriber();
    bus.attitude.subscribe(subscriber, SUPERVISOR, false);
    (subscriber, OrderedStream::new(next_tick, bus.attitude.next_tick, config))
}
