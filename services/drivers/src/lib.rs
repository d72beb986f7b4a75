//! The service `drivers`: reads the devices of a live source and gives what they measure to ingest.
//!
//! Input: bytes on standard input, in datagrams or over a serial line. Output: the topics `sensor` and `receiver`. Time: that of the device as it
//! is, or fitted to CLOCK_MONOTONIC ([`driver::clock_fit`]), as the launch file says. Failure: a port that is not there or goes away is told with
//! the remedy and opened again after a pause that doubles; bytes that are no message of the format are counted. What waits, as a pipe does, is
//! read only as fast as ingest takes it.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `port` | the ways in: standard input, datagrams, a serial line |
//! | `line` | a port that is opened again when it goes away |
//! | `format` | the decoder of a format |
//! | `beginning` | the header of a text, for a process that goes on in the midst of it |
//! | `outlet` | measurements as readings and fixes, with their times, to ingest |
#![forbid(unsafe_code)]

mod beginning;
mod format;
mod line;
mod outlet;
mod port;

use std::{thread, time::Duration};

use bus::BusError;
use decoders::lines::LinesError;
use launch::{Service, Source};
use messages::State;
use runtime::{RuntimeError, ServiceContext, clock::monotonic_ns};

use beginning::Beginning;
use line::{Line, Taken};
use outlet::Outlet;

/// The longest wait for bytes, before the service says how it is.
const WAIT: Duration = Duration::from_millis(50);
/// The wait for ingest to take what it has.
const ROOM_WAIT: Duration = Duration::from_micros(500);

/// Why the drivers ended.
#[derive(Debug, thiserror::Error)]
pub enum DriversError {
    /// The system could not be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The format has settings that are none.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// The source has no port.
    #[error("reading a device: the source of this launch file has no port")]
    NoPort,
}

/// The service.
pub fn run() -> Result<(), DriversError> {
    let mut context = ServiceContext::join(Service::Drivers)?;
    let ingest = context.config.launch.ingest.clone();
    let stream = *ingest.stream().ok_or(DriversError::NoPort)?;
    let mut decoder = format::decoder(&stream.format)?;
    let mut outlet = Outlet::open(&context, &stream)?;
    let mut line = Line::new(&ingest, context.config.launch.name.clone(), context.config.resume.is_some());
    // The last line of a datagram, or of all, may lack its end.
    let line_end: &[u8] = if stream.format.is_text() { b"\n" } else { b"" };
    let mut found = Vec::new();
    let mut beginning = Beginning::open(&context)?;
    // What an earlier process has sent of it is not sent again.
    decoder.push(beginning.text(), &mut found);
    found.clear();
    // The first line is the rest of one.
    let mut is_cut = false;
    let mut state = State::READY;
    while !context.ends() {
        let refused = decoder.counts().refused;
        context.publish_health(state, |health| {
            (health.ticks, health.refused) = (outlet.sent(), refused);
            let clock = outlet.clock_health();
            health.clock_offset_ns = clock.offset_ns;
            health.clock_jitter_ns = clock.jitter_ns as u64;
            health.clock_steps = clock.resets + clock.backsteps;
        })?;
        outlet.deliver_history()?;
        if !outlet.empty()? {
            thread::sleep(ROOM_WAIT);
            continue;
        }
        match line.take(WAIT) {
            Taken::Bytes { bytes, begin_anywhere } => {
                state = State::RUNNING;
                // Half a line may look like a whole one, with half a number.
                is_cut |= begin_anywhere && stream.format.is_text();
                let end: &[u8] = if ingest.source == Source::Udp { line_end } else { b"" };
                decoder.push(bytes, &mut found);
                decoder.push(end, &mut found);
                if stream.format.is_text() {
                    beginning.see(bytes, false)?;
                    beginning.see(end, !found.is_empty())?;
                }
                if is_cut && !found.is_empty() {
                    found.remove(0);
                    is_cut = false;
                }
            }
            Taken::Nothing => {}
            Taken::End if state != State::FINISHED => {
                decoder.push(line_end, &mut found);
                // Not before all of it has been sent.
                state = if found.is_empty() { State::FINISHED } else { state };
            }
            Taken::End => thread::sleep(WAIT),
        }
        let arrival_ns = monotonic_ns().cast_signed();
        found.drain(..).for_each(|measurement| outlet.add(&measurement, arrival_ns));
    }
    let sent = outlet.sent();
    Ok(context.publish_last_health(|health| health.ticks = sent)?)
}
