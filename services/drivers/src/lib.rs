//! The service `drivers`: reads the devices of a live source and gives what they measure to ingest.
//!
//! Input: bytes on standard input, in datagrams, over a connection, a serial line or industrial I/O; and those of a satellite receiver beside them. Output: the topics `sensor` and
//! `receiver`. Time: that of the device as it is, or fitted to CLOCK_MONOTONIC ([`driver::clock_fit`]), as the launch file says. Failure: a
//! port that is not there or goes away is told with the remedy and opened again after a pause that doubles; bytes that are no message of
//! the format are counted; what is wrong with a device is told to the supervisor. What waits, as a pipe does, is read only as fast as ingest
//! takes it.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `input` | what measurements come from |
//! | `stream` | a device whose bytes come over a port |
//! | `iio` | a device of Linux industrial I/O |
//! | `receiver` | a satellite receiver beside the source |
//! | `port` | the ways in: standard input, datagrams, a connection, a serial line |
//! | `line` | a port that is opened again when it goes away |
//! | `format` | the decoder of a format |
//! | `protobuf` | messages of the schema in a stream |
//! | `beginning` | the header of a text, for a process that goes on in the midst of it |
//! | `outlet` | measurements as readings and fixes, with their times, to ingest |
//! | `troubles` | what is wrong with a device |
//! | `teller` | what people and the supervisor are told |
#![forbid(unsafe_code)]

mod beginning;
mod format;
mod iio;
mod input;
mod line;
mod outlet;
mod port;
mod protobuf;
mod receiver;
mod stream;
mod teller;
mod troubles;

use std::{
    thread,
    time::{Duration, Instant},
};

use bus::BusError;
use decoders::lines::LinesError;
use launch::{Ingest, Service, Source};
use mapping::MappingError;
use messages::State;
use runtime::{RuntimeError, ServiceContext, clock::monotonic_ns};

use beginning::Beginning;
use iio::IioInput;
use input::{Input, Step};
use outlet::Outlet;
use receiver::Receiver;
use stream::Stream;
use teller::Teller;
use troubles::Watch;

/// The longest wait for bytes, before the service says how it is.
const WAIT: Duration = Duration::from_millis(50);
/// The wait for ingest to take what it has.
const ROOM_WAIT: Duration = Duration::from_micros(500);
/// From one look at how the devices do to the next.
const LOOK: Duration = Duration::from_secs(1);

/// Why the drivers ended.
#[derive(Debug, thiserror::Error)]
pub enum DriversError {
    /// The system could not be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The columns are none.
    #[error(transparent)]
    Mapping(#[from] MappingError),
    /// The format has settings that are none.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// A thread could not be started.
    #[error("starting a thread of the drivers: {0}")]
    Thread(#[from] std::io::Error),
}

/// The service.
pub fn run() -> Result<(), DriversError> {
    let mut context = ServiceContext::join(Service::Drivers)?;
    let ingest = context.config.launch.ingest.clone();
    let mut outlet = Outlet::open(&context, ingest.stream())?;
    let mut source = source(&ingest, &context)?;
    let receiver = Receiver::start(&ingest.live.receiver)?;
    let mut teller = Teller::start(context.config.launch.name.clone())?;
    let (mut of_source, mut of_receiver) = (Watch::new(""), Watch::new("receiver-"));
    let mut next_look = Instant::now() + LOOK;
    let mut found = Vec::new();
    let mut state = State::READY;
    while !context.ends() {
        let report = source.as_ref().map(|source| source.report());
        let clock = outlet.clock_health();
        let clock_steps = clock.resets + clock.backsteps;
        if Instant::now() >= next_look {
            next_look = Instant::now() + LOOK;
            let mut troubles = report.clone().map_or(Vec::new(), |report| of_source.look(report, clock_steps));
            troubles.extend(receiver.iter().flat_map(|receiver| of_receiver.look(receiver.report(), 0)));
            teller.troubles(troubles);
        }
        context.publish_health(state, |health| {
            health.ticks = outlet.sent();
            health.refused = report.map_or(0, |report| report.counts.refused);
            health.clock_offset_ns = clock.offset_ns;
            health.clock_jitter_ns = clock.jitter_ns as u64;
            health.clock_steps = clock_steps;
        })?;
        outlet.deliver_history()?;
        if !outlet.empty()? {
            thread::sleep(ROOM_WAIT);
            continue;
        }
        match source.as_mut().map(|source| source.take(WAIT, &mut found)).transpose()? {
            Some(Step::Given { after_absence }) => {
                state = State::RUNNING;
                if after_absence {
                    outlet.interrupt();
                }
            }
            // Not before all of it has been sent.
            Some(Step::End) if state != State::FINISHED => state = State::FINISHED,
            Some(Step::End) => thread::sleep(WAIT),
            Some(Step::Nothing) => {}
            None => found.extend(receiver.iter().find_map(|receiver| receiver.take(WAIT))),
        }
        found.extend(receiver.iter().flat_map(|receiver| std::iter::from_fn(|| receiver.take(Duration::ZERO))));
        let arrival_ns = monotonic_ns().cast_signed();
        found.drain(..).for_each(|measurement| outlet.add(&measurement, arrival_ns));
    }
    let sent = outlet.sent();
    Ok(context.publish_last_health(|health| health.ticks = sent)?)
}

/// What the source is read from; none where it is not read here.
fn source(ingest: &Ingest, context: &ServiceContext) -> Result<Option<Box<dyn Input>>, DriversError> {
    if ingest.source == Source::Iio {
        return Ok(Some(Box::new(IioInput::new(ingest.live.iio.clone()))));
    }
    let (Some(stream), Some(port)) = (ingest.stream(), ingest.port()) else { return Ok(None) };
    let format = stream.format.clone();
    let beginning = format.is_text().then(|| Beginning::open(context)).transpose()?;
    let (name, goes_on) = (format.name(), context.config.resume.is_some());
    let make = Box::new(move || format::decoder(&format));
    Ok(Some(Box::new(Stream::open(port.clone(), name, goes_on, beginning, make)?)))
}
