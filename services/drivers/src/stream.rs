//! A device whose bytes come over a port.

use std::time::Duration;

use decoders::{Counts, Decoder, Measurement};
use launch::Port;

use crate::{
    DriversError,
    beginning::Beginning,
    input::{Input, Report, Step},
    line::{Begin, Line, Taken},
};

/// Makes a decoder that has seen nothing.
type Make = Box<dyn Fn() -> Result<Box<dyn Decoder>, DriversError>>;

/// The port, and what its bytes are.
pub(crate) struct Stream {
    line: Line,
    format: &'static str,
    make: Make,
    decoder: Box<dyn Decoder>,
    /// Of the decoders before this one.
    before: Counts,
    /// Of lines, which know their columns from the first of them.
    text: Option<Text>,
    bytes: u64,
    measurements: u64,
    has_ended: bool,
}

struct Text {
    beginning: Beginning,
    /// The first line is the rest of one, which may look like a whole one with half a number.
    is_cut: bool,
}

const LINE_END: &[u8] = b"\n";

impl Stream {
    /// `goes_on`: an earlier process has read of the same input. `beginning`: of lines.
    pub(crate) fn open(
        port: Port,
        format: &'static str,
        goes_on: bool,
        beginning: Option<Beginning>,
        make: Make,
    ) -> Result<Self, DriversError> {
        let mut decoder = make()?;
        if let Some(beginning) = &beginning {
            // What an earlier process has sent of it is not sent again.
            decoder.push(beginning.text(), &mut Vec::new());
        }
        Ok(Self {
            line: Line::new(port, goes_on),
            format,
            make,
            decoder,
            before: Counts::default(),
            text: beginning.map(|beginning| Text { beginning, is_cut: false }),
            bytes: 0,
            measurements: 0,
            has_ended: false,
        })
    }

    fn counts(&self) -> Counts {
        self.before + self.decoder.counts()
    }
}

impl Input for Stream {
    fn take(&mut self, limit: Duration, found: &mut Vec<Measurement>) -> Result<Step, DriversError> {
        let before = found.len();
        let is_datagram = matches!(self.line.port(), Port::Udp(_));
        let step = match self.line.take(limit) {
            Taken::Bytes { bytes, begin } => {
                let after_absence = begin.is_some() && self.bytes > 0;
                self.bytes += bytes.len() as u64;
                match &mut self.text {
                    Some(Text { beginning, is_cut }) => {
                        *is_cut |= begin == Some(Begin::Anywhere);
                        // The last line of a datagram may lack its end.
                        let end = if is_datagram { LINE_END } else { b"" };
                        self.decoder.push(bytes, found);
                        self.decoder.push(end, found);
                        beginning.see(bytes, false)?;
                        beginning.see(end, found.len() > before)?;
                        if *is_cut && found.len() > before {
                            found.remove(before);
                            *is_cut = false;
                        }
                    }
                    None => {
                        if after_absence {
                            // No half of a message meets another half.
                            self.before = self.before + self.decoder.counts();
                            self.decoder = (self.make)()?;
                        }
                        self.decoder.push(bytes, found);
                    }
                }
                Step::Given { after_absence }
            }
            Taken::Nothing => Step::Nothing,
            Taken::End if !self.has_ended && self.text.is_some() => {
                self.has_ended = true;
                self.decoder.push(LINE_END, found);
                Step::Given { after_absence: false }
            }
            Taken::End => Step::End,
        };
        self.measurements += (found.len() - before) as u64;
        Ok(step)
    }

    fn report(&self) -> Report {
        Report {
            place: self.line.port().to_string(),
            format: self.format,
            absence: self.line.absence().cloned(),
            bytes: self.bytes,
            counts: self.counts(),
            measurements: self.measurements,
            strangers: self.line.strangers(),
        }
    }
}
