//! The service `drivers`, which reads the devices of a live source and publishes their measurements
//! to ingest.
//!
//! Input: bytes from standard input, datagrams, a TCP connection, a serial port or industrial I/O,
//! and bytes from an additional satellite receiver.
//!
//! Output: the topics `sensor` and `receiver`.
//!
//! Time: the device's timestamps, unchanged or fitted to CLOCK_MONOTONIC ([`driver::clock_fit`]),
//! as set in the launch file.
//!
//! Failure: an unavailable port is reported with a remedy and reopened after a pause that doubles
//! with each failed attempt. Bytes that belong to no message of the format are counted. Device
//! problems are reported to the supervisor. A source that can wait, such as a pipe, is read only as
//! fast as ingest consumes the readings.
//!
//! | module | contents |
//! | --- | --- |
//! | `input`, `error` | interface of a device; errors of the service |
//! | `stream` | device that sends bytes over a port |
//! | `iio` | Linux industrial I/O device |
//! | `receiver` | additional satellite receiver |
//! | `port` | open ports: standard input, datagrams, TCP connection, serial port |
//! | `drop_counter` | datagrams that the kernel dropped |
//! | `reconnecting_port` | port that is reopened after a failure |
//! | `detect` | recognition of the device on a serial port |
//! | `format` | selection of the decoder for a format |
//! | `protobuf` | length-delimited protobuf messages |
//! | `sender_decoders` | choice of one sender of datagrams, with the decoder of each |
//! | `stream_preamble` | header of a text stream, kept for a process that resumes in mid-stream |
//! | [`reading_converter`] | conversion of measurements to readings and fixes with timestamps |
//! | `reading_publisher` | publication of readings and fixes |
//! | [`standard_input`] | readings of standard input for a run in one process |
//! | `device_monitor` | detection of device problems |
//! | `diagnostics_publisher` | reports of these problems to the supervisor and the user |
#![forbid(unsafe_code)]

pub mod detect;
mod device_monitor;
mod diagnostics_publisher;
mod drop_counter;
mod error;
mod format;
mod iio;
mod input;
mod port;
mod protobuf;
pub mod reading_converter;
mod reading_publisher;
mod receiver;
mod reconnecting_port;
mod sender_decoders;
pub mod standard_input;
mod stream;
mod stream_preamble;

use std::{
    thread,
    time::{Duration, Instant},
};

use launch::{Ingest, Service, Source};
use messages::State;
use runtime::{ServiceContext, clock::monotonic_ns};

pub use error::DriversError;

use device_monitor::{DeviceMonitor, RateCheck};
use diagnostics_publisher::DiagnosticsPublisher;
use iio::IioInput;
use input::{Input, READ_TIMEOUT, ReadOutcome};
use port::StdinDescriptor;
use reading_publisher::ReadingPublisher;
use receiver::Receiver;
use reconnecting_port::StreamOrigin;
use stream::DeviceStream;
use stream_preamble::StreamPreamble;

/// Pause before trying again while ingest has no room for more readings.
const INGEST_WAIT: Duration = Duration::from_micros(500);
/// Interval between two evaluations of the device reports.
const DIAGNOSTICS_INTERVAL: Duration = Duration::from_secs(1);

/// Runs the service until the system stops.
///
/// # Errors
///
/// Returns an error if the system cannot be joined, the bus fails, or the launch file's format
/// settings are invalid.
pub fn run() -> Result<(), DriversError> {
    let mut context = ServiceContext::join(Service::Drivers)?;
    let ingest = context.config.launch.ingest.clone();
    let mut publisher = ReadingPublisher::open(&context, ingest.stream())?;
    let mut source = source(&ingest, &context)?;
    let receiver = Receiver::start(&ingest.live.receiver)?;
    let mut diagnostics = DiagnosticsPublisher::start(context.config.launch.name.clone())?;
    // A source in lockstep is read at the speed of ingest, so its rate is not checked.
    let rate = match ingest.declared_rate_hz() {
        _ if context.config.is_lockstep() => RateCheck::None,
        Some(declared_hz) => RateCheck::Declared(declared_hz),
        None => RateCheck::AtMost(ingest.nominal_rate_hz()),
    };
    let mut source_monitor = DeviceMonitor::new("", rate);
    let mut receiver_monitor = DeviceMonitor::new("receiver-", RateCheck::None);
    let mut next_diagnostics = Instant::now() + DIAGNOSTICS_INTERVAL;
    let mut measurements = Vec::new();
    let mut state = State::READY;
    let mut has_ambiguous_dates = false;
    while !context.should_stop() {
        let report = source.as_ref().map(|source| source.report());
        let clock = publisher.converter.clock_health();
        let clock_steps = clock.resets + clock.backsteps;
        if Instant::now() >= next_diagnostics {
            next_diagnostics = Instant::now() + DIAGNOSTICS_INTERVAL;
            let mut problems = report.clone().map_or(Vec::new(), |report| source_monitor.update(report, clock_steps));
            problems.extend(receiver.iter().flat_map(|receiver| receiver_monitor.update(receiver.report(), 0)));
            problems.extend(publisher.converter.rate_problem());
            diagnostics.publish(problems);
        }
        context.publish_health(state, |health| {
            health.ticks = publisher.sent();
            let report = report.unwrap_or_default();
            (health.refused, health.lost) = (report.counts.rejected, report.dropped_datagrams);
            health.clock_offset_ns = clock.offset_ns;
            health.clock_jitter_ns = clock.jitter_ns as u64;
            health.clock_steps = clock_steps;
        })?;
        publisher.deliver_history()?;
        if !publisher.flush()? {
            thread::sleep(INGEST_WAIT);
            continue;
        }
        match source.as_mut().map(|source| source.read(READ_TIMEOUT, &mut measurements)).transpose()? {
            Some(ReadOutcome::Data { after_outage }) => {
                state = State::RUNNING;
                if after_outage {
                    publisher.converter.mark_gap();
                }
            }
            // The source is read only when the queue is empty, so all readings have been sent.
            Some(ReadOutcome::End) if state != State::FINISHED => state = State::FINISHED,
            Some(ReadOutcome::End) => thread::sleep(READ_TIMEOUT),
            Some(ReadOutcome::NoData) => {}
            None => measurements.extend(receiver.iter().find_map(|receiver| receiver.next_fix(READ_TIMEOUT))),
        }
        measurements.extend(receiver.iter().flat_map(Receiver::queued_fixes));
        let arrival_ns = monotonic_ns().cast_signed();
        let had_problem = publisher.converter.rate_problem().is_some() || has_ambiguous_dates;
        measurements.drain(..).for_each(|measurement| publisher.push(&measurement, arrival_ns));
        has_ambiguous_dates = source.as_ref().is_some_and(|source| source.report().counts.ambiguous_dates > 0);
        if (publisher.converter.rate_problem().is_some() || has_ambiguous_dates) && !had_problem {
            // A short input may end before the next evaluation is due, so the device reports are
            // evaluated now.
            next_diagnostics = Instant::now();
        }
    }
    let sent = publisher.sent();
    let dropped = source.map_or(0, |source| source.report().dropped_datagrams);
    Ok(context.publish_final_health(|health| (health.ticks, health.lost) = (sent, dropped))?)
}

/// Returns the device of the source, or `None` if another program publishes the readings.
fn source(ingest: &Ingest, context: &ServiceContext) -> Result<Option<Box<dyn Input>>, DriversError> {
    if ingest.source == Source::Iio {
        return Ok(Some(Box::new(IioInput::new(ingest.live.iio.clone()))));
    }
    let (Some(stream), Some(port)) = (ingest.stream(), ingest.port()) else { return Ok(None) };
    let format = stream.format.clone();
    let preamble = format.is_text().then(|| StreamPreamble::open(context)).transpose()?;
    let name = format.name();
    let origin = StreamOrigin { is_resumed: context.config.resume.is_some(), stdin: StdinDescriptor::Passed };
    let make_decoder = Box::new(move || format::decoder(&format));
    Ok(Some(Box::new(DeviceStream::open(port, name, origin, preamble, make_decoder)?)))
}
