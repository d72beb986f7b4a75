//! A port that is opened again when it goes away.

use std::{
    io, thread,
    time::{Duration, Instant},
};

use launch::Port;

use crate::port::{Given, OpenPort};

/// Bytes read at once, at most.
const BYTES: usize = 1 << 16;
/// From one attempt to open the port to the next: at first, and at most.
const PAUSE: Duration = Duration::from_millis(100);
const PAUSE_MAX: Duration = Duration::from_secs(5);

/// A port, whether or not it is there.
pub(crate) struct Line {
    port: Port,
    open: Option<OpenPort>,
    bytes: Vec<u8>,
    pause: Duration,
    again: Instant,
    absence: Option<Absence>,
    /// An earlier process has read of the same input.
    goes_on: bool,
    begins: Option<Begin>,
    strangers: u64,
}

/// Why a port is not there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Absence {
    /// What the system said.
    pub(crate) found: String,
    /// What to do about it.
    pub(crate) remedy: &'static str,
}

/// How bytes stand to those before them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Begin {
    /// They are the first since the port was opened, and begin with a whole message.
    Whole,
    /// They are the first since the port was opened, and may begin in the midst of a message.
    Anywhere,
}

/// What was taken of it.
pub(crate) enum Taken<'a> {
    /// Bytes.
    Bytes {
        /// What came.
        bytes: &'a [u8],
        /// Nothing if they go on from those before them.
        begin: Option<Begin>,
    },
    /// None within the limit.
    Nothing,
    /// Nothing comes any more.
    End,
}

impl Line {
    pub(crate) fn new(port: Port, goes_on: bool) -> Self {
        Self {
            port,
            open: None,
            bytes: vec![0; BYTES],
            pause: PAUSE,
            again: Instant::now(),
            absence: None,
            goes_on,
            begins: None,
            strangers: 0,
        }
    }

    pub(crate) fn port(&self) -> &Port {
        &self.port
    }

    /// Why it is not there, if it is not.
    pub(crate) fn absence(&self) -> Option<&Absence> {
        self.absence.as_ref()
    }

    /// Datagrams of others than the one that is heard.
    pub(crate) fn strangers(&self) -> u64 {
        self.strangers + self.open.as_ref().map_or(0, OpenPort::strangers)
    }

    /// Takes what is there, or comes within the limit. A port that is not there is sought for again when its pause has passed.
    pub(crate) fn take(&mut self, limit: Duration) -> Taken<'_> {
        let now = Instant::now();
        if self.open.is_none() {
            if now < self.again {
                thread::sleep((self.again - now).min(limit));
                return Taken::Nothing;
            }
            match OpenPort::open(&self.port) {
                Ok(open) => {
                    self.open = Some(open);
                    self.absence = None;
                    self.begins = Some(match self.port {
                        Port::Serial { .. } => Begin::Anywhere,
                        Port::Stdin if self.goes_on => Begin::Anywhere,
                        _ => Begin::Whole,
                    });
                }
                Err(error) => self.give_up(&error),
            }
        }
        let Some(open) = &mut self.open else { return Taken::Nothing };
        match open.read(&mut self.bytes, limit) {
            Ok(Given::Bytes(count)) => {
                self.pause = PAUSE;
                let bytes = self.bytes.get(..count).unwrap_or_default();
                Taken::Bytes { bytes, begin: self.begins.take() }
            }
            Ok(Given::Nothing) => Taken::Nothing,
            Ok(Given::End) if self.port == Port::Stdin => Taken::End,
            Ok(Given::End) => {
                self.give_up(&io::Error::other("it was closed at the other end"));
                Taken::Nothing
            }
            Err(error) => {
                self.give_up(&error);
                Taken::Nothing
            }
        }
    }

    fn give_up(&mut self, error: &io::Error) {
        self.strangers = self.strangers();
        self.open = None;
        self.again = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(PAUSE_MAX);
        self.absence = Some(Absence { found: error.to_string(), remedy: remedy(&self.port, error) });
    }
}

/// What to do where the port is not there.
fn remedy(port: &Port, error: &io::Error) -> &'static str {
    match (port, error.kind()) {
        (Port::Udp(_), io::ErrorKind::AddrInUse) => "another program has the port: end it, or set another `listen`",
        (Port::Udp(_), _) => "name an address of this machine and a free port",
        (Port::Tcp(_), io::ErrorKind::ConnectionRefused) => "start the program that listens there",
        (Port::Tcp(_), _) => "see that the host is there and that its name, address and port are right",
        (Port::Serial { .. }, io::ErrorKind::PermissionDenied) => {
            "give this user the right to it: sudo usermod -aG dialout USER, and log in again"
        }
        (Port::Serial { .. }, io::ErrorKind::ResourceBusy) => "another program has it open: end that",
        (Port::Serial { .. }, _) => "plug the device in, and see that its name is right: ls /dev/serial/by-id",
        (Port::Stdin, _) => "give the supervisor something to read: PROGRAM | plumb up --source stdin",
    }
}
