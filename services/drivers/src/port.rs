//! Open ports: standard input, datagrams, TCP connections and serial ports.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket},
    path::Path,
    time::Duration,
};

use launch::Port;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fd::AsFd,
    fs::{Mode, OFlags, open},
    io::{Errno, read},
    termios::{ControlModes, OptionalActions, QueueSelector, ioctl_tiocexcl, tcflush, tcgetattr, tcsetattr},
};

use crate::drop_counter::DropCounter;

/// Time limit for a TCP connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Descriptor from which the standard input of `plumb up` is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StdinDescriptor {
    /// Standard input of this process.
    Own,
    /// Standard output of this process. The supervisor passes its standard input there, because
    /// the standard input of a service carries the configuration.
    Passed,
}

/// Port that is open for reading.
pub(crate) enum OpenPort {
    /// Standard input of `plumb up`.
    Stdin(StdinDescriptor),
    /// Datagrams from any sender.
    Udp(DatagramPort),
    /// TCP connection.
    Tcp(TcpStream),
    /// Serial port.
    Serial(File),
}

/// Datagram socket, with the number of datagrams that were dropped because its buffer was full.
pub(crate) struct DatagramPort {
    socket: UdpSocket,
    drops: DropCounter,
}

/// Result of reading a port.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum PortRead {
    /// Bytes were read.
    Bytes {
        /// Number of bytes.
        count: usize,
        /// Sender of a datagram.
        sender: Option<SocketAddr>,
    },
    /// No bytes arrived before the timeout.
    NoData,
    /// The input has ended.
    End,
}

impl OpenPort {
    pub(crate) fn open(port: &Port, stdin: StdinDescriptor) -> io::Result<Self> {
        match port {
            Port::Stdin => Ok(Self::Stdin(stdin)),
            Port::Udp(address) => {
                let socket = UdpSocket::bind(address)?;
                socket.set_nonblocking(true)?;
                Ok(Self::Udp(DatagramPort { drops: DropCounter::new(&socket)?, socket }))
            }
            Port::Tcp(address) => connect(address).map(Self::Tcp),
            Port::Serial { path, line } => open_serial(path, line.baud).map(Self::Serial),
        }
    }

    /// Reads the available bytes, waiting at most `timeout`.
    pub(crate) fn read(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<PortRead> {
        let result = match self {
            Self::Stdin(StdinDescriptor::Own) => read_descriptor(&io::stdin(), bytes, timeout)?,
            Self::Stdin(StdinDescriptor::Passed) => read_descriptor(&io::stdout(), bytes, timeout)?,
            Self::Udp(datagrams) => return datagrams.read(bytes, timeout),
            Self::Tcp(stream) => is_readable(&*stream, timeout)?.then(|| stream.read(bytes)),
            Self::Serial(file) => is_readable(&*file, timeout)?.then(|| file.read(bytes)),
        };
        match result {
            None => Ok(PortRead::NoData),
            Some(Ok(0)) => Ok(PortRead::End),
            Some(result) => no_data_if_interrupted(result.map(|count| (count, None))),
        }
    }

    /// Returns the number of datagrams that the kernel dropped since the port was opened.
    pub(crate) fn dropped_datagrams(&self) -> u64 {
        if let Self::Udp(datagrams) = self { datagrams.drops.total() } else { 0 }
    }
}

impl DatagramPort {
    fn read(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<PortRead> {
        self.drops.update();
        if !is_readable(&self.socket, timeout)? {
            return Ok(PortRead::NoData);
        }
        no_data_if_interrupted(self.socket.recv_from(bytes).map(|(count, sender)| (count, Some(sender))))
    }
}

/// Reads the available bytes of a descriptor, without buffering further bytes. Returns `None` if no
/// bytes arrive before the timeout.
fn read_descriptor(port: &impl AsFd, bytes: &mut [u8], timeout: Duration) -> io::Result<Option<io::Result<usize>>> {
    Ok(is_readable(port, timeout)?.then(|| Ok(read(port.as_fd(), bytes)?)))
}

/// Converts the result of a read. An interrupted read and one that would block count as no data.
fn no_data_if_interrupted(result: io::Result<(usize, Option<SocketAddr>)>) -> io::Result<PortRead> {
    match result {
        Ok((count, sender)) => Ok(PortRead::Bytes { count, sender }),
        Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => Ok(PortRead::NoData),
        Err(error) => Err(error),
    }
}

/// Connects to a host, at the first of its addresses that accepts a connection.
fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last_error = io::Error::new(ErrorKind::NotFound, "the host has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nonblocking(true)?;
                // Keepalive detects a peer that disappeared without closing the connection.
                rustix::net::sockopt::set_socket_keepalive(&stream, true)?;
                return Ok(stream);
            }
            Err(error) => last_error = error,
        }
    }
    Err(last_error)
}

/// Opens a serial port exclusively and read-only, for raw bytes with eight data bits, no parity,
/// one stop bit and no flow control.
fn open_serial(path: &Path, baud: u64) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = open(path, flags, Mode::empty())?;
    let mut terminal = tcgetattr(&fd)?;
    terminal.make_raw();
    terminal.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    terminal.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS;
    terminal.set_speed(u32::try_from(baud).unwrap_or(u32::MAX))?;
    tcsetattr(&fd, OptionalActions::Now, &terminal)?;
    ioctl_tiocexcl(&fd)?;
    // Bytes received before opening are discarded, because their arrival time is unknown.
    tcflush(&fd, QueueSelector::IFlush)?;
    Ok(fd.into())
}

/// Waits up to `timeout` for bytes or the end of the input. Returns `true` if either is available.
pub(crate) fn is_readable(port: &impl AsFd, timeout: Duration) -> io::Result<bool> {
    let timeout = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
    match poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&timeout)) {
        Ok(count) => Ok(count > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
