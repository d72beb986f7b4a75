//! The decoder of a format.

use decoders::{
    Decoder,
    framed::Framed,
    lines::{Lines, LinesError, Settings},
};
use launch::Format;

/// A decoder of what a device sends, before its first byte.
pub(crate) fn decoder(format: &Format) -> Result<Box<dyn Decoder>, LinesError> {
    match format {
        // Half a line where a port is opened in the midst of one is left out by whoever opens it.
        Format::Csv => {
            let settings = Settings { begins_whole: true, ..Settings::default() };
            Ok(Box::new(Framed::new(Lines::new(&settings)?)))
        }
    }
}
