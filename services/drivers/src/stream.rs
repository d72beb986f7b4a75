//! Device that sends bytes over a port.

use std::time::{Duration, Instant};

use decoders::{Counts, Decoder, Measurement, Value};
use launch::Port;

use crate::{
    error::DriversError,
    input::{DeviceReport, Input, ReadOutcome},
    reconnecting_port::{Received, ReconnectingPort, StreamOrigin, StreamStart},
    sender_decoders::{DatagramFormat, SenderDecoders},
    stream_preamble::StreamPreamble,
};

/// Function that creates a decoder in its initial state.
type DecoderFactory = Box<dyn Fn() -> Result<Box<dyn Decoder>, DriversError>>;

/// Maximum number of datagrams from other senders that are discarded per read.
const MAX_FOREIGN_DATAGRAMS: usize = 256;

/// Port and the decoder of its bytes.
pub(crate) struct DeviceStream {
    port: ReconnectingPort,
    format: &'static str,
    make_decoder: DecoderFactory,
    decoding: Decoding,
    /// State of a text stream, in which the first line may name the columns. `None` for other
    /// formats.
    text: Option<TextState>,
    /// Zero of the arrival times.
    start: Instant,
    bytes: u64,
    measurements: u64,
    foreign_datagrams: u64,
    has_ended: bool,
}

/// Decoders of the bytes of a port.
enum Decoding {
    /// Bytes of one device.
    Stream {
        decoder: Box<dyn Decoder>,
        /// Totals of the decoders that have been replaced.
        previous_counts: Counts,
    },
    /// Datagrams from several senders.
    Datagrams(SenderDecoders),
}

struct TextState {
    preamble: StreamPreamble,
    /// `true` if the next line may lack its beginning. Such a line could still look valid, with a
    /// truncated number, so its measurement is discarded.
    starts_mid_line: bool,
}

const LINE_END: &[u8] = b"\n";

impl DeviceStream {
    /// Opens a device.
    ///
    /// `preamble` is set for text formats.
    pub(crate) fn open(
        port: Port,
        format: &'static str,
        origin: StreamOrigin,
        preamble: Option<StreamPreamble>,
        make_decoder: DecoderFactory,
    ) -> Result<Self, DriversError> {
        let text = preamble.map(|preamble| TextState { preamble, starts_mid_line: false });
        // The decoder is created now, so that errors in its settings are found before the first
        // bytes arrive.
        let decoder = new_decoder(&make_decoder, text.as_ref())?;
        let decoding = match port {
            Port::Udp(_) => Decoding::Datagrams(SenderDecoders::default()),
            _ => Decoding::Stream { decoder, previous_counts: Counts::default() },
        };
        Ok(Self {
            port: ReconnectingPort::new(port, origin),
            format,
            make_decoder,
            decoding,
            text,
            start: Instant::now(),
            bytes: 0,
            measurements: 0,
            foreign_datagrams: 0,
            has_ended: false,
        })
    }

    /// Returns the function that selects the measurements that the device is required to provide.
    fn is_required(&self) -> fn(&Value) -> bool {
        match self.format {
            "ubx" | "nmea" => |value| matches!(value, Value::Fix { .. }),
            _ => |value| matches!(value, Value::Imu { .. }),
        }
    }
}

/// Creates a decoder that knows the columns of the preamble.
///
/// Only the columns are needed, because the measurements of the preamble have already been sent.
fn new_decoder(make_decoder: &DecoderFactory, text: Option<&TextState>) -> Result<Box<dyn Decoder>, DriversError> {
    let mut decoder = make_decoder()?;
    if let Some(text) = text {
        decoder.push(text.preamble.text(), &mut Vec::new());
    }
    Ok(decoder)
}

impl Input for DeviceStream {
    fn read(&mut self, timeout: Duration, measurements: &mut Vec<Measurement>) -> Result<ReadOutcome, DriversError> {
        let (first, is_required) = (measurements.len(), self.is_required());
        let outcome = self.read_port(timeout, measurements)?;
        let new = measurements.iter().skip(first);
        self.measurements += new.filter(|measurement| is_required(&measurement.value)).count() as u64;
        Ok(outcome)
    }

    fn report(&self) -> DeviceReport {
        DeviceReport {
            port: self.port.port().to_string(),
            format: self.format,
            failure: self.port.failure().cloned(),
            bytes: self.bytes,
            counts: match &self.decoding {
                Decoding::Stream { decoder, previous_counts } => *previous_counts + decoder.counts(),
                Decoding::Datagrams(senders) => senders.counts(),
            },
            measurements: self.measurements,
            foreign_datagrams: self.foreign_datagrams,
            dropped_datagrams: self.port.dropped_datagrams(),
        }
    }
}

impl DeviceStream {
    fn read_port(
        &mut self,
        mut timeout: Duration,
        measurements: &mut Vec<Measurement>,
    ) -> Result<ReadOutcome, DriversError> {
        let is_required = self.is_required();
        for _ in 0..MAX_FOREIGN_DATAGRAMS {
            let received = self.port.read(timeout);
            let now = self.start.elapsed();
            let (bytes, start, sender) = match received {
                Received::Bytes { bytes, start, sender } => (bytes, start, sender),
                Received::NoData => return Ok(ReadOutcome::NoData),
                Received::End => return Ok(self.end(measurements)),
            };
            let after_outage = start.is_some() && self.bytes > 0;
            match (&mut self.decoding, sender) {
                (Decoding::Datagrams(senders), Some(sender)) if !senders.admits(sender, now) => {
                    self.foreign_datagrams += 1;
                    timeout = Duration::ZERO;
                    continue;
                }
                (Decoding::Datagrams(senders), Some(sender)) => {
                    self.bytes += bytes.len() as u64;
                    let (make_decoder, text) = (&self.make_decoder, self.text.as_ref());
                    let make_decoder = || new_decoder(make_decoder, text);
                    let format =
                        DatagramFormat { make_decoder: &make_decoder, is_required, is_text: self.text.is_some() };
                    let Some(sender_text) = senders.push(sender, bytes, now, &format, measurements)? else {
                        return Ok(ReadOutcome::Data { after_outage });
                    };
                    if let Some(TextState { preamble, .. }) = &mut self.text {
                        // A sender that does not name its columns uses those of the preamble.
                        let mut found = Vec::new();
                        (self.make_decoder)()?.push(&sender_text, &mut found);
                        if !found.is_empty() {
                            preamble.restart();
                            preamble.push(&sender_text, true)?;
                        }
                    }
                    return Ok(ReadOutcome::Data { after_outage: true });
                }
                (Decoding::Stream { decoder, previous_counts }, _) => {
                    self.bytes += bytes.len() as u64;
                    decoder.set_time(now);
                    match &mut self.text {
                        Some(TextState { preamble, starts_mid_line }) => {
                            *starts_mid_line |= start == Some(StreamStart::Anywhere);
                            let first = measurements.len();
                            decoder.push(bytes, measurements);
                            preamble.push(bytes, measurements.len() > first)?;
                            if *starts_mid_line && measurements.len() > first {
                                measurements.remove(first);
                                *starts_mid_line = false;
                            }
                        }
                        None => {
                            if after_outage {
                                // A new decoder is created, so that partial messages are not joined
                                // across the outage.
                                *previous_counts = *previous_counts + decoder.counts();
                                *decoder = (self.make_decoder)()?;
                                decoder.set_time(now);
                            }
                            decoder.push(bytes, measurements);
                        }
                    }
                    return Ok(ReadOutcome::Data { after_outage });
                }
                (Decoding::Datagrams(_), None) => return Ok(ReadOutcome::NoData),
            }
        }
        Ok(ReadOutcome::NoData)
    }

    /// Ends the input. Completes a last line of text that lacks its newline.
    fn end(&mut self, measurements: &mut Vec<Measurement>) -> ReadOutcome {
        match &mut self.decoding {
            Decoding::Stream { decoder, .. } if !self.has_ended && self.text.is_some() => {
                self.has_ended = true;
                decoder.push(LINE_END, measurements);
                ReadOutcome::Data { after_outage: false }
            }
            _ => ReadOutcome::End,
        }
    }
}
