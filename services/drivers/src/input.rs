//! Interface of a device, and the report on its state.

use std::time::Duration;

use decoders::{Counts, Measurement};

use crate::{error::DriversError, reconnecting_port::DeviceFailure};

/// Maximum wait for bytes. It limits the time between two health messages.
pub(crate) const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// Device that yields measurements.
pub(crate) trait Input {
    /// Reads the available bytes, waiting at most `timeout`, and appends the decoded measurements.
    fn read(&mut self, timeout: Duration, measurements: &mut Vec<Measurement>) -> Result<ReadOutcome, DriversError>;

    /// Returns the state and the totals of the device.
    fn report(&self) -> DeviceReport;
}

/// Result of reading a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReadOutcome {
    /// The device sent bytes.
    Data {
        /// `true` if the device was unavailable before, so that measurements may be missing.
        after_outage: bool,
    },
    /// No bytes arrived before the timeout.
    NoData,
    /// The input has ended.
    End,
}

/// State of a device and its totals since the start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct DeviceReport {
    /// Display name of the port.
    pub(crate) port: String,
    /// Name of the format.
    pub(crate) format: &'static str,
    /// Reason why the device is unavailable, or `None` if it is open.
    pub(crate) failure: Option<DeviceFailure>,
    /// Number of received bytes.
    pub(crate) bytes: u64,
    /// Totals of the decoder.
    pub(crate) counts: Counts,
    /// Number of decoded measurements that the device is required to provide: rate and force of a
    /// sensor, fixes of a receiver.
    pub(crate) measurements: u64,
    /// Number of ignored datagrams from other senders.
    pub(crate) foreign_datagrams: u64,
    /// Number of datagrams that the kernel dropped before they were read.
    pub(crate) dropped_datagrams: u64,
}
