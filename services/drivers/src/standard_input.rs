//! Readings from standard input for a run in one process, without the bus.

use std::{collections::VecDeque, time::Instant};

use control::Diagnostic;
use decoders::Measurement;
use launch::{Ingest, Port};
use runtime::clock::monotonic_ns;

use crate::{
    DIAGNOSTICS_INTERVAL,
    device_monitor::{DeviceMonitor, RateCheck},
    diagnostics_publisher,
    error::DriversError,
    format,
    input::{Input, READ_TIMEOUT, ReadOutcome},
    port::StdinDescriptor,
    reading_converter::{DeviceReading, ReadingConverter},
    reconnecting_port::StreamOrigin,
    stream::DeviceStream,
    stream_preamble::StreamPreamble,
};

/// Result of waiting for a reading.
#[derive(Debug)]
pub enum Next {
    /// A reading or a fix.
    Reading(DeviceReading),
    /// No reading has arrived within a short time.
    NoData,
    /// The input has ended.
    End,
}

/// Standard input of this process, decoded.
pub struct StandardInput {
    stream: DeviceStream,
    converter: ReadingConverter,
    measurements: Vec<Measurement>,
    queue: VecDeque<DeviceReading>,
    monitor: DeviceMonitor,
    problems: Vec<Diagnostic>,
    checked_at: Instant,
}

impl StandardInput {
    /// Opens standard input with the settings of `ingest`.
    ///
    /// # Errors
    ///
    /// Returns an error if the settings of the format are invalid.
    pub fn open(ingest: &Ingest) -> Result<Self, DriversError> {
        let settings = &ingest.live.stdin.stream;
        let format = settings.format.clone();
        let preamble = format.is_text().then(StreamPreamble::unpublished);
        let name = format.name();
        let origin = StreamOrigin { is_resumed: false, stdin: StdinDescriptor::Own };
        let make_decoder = Box::new(move || format::decoder(&format));
        Ok(Self {
            stream: DeviceStream::open(Port::Stdin, name, origin, preamble, make_decoder)?,
            converter: ReadingConverter::new(Some(settings)),
            measurements: Vec::new(),
            queue: VecDeque::new(),
            monitor: DeviceMonitor::new("", RateCheck::None),
            problems: Vec::new(),
            checked_at: Instant::now(),
        })
    }

    /// Returns the next reading or fix. Waits for a short time if none is available.
    ///
    /// # Errors
    ///
    /// Returns an error if the decoder cannot be created again.
    pub fn next_reading(&mut self) -> Result<Next, DriversError> {
        if let Some(reading) = self.queue.pop_front() {
            return Ok(Next::Reading(reading));
        }
        if self.stream.read(READ_TIMEOUT, &mut self.measurements)? == ReadOutcome::End {
            return Ok(Next::End);
        }
        let arrival_ns = monotonic_ns().cast_signed();
        let Self { converter, measurements, queue, .. } = self;
        queue.extend(measurements.drain(..).filter_map(|measurement| converter.convert(&measurement, arrival_ns)));
        Ok(queue.pop_front().map_or(Next::NoData, Next::Reading))
    }

    /// Returns a line for each problem of the input that has appeared or is resolved. The input is
    /// checked once per second, and additionally if `is_final` is `true`.
    pub fn problem_changes(&mut self, is_final: bool) -> Vec<String> {
        if !is_final && self.checked_at.elapsed() < DIAGNOSTICS_INTERVAL {
            return Vec::new();
        }
        self.checked_at = Instant::now();
        let mut current = self.monitor.update(self.stream.report(), 0);
        current.extend(self.converter.rate_problem());
        let lines = diagnostics_publisher::changes(&self.problems, &current);
        self.problems = current;
        lines
    }
}
