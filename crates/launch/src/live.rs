//! Sources that are read while they send: what comes over a port, and what is known of it.

use std::{ops::RangeInclusive, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{GyroSamples, Ingest, Launch, Service, Source, model::BusSource, walk::Section};

/// Readings a second that any source may have.
pub(crate) const RATES_HZ: RangeInclusive<f64> = 1.0..=10_000.0;
/// Bits a second of a serial line.
const BAUDS: RangeInclusive<u64> = 50..=20_000_000;

/// What comes over a port, whichever it is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stream {
    /// How the bytes are to be read.
    pub format: Format,
    /// What becomes of the times that the device gives.
    pub clock: Clock,
    /// Nominal readings per second, Hz.
    pub rate_hz: f64,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
}

/// How the bytes of a port are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Lines as in our own recordings.
    Csv,
}

/// What becomes of the times that a device gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// They are taken as they are.
    Device,
    /// A line fitted to the times of arrival makes times of this machine's CLOCK_MONOTONIC of them.
    Host,
}

/// Datagrams.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Udp {
    /// The address and port on this machine to which they are sent.
    pub listen: String,
    /// What they bring.
    pub stream: Stream,
}

/// A serial line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Serial {
    /// The device file; empty if none is named.
    pub port: PathBuf,
    /// Bits a second.
    pub baud: u64,
    /// What it brings.
    pub stream: Stream,
}

impl Format {
    /// Its messages are lines, and end where a line, a datagram or the input ends.
    pub const fn is_text(self) -> bool {
        matches!(self, Self::Csv)
    }
}

impl Stream {
    /// Our own lines at 1 kHz, with times that become `clock`'s.
    pub(crate) const fn of(clock: Clock) -> Self {
        Self { format: Format::Csv, clock, rate_hz: 1000.0, gyro_samples: GyroSamples::Means }
    }
}

impl Source {
    /// The service `drivers` reads it.
    pub const fn is_driven(self) -> bool {
        matches!(self, Self::Stdin | Self::Udp | Self::Serial)
    }

    /// It is there before it is asked for: it knows its end, and another process can read it from its beginning.
    pub const fn can_be_read_again(self) -> bool {
        matches!(self, Self::Sim | Self::Replay)
    }

    /// It waits for whoever reads it: nothing of it is lost, at any speed.
    pub const fn waits(self) -> bool {
        matches!(self, Self::Replay | Self::Stdin)
    }
}

impl Ingest {
    /// What the source's port brings; none for a source that has no port.
    pub fn stream(&self) -> Option<&Stream> {
        match self.source {
            Source::Stdin => Some(&self.stdin),
            Source::Udp => Some(&self.udp.stream),
            Source::Serial => Some(&self.serial.stream),
            Source::Sim | Source::Replay | Source::Bus => None,
        }
    }

    /// Readings per second that the launch file tells of the source; none of a recording, which tells itself.
    pub fn declared_rate_hz(&self) -> Option<f64> {
        match self.source {
            Source::Sim => Some(self.sim.rate_hz),
            Source::Replay => None,
            Source::Bus => Some(self.bus.rate_hz),
            Source::Stdin | Source::Udp | Source::Serial => self.stream().map(|stream| stream.rate_hz),
        }
    }
}

impl Launch {
    /// The drivers run exactly where the source is theirs.
    pub(crate) fn add_drivers(&mut self) {
        self.services.retain(|service| *service != Service::Drivers);
        if self.ingest.source.is_driven() && self.services.contains(&Service::Ingest) {
            self.services.push(Service::Drivers);
        }
    }
}

/// Reads the sections of the live sources.
pub(crate) fn live(section: &mut Section<'_, '_>, out: &mut Ingest) {
    section.section("bus", |section| {
        let BusSource { rate_hz, gyro_samples } = &mut out.bus;
        section.number("rate_hz", RATES_HZ, rate_hz);
        section.choice("gyro_samples", GyroSamples::ALL, gyro_samples);
    });
    section.section("stdin", |section| stream(section, &mut out.stdin));
    section.section("udp", |section| {
        let address = |text: &str| text.parse::<std::net::SocketAddr>().ok().map(|_| text.to_owned());
        section.text("listen", r#"an address and a port, as "0.0.0.0:14560""#, address, &mut out.udp.listen);
        stream(section, &mut out.udp.stream);
    });
    section.section("serial", |section| {
        let path = |text: &str| (!text.is_empty()).then(|| text.into());
        section.text("port", r#"a device file, as "/dev/ttyUSB0""#, path, &mut out.serial.port);
        section.count("baud", BAUDS, &mut out.serial.baud);
        stream(section, &mut out.serial.stream);
    });
}

fn stream(section: &mut Section<'_, '_>, out: &mut Stream) {
    section.choice("format", [("csv", Format::Csv)], &mut out.format);
    section.choice("clock", [("device", Clock::Device), ("host", Clock::Host)], &mut out.clock);
    section.number("rate_hz", RATES_HZ, &mut out.rate_hz);
    section.choice("gyro_samples", GyroSamples::ALL, &mut out.gyro_samples);
}
