//! Baud rate of a serial line.

use crate::keys::keys;

keys! {
    /// Settings of a serial line.
    #[derive(Copy, Eq)]
    pub struct SerialLine {
        /// Baud rate, with 8 data bits, no parity, 1 stop bit and no flow control.
        baud: u64 = 115_200, 50..=20_000_000, unit "bit/s";
    }
}
