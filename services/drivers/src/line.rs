//! A port that is opened again when it goes away.

use std::{
    io, thread,
    time::{Duration, Instant},
};

use control::ControlRequest;
use launch::{Ingest, Service, Source};

use crate::port::{Given, Port};

/// Bytes read at once, at most.
const BYTES: usize = 1 << 16;
/// From one attempt to open the port to the next: at first, and at most.
const PAUSE: Duration = Duration::from_millis(100);
const PAUSE_MAX: Duration = Duration::from_secs(5);
/// How long the supervisor is sought for, to be told something.
const TELL_LIMIT: Duration = Duration::from_secs(5);

/// The port of the source, whether or not it is there.
pub(crate) struct Line {
    ingest: Ingest,
    system: String,
    port: Option<Port>,
    bytes: Vec<u8>,
    pause: Duration,
    again: Instant,
    /// Why it is not there, as the supervisor was told.
    told: Option<String>,
    /// An earlier process has read of the same input.
    goes_on: bool,
    begins_anywhere: bool,
}

/// What was taken of it.
pub(crate) enum Taken<'a> {
    /// Bytes.
    Bytes {
        /// What came.
        bytes: &'a [u8],
        /// They are the first since the port was opened, and may begin in the midst of a message.
        begin_anywhere: bool,
    },
    /// None within the limit.
    Nothing,
    /// Nothing comes any more.
    End,
}

impl Line {
    pub(crate) fn new(ingest: &Ingest, system: String, goes_on: bool) -> Self {
        Self {
            ingest: ingest.clone(),
            system,
            port: None,
            bytes: vec![0; BYTES],
            pause: PAUSE,
            again: Instant::now(),
            told: None,
            goes_on,
            begins_anywhere: false,
        }
    }

    /// Takes what is there, or comes within the limit. A port that is not there is sought for again when its pause has passed.
    pub(crate) fn take(&mut self, limit: Duration) -> Taken<'_> {
        let now = Instant::now();
        if self.port.is_none() {
            if now < self.again {
                thread::sleep((self.again - now).min(limit));
                return Taken::Nothing;
            }
            match Port::open(&self.ingest) {
                Ok(port) => {
                    self.port = Some(port);
                    self.begins_anywhere = match self.ingest.source {
                        Source::Serial => true,
                        Source::Stdin => self.goes_on,
                        _ => false,
                    };
                    if self.told.is_some() {
                        self.tell(format!("{} is open", place(&self.ingest)));
                    }
                }
                Err(error) => self.give_up(&error),
            }
        }
        let Some(port) = &mut self.port else { return Taken::Nothing };
        match port.read(&mut self.bytes, limit) {
            Ok(Given::Bytes(count)) => {
                (self.pause, self.told) = (PAUSE, None);
                let bytes = self.bytes.get(..count).unwrap_or_default();
                Taken::Bytes { bytes, begin_anywhere: std::mem::take(&mut self.begins_anywhere) }
            }
            Ok(Given::Nothing) => Taken::Nothing,
            Ok(Given::End) if self.ingest.source == Source::Stdin => Taken::End,
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

    /// The port is not there. That is told once for each cause.
    fn give_up(&mut self, error: &io::Error) {
        self.port = None;
        self.again = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(PAUSE_MAX);
        let why = error.to_string();
        if self.told.as_ref() != Some(&why) {
            let place = place(&self.ingest);
            self.tell(format!("reading {place}: {why}; {}; it is tried again", remedy(&self.ingest, error)));
            self.told = Some(why);
        }
    }

    fn tell(&self, what: String) {
        let (system, deadline) = (self.system.clone(), Instant::now() + TELL_LIMIT);
        let news = ControlRequest::Tell { service: Service::Drivers.name().into(), what };
        thread::spawn(move || {
            while control::ask::<()>(&system, &news).is_err() && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(100));
            }
        });
    }
}

/// The port, for people.
fn place(ingest: &Ingest) -> String {
    match ingest.source {
        Source::Udp => format!("datagrams to {}", ingest.udp.listen),
        Source::Serial => ingest.serial.port.display().to_string(),
        _ => "standard input".into(),
    }
}

/// What to do where the port is not there.
fn remedy(ingest: &Ingest, error: &io::Error) -> &'static str {
    match (ingest.source, error.kind()) {
        (Source::Udp, io::ErrorKind::AddrInUse) => "another program has the port: end it, or set another `listen`",
        (Source::Udp, _) => "set `listen` in [ingest.udp] to an address of this machine and a free port",
        (Source::Serial, io::ErrorKind::PermissionDenied) => {
            "give this user the right to it: sudo usermod -aG dialout USER, and log in again"
        }
        (Source::Serial, io::ErrorKind::ResourceBusy) => "another program has it open: end that",
        (Source::Serial, _) => "plug the device in, and look at `port` in [ingest.serial]",
        _ => "give the supervisor something to read: PROGRAM | plumb up --source stdin",
    }
}
