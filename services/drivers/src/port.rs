//! The ways in.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    net::UdpSocket,
    time::Duration,
};

use launch::{Ingest, Serial, Source};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fd::AsFd,
    fs::{Mode, OFlags, open},
    io::{Errno, read},
    termios::{ControlModes, OptionalActions, QueueSelector, ioctl_tiocexcl, tcflush, tcgetattr, tcsetattr},
};

/// A port that is open.
pub(crate) enum Port {
    /// What comes on the supervisor's standard input. It is this process's standard output: on its own it was told its configuration.
    Stdin,
    /// Datagrams.
    Udp(UdpSocket),
    /// A serial line.
    Serial(File),
}

/// What a port gave.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Given {
    /// So many bytes.
    Bytes(usize),
    /// None within the limit.
    Nothing,
    /// Nothing comes any more.
    End,
}

impl Port {
    /// Opens the port of a source.
    pub(crate) fn open(ingest: &Ingest) -> io::Result<Self> {
        match ingest.source {
            Source::Udp => {
                let socket = UdpSocket::bind(&ingest.udp.listen)?;
                socket.set_nonblocking(true)?;
                Ok(Self::Udp(socket))
            }
            Source::Serial => serial(&ingest.serial).map(Self::Serial),
            _ => Ok(Self::Stdin),
        }
    }

    /// Reads what is there, or comes within the limit.
    pub(crate) fn read(&mut self, bytes: &mut [u8], limit: Duration) -> io::Result<Given> {
        let given = match self {
            Self::Stdin => {
                let port = io::stdout();
                is_readable(&port, limit)?.then(|| Ok(read(port.as_fd(), bytes)?))
            }
            Self::Udp(socket) => is_readable(&*socket, limit)?.then(|| socket.recv(bytes)),
            Self::Serial(file) => is_readable(&*file, limit)?.then(|| file.read(bytes)),
        };
        match given {
            None => Ok(Given::Nothing),
            Some(Ok(0)) if !matches!(self, Self::Udp(_)) => Ok(Given::End),
            Some(Ok(count)) => Ok(Given::Bytes(count)),
            Some(Err(error)) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => {
                Ok(Given::Nothing)
            }
            Some(Err(error)) => Err(error),
        }
    }
}

/// Opens a serial line for this process alone: eight bits, no parity, one stop bit, no flow control, bytes as they come. Nothing is written.
fn serial(line: &Serial) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = open(&line.port, flags, Mode::empty())?;
    let mut terminal = tcgetattr(&fd)?;
    terminal.make_raw();
    terminal.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    terminal.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS;
    terminal.set_speed(u32::try_from(line.baud).unwrap_or(u32::MAX))?;
    tcsetattr(&fd, OptionalActions::Now, &terminal)?;
    ioctl_tiocexcl(&fd)?;
    // What came before belongs to a time that nobody knows.
    tcflush(&fd, QueueSelector::IFlush)?;
    Ok(fd.into())
}

/// Bytes are there, or the end, before the limit.
fn is_readable(port: &impl AsFd, limit: Duration) -> io::Result<bool> {
    let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
    match poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&limit)) {
        Ok(count) => Ok(count > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
