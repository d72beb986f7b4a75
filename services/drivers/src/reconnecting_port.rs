//! Port that is reopened after a failure.

use std::{
    io,
    net::SocketAddr,
    thread,
    time::{Duration, Instant},
};

use launch::Port;
use rustix::io::Errno;

use crate::port::{OpenPort, PortRead, StdinDescriptor};

/// Maximum number of bytes per read.
const BUFFER_BYTES: usize = 1 << 16;
/// Initial pause before reopening a port. It doubles after each failed attempt, up to
/// [`MAX_RETRY_PAUSE`].
const MIN_RETRY_PAUSE: Duration = Duration::from_millis(100);
/// Maximum pause before reopening a port.
const MAX_RETRY_PAUSE: Duration = Duration::from_secs(5);

/// Port that may currently be closed.
pub(crate) struct ReconnectingPort {
    port: Port,
    open: Option<OpenPort>,
    bytes: Vec<u8>,
    pause: Duration,
    next_attempt: Instant,
    failure: Option<DeviceFailure>,
    origin: StreamOrigin,
    /// Start position of the next bytes, if the port has been opened since the last read.
    pending_start: Option<StreamStart>,
    /// Number of datagrams dropped on ports that have been closed since.
    dropped_datagrams: u64,
}

/// Origin of the bytes of a port.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StreamOrigin {
    /// `true` if an earlier process has read from the same input.
    pub(crate) is_resumed: bool,
    /// Descriptor of standard input.
    pub(crate) stdin: StdinDescriptor,
}

/// Reason why a device is unavailable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct DeviceFailure {
    /// Operating system error.
    pub(crate) cause: String,
    /// Suggested action.
    pub(crate) remedy: &'static str,
}

/// Position in the byte stream at which a newly opened port starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StreamStart {
    /// The first byte starts a message.
    MessageStart,
    /// The first byte may be in the middle of a message.
    Anywhere,
}

/// Result of reading a port.
pub(crate) enum Received<'a> {
    /// Bytes arrived.
    Bytes {
        /// Received bytes.
        bytes: &'a [u8],
        /// Position at which the stream starts; set only for the first bytes after the port was
        /// opened.
        start: Option<StreamStart>,
        /// Sender of a datagram.
        sender: Option<SocketAddr>,
    },
    /// No bytes arrived before the timeout.
    NoData,
    /// The input has ended.
    End,
}

impl ReconnectingPort {
    pub(crate) fn new(port: Port, origin: StreamOrigin) -> Self {
        Self {
            port,
            open: None,
            bytes: vec![0; BUFFER_BYTES],
            pause: MIN_RETRY_PAUSE,
            next_attempt: Instant::now(),
            failure: None,
            origin,
            pending_start: None,
            dropped_datagrams: 0,
        }
    }

    pub(crate) fn port(&self) -> &Port {
        &self.port
    }

    /// Returns the reason why the port is closed, or `None` if it is open.
    pub(crate) fn failure(&self) -> Option<&DeviceFailure> {
        self.failure.as_ref()
    }

    /// Returns the number of datagrams that the kernel dropped.
    pub(crate) fn dropped_datagrams(&self) -> u64 {
        self.dropped_datagrams + self.open.as_ref().map_or(0, OpenPort::dropped_datagrams)
    }

    /// Reads the available bytes, waiting at most `timeout`. A closed port is reopened once its
    /// retry delay has elapsed.
    pub(crate) fn read(&mut self, timeout: Duration) -> Received<'_> {
        let now = Instant::now();
        if self.open.is_none() {
            if now < self.next_attempt {
                thread::sleep((self.next_attempt - now).min(timeout));
                return Received::NoData;
            }
            match OpenPort::open(&self.port, self.origin.stdin) {
                Ok(open) => {
                    self.open = Some(open);
                    self.failure = None;
                    self.pending_start = Some(match self.port {
                        Port::Serial { .. } => StreamStart::Anywhere,
                        Port::Stdin if self.origin.is_resumed => StreamStart::Anywhere,
                        _ => StreamStart::MessageStart,
                    });
                }
                Err(error) => self.mark_failed(&error),
            }
        }
        let Some(open) = &mut self.open else { return Received::NoData };
        match open.read(&mut self.bytes, timeout) {
            Ok(PortRead::Bytes { count, sender }) => {
                self.pause = MIN_RETRY_PAUSE;
                let bytes = self.bytes.get(..count).unwrap_or_default();
                Received::Bytes { bytes, start: self.pending_start.take(), sender }
            }
            Ok(PortRead::NoData) => Received::NoData,
            Ok(PortRead::End) if self.port == Port::Stdin => Received::End,
            Ok(PortRead::End) => {
                self.mark_failed(&io::Error::other("connection closed by the peer"));
                Received::NoData
            }
            Err(error) => {
                self.mark_failed(&error);
                Received::NoData
            }
        }
    }

    fn mark_failed(&mut self, error: &io::Error) {
        self.dropped_datagrams = self.dropped_datagrams();
        self.open = None;
        self.next_attempt = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(MAX_RETRY_PAUSE);
        self.failure = Some(DeviceFailure { cause: error.to_string(), remedy: remedy(&self.port, error) });
    }
}

/// Returns the suggested action after `error`.
pub(crate) fn remedy(port: &Port, error: &io::Error) -> &'static str {
    match (port, error.kind()) {
        (Port::Udp(_), io::ErrorKind::AddrInUse) => "another program uses the port: stop it, or set another `listen`",
        (Port::Udp(_), _) => "set an address of this machine and a free port",
        (Port::Tcp(_), io::ErrorKind::ConnectionRefused) => "start the program that listens there",
        (Port::Tcp(_), _) => "check that the host is reachable and that its name, address and port are correct",
        (Port::Serial { .. }, io::ErrorKind::PermissionDenied) => {
            "grant this user access: sudo usermod -aG dialout USER, then log in again"
        }
        (Port::Serial { .. }, io::ErrorKind::ResourceBusy) => "another program uses it: stop that program",
        (Port::Serial { .. }, _) if Errno::from_io_error(error) == Some(Errno::NOTTY) => {
            "this file is not a serial port: name one of `ls /dev/serial/by-id`"
        }
        (Port::Serial { .. }, _) => "plug the device in and check its name: ls /dev/serial/by-id",
        (Port::Stdin, _) => "pipe data to the supervisor: PROGRAM | plumb up --source stdin",
    }
}
