//! The ways in.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket},
    path::Path,
    time::{Duration, Instant},
};

use launch::Port;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fd::AsFd,
    fs::{Mode, OFlags, open},
    io::{Errno, read},
    termios::{ControlModes, OptionalActions, QueueSelector, ioctl_tiocexcl, tcflush, tcgetattr, tcsetattr},
};

/// How long a host is waited for that does not answer.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);
/// A sender of datagrams that says nothing for so long may be followed by another.
const SENDER_LIMIT: Duration = Duration::from_secs(2);

/// A port that is open.
pub(crate) enum OpenPort {
    /// What comes on the supervisor's standard input. It is this process's standard output: on its own it was told its configuration.
    Stdin,
    /// Datagrams of one sender.
    Udp(Datagrams),
    /// A connection.
    Tcp(TcpStream),
    /// A serial line.
    Serial(File),
}

/// Datagrams of the sender that was heard first; those of others are counted.
pub(crate) struct Datagrams {
    socket: UdpSocket,
    heard: Option<(SocketAddr, Instant)>,
    strangers: u64,
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

impl OpenPort {
    pub(crate) fn open(port: &Port) -> io::Result<Self> {
        match port {
            Port::Stdin => Ok(Self::Stdin),
            Port::Udp(address) => {
                let socket = UdpSocket::bind(address)?;
                socket.set_nonblocking(true)?;
                Ok(Self::Udp(Datagrams { socket, heard: None, strangers: 0 }))
            }
            Port::Tcp(address) => connect(address).map(Self::Tcp),
            Port::Serial { path, baud } => serial(path, *baud).map(Self::Serial),
        }
    }

    /// Reads what is there, or comes within the limit.
    pub(crate) fn read(&mut self, bytes: &mut [u8], limit: Duration) -> io::Result<Given> {
        let given = match self {
            Self::Stdin => {
                let port = io::stdout();
                is_readable(&port, limit)?.then(|| Ok(read(port.as_fd(), bytes)?))
            }
            Self::Udp(datagrams) => return datagrams.read(bytes, limit),
            Self::Tcp(stream) => is_readable(&*stream, limit)?.then(|| stream.read(bytes)),
            Self::Serial(file) => is_readable(&*file, limit)?.then(|| file.read(bytes)),
        };
        match given {
            None => Ok(Given::Nothing),
            Some(Ok(0)) => Ok(Given::End),
            Some(given) => or_nothing(given),
        }
    }

    /// Datagrams of others than the one that is heard.
    pub(crate) fn strangers(&self) -> u64 {
        if let Self::Udp(datagrams) = self { datagrams.strangers } else { 0 }
    }
}

impl Datagrams {
    fn read(&mut self, bytes: &mut [u8], limit: Duration) -> io::Result<Given> {
        if !is_readable(&self.socket, limit)? {
            return Ok(Given::Nothing);
        }
        let (count, sender) = match self.socket.recv_from(bytes) {
            Ok(received) => received,
            Err(error) => return or_nothing(Err(error)),
        };
        let now = Instant::now();
        match self.heard {
            Some((heard, at)) if heard != sender && now - at < SENDER_LIMIT => {
                self.strangers += 1;
                Ok(Given::Nothing)
            }
            _ => {
                self.heard = Some((sender, now));
                Ok(Given::Bytes(count))
            }
        }
    }
}

/// So many bytes, or none if that is all that is the matter.
fn or_nothing(given: io::Result<usize>) -> io::Result<Given> {
    match given {
        Ok(count) => Ok(Given::Bytes(count)),
        Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => Ok(Given::Nothing),
        Err(error) => Err(error),
    }
}

/// Of the addresses of the host the first one that answers.
fn connect(address: &str) -> io::Result<TcpStream> {
    let mut refused = io::Error::new(ErrorKind::NotFound, "the host has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_LIMIT) {
            Ok(stream) => {
                stream.set_nonblocking(true)?;
                // A host that has gone without a word is noticed after a while.
                rustix::net::sockopt::set_socket_keepalive(&stream, true)?;
                return Ok(stream);
            }
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

/// Opens a serial line for this process alone: eight bits, no parity, one stop bit, no flow control, bytes as they come. Nothing is written.
fn serial(path: &Path, baud: u64) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = open(path, flags, Mode::empty())?;
    let mut terminal = tcgetattr(&fd)?;
    terminal.make_raw();
    terminal.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    terminal.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS;
    terminal.set_speed(u32::try_from(baud).unwrap_or(u32::MAX))?;
    tcsetattr(&fd, OptionalActions::Now, &terminal)?;
    ioctl_tiocexcl(&fd)?;
    // What came before belongs to a time that nobody knows.
    tcflush(&fd, QueueSelector::IFlush)?;
    Ok(fd.into())
}

/// Bytes are there, or the end, before the limit.
pub(crate) fn is_readable(port: &impl AsFd, limit: Duration) -> io::Result<bool> {
    let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
    match poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&limit)) {
        Ok(count) => Ok(count > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
