//! The decoder of a format.

use decoders::Decoder;
use launch::Format;

use crate::csv::Csv;

/// A decoder of what a device sends, before its first byte.
pub(crate) fn decoder(format: &Format) -> Box<dyn Decoder> {
    match format {
        Format::Csv => Box::new(Csv::default()),
    }
}
