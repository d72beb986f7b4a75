//! Device that sends bytes over a port.

use std::time::Duration;

use decoders::{Counts, Decoder, Measurement};
use launch::Port;

use crate::{
    error::DriversError,
    input::{DeviceReport, Input, ReadOutcome},
    reconnecting_port::{Received, ReconnectingPort, StreamStart},
    stream_preamble::StreamPreamble,
};

/// Function that creates a decoder in its initial state.
type DecoderFactory = Box<dyn Fn() -> Result<Box<dyn Decoder>, DriversError>>;

/// Port and the decoder of its bytes.
pub(crate) struct DeviceStream {
    port: ReconnectingPort,
    format: &'static str,
    make_decoder: DecoderFactory,
    decoder: Box<dyn Decoder>,
    /// Totals of the decoders that have been replaced.
    previous_counts: Counts,
    /// State of a text stream, in which the first line may name the columns. `None` for other
    /// formats.
    text: Option<TextState>,
    bytes: u64,
    measurements: u64,
    has_ended: bool,
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
    /// `is_resumed` is set if an earlier process has read from the same input. `preamble` is set
    /// for text formats.
    pub(crate) fn open(
        port: Port,
        format: &'static str,
        is_resumed: bool,
        preamble: Option<StreamPreamble>,
        make_decoder: DecoderFactory,
    ) -> Result<Self, DriversError> {
        let mut decoder = make_decoder()?;
        if let Some(preamble) = &preamble {
            // Only the columns are needed, because the earlier process has already sent the
            // measurements.
            decoder.push(preamble.text(), &mut Vec::new());
        }
        Ok(Self {
            port: ReconnectingPort::new(port, is_resumed),
            format,
            make_decoder,
            decoder,
            previous_counts: Counts::default(),
            text: preamble.map(|preamble| TextState { preamble, starts_mid_line: false }),
            bytes: 0,
            measurements: 0,
            has_ended: false,
        })
    }

    fn counts(&self) -> Counts {
        self.previous_counts + self.decoder.counts()
    }
}

impl Input for DeviceStream {
    fn read(&mut self, timeout: Duration, measurements: &mut Vec<Measurement>) -> Result<ReadOutcome, DriversError> {
        let first = measurements.len();
        let is_datagram = matches!(self.port.port(), Port::Udp(_));
        let outcome = match self.port.read(timeout) {
            Received::Bytes { bytes, start } => {
                let after_outage = start.is_some() && self.bytes > 0;
                self.bytes += bytes.len() as u64;
                match &mut self.text {
                    Some(TextState { preamble, starts_mid_line }) => {
                        *starts_mid_line |= start == Some(StreamStart::Anywhere);
                        // The last line of a datagram may lack its newline.
                        let end = if is_datagram { LINE_END } else { b"" };
                        self.decoder.push(bytes, measurements);
                        self.decoder.push(end, measurements);
                        preamble.push(bytes, false)?;
                        preamble.push(end, measurements.len() > first)?;
                        if *starts_mid_line && measurements.len() > first {
                            measurements.remove(first);
                            *starts_mid_line = false;
                        }
                    }
                    None => {
                        if after_outage {
                            // A new decoder is created, so that partial messages are not joined
                            // across the outage.
                            self.previous_counts = self.previous_counts + self.decoder.counts();
                            self.decoder = (self.make_decoder)()?;
                        }
                        self.decoder.push(bytes, measurements);
                    }
                }
                ReadOutcome::Data { after_outage }
            }
            Received::NoData => ReadOutcome::NoData,
            Received::End if !self.has_ended && self.text.is_some() => {
                self.has_ended = true;
                self.decoder.push(LINE_END, measurements);
                ReadOutcome::Data { after_outage: false }
            }
            Received::End => ReadOutcome::End,
        };
        self.measurements += (measurements.len() - first) as u64;
        Ok(outcome)
    }

    fn report(&self) -> DeviceReport {
        DeviceReport {
            port: self.port.port().to_string(),
            format: self.format,
            failure: self.port.failure().cloned(),
            bytes: self.bytes,
            counts: self.counts(),
            measurements: self.measurements,
            foreign_datagrams: self.port.foreign_datagrams(),
        }
    }
}
