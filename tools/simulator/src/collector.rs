//! What the supervisor makes of the attitudes: each tick once, in order.

use std::convert::Infallible;

use messages::{AttitudeOutput, Ticked};
use runtime::{Sequence, ServiceConfig, ordered_subscriber::OrderedStream};
use supervision::OutputProgress;

use crate::{
    bus::{Bus, ReaderId, SUPERVISOR},
    random::Random,
};

/// Takes the attitudes of a run.
pub(crate) struct Collector {
    reader: ReaderId,
    stream: OrderedStream<AttitudeOutput>,
    pub(crate) sequence: Sequence,
    /// As they came, without the stamps of the run.
    pub(crate) taken: Vec<AttitudeOutput>,
    /// The decision that the last one was published under.
    epoch: u32,
    /// Attitudes of an older decision than one before them: two stages took turns.
    pub(crate) superseded: u64,
}

impl Collector {
    /// The first attitude to come is that of `next_tick`.
    pub(crate) fn new(bus: &mut Bus, next_tick: u64, config: &ServiceConfig) -> Self {
        let (reader, stream) = open(bus, next_tick, config);
        Self { reader, stream, sequence: Sequence::default(), taken: Vec::new(), epoch: 0, superseded: 0 }
    }

    /// Goes on at another bus.
    pub(crate) fn renew(&mut self, bus: &mut Bus, config: &ServiceConfig) {
        (self.reader, self.stream) = open(bus, self.sequence.next_tick, config);
        self.epoch = 0;
    }

    /// Takes what has come.
    pub(crate) fn collect(&mut self, bus: &mut Bus, random: &mut Random) {
        let Self { reader, stream, .. } = self;
        let mut came = Vec::new();
        let read = |stage: &mut dyn FnMut(AttitudeOutput)| -> Result<(), Infallible> {
            std::iter::from_fn(|| bus.attitude.receive(*reader, random)).for_each(stage);
            Ok(())
        };
        let Ok(()) = stream.advance(usize::MAX, read, &mut |output| came.push(output));
        came.into_iter().for_each(|output| self.take(output));
    }

    /// Takes what waits for ticks that do not come any more.
    pub(crate) fn finish(&mut self) {
        let mut came = Vec::new();
        self.stream.finish(&mut |output| came.push(output));
        came.into_iter().for_each(|output| self.take(output));
    }

    fn take(&mut self, output: AttitudeOutput) {
        if self.sequence.admit(&output.header).is_some() {
            self.superseded += u64::from(output.header.epoch < self.epoch);
            self.epoch = output.header.epoch;
            self.taken.push(output.canonical());
        }
    }

    /// How far it is.
    pub(crate) fn progress(&self) -> OutputProgress {
        let Sequence { next_tick, lost, duplicated, .. } = self.sequence;
        OutputProgress { next_tick, lost, not_recorded: 0, duplicated, max_gap_ns: 0, last_swap: None }
    }
}

fn open(bus: &mut Bus, next_tick: u64, config: &ServiceConfig) -> (ReaderId, OrderedStream<AttitudeOutput>) {
    let reader = bus.next_reader();
    bus.attitude.read_as(reader, SUPERVISOR, false);
    (reader, OrderedStream::new(next_tick, bus.attitude.next_tick, config))
}
