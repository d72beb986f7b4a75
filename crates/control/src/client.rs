//! Client side of the control socket.

use std::{
    io::{self, BufRead, BufReader, ErrorKind, Read, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use bus::{BusError, SystemName};
use foreign::ForeignText;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use serde::de::DeserializeOwned;

use crate::{ControlRequest, MAX_LINE_BYTES, RESPONSE_TIMEOUT, Response, completion_timeout};

/// Time after which a notification is no longer retried.
const NOTIFY_TIMEOUT: Duration = Duration::from_secs(30);
/// Pause between two attempts to deliver a notification.
const NOTIFY_RETRY_PAUSE: Duration = Duration::from_millis(100);

/// Error of a request to a running system.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The system name is invalid or belongs to another user.
    #[error(transparent)]
    Name(#[from] BusError),
    /// The control socket could not be opened.
    #[error("opening {path}: {cause}", path = foreign::path(path))]
    Open {
        /// Path of the socket.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The system is not running.
    #[error(
        "contacting the system {name:?}: it is not running ({cause}); start it with `plumb up`, or select another one with --system"
    )]
    NotRunning {
        /// System name.
        name: String,
        /// Operating system error.
        cause: io::Error,
    },
    /// The supervisor did not respond in time.
    #[error(
        "contacting the system {name:?}: its supervisor has not responded for {timeout_s:.0} s; it may be frozen or the machine overloaded; check with `plumb doctor`"
    )]
    Timeout {
        /// System name.
        name: String,
        /// Elapsed timeout, s.
        timeout_s: f64,
    },
    /// The request failed.
    #[error("contacting the system {name:?}: {}", cause.with_lines())]
    Failed {
        /// System name.
        name: String,
        /// Cause of the failure.
        cause: ForeignText,
    },
}

/// Sends a request to a running system and waits for the response.
///
/// A response must arrive within two seconds. The result of an acknowledged swap may take longer,
/// and that of a shadow arrives when the shadow ends.
///
/// # Errors
///
/// Fails if the system is not running, does not respond in time or rejects the request.
pub fn send_request<A: DeserializeOwned>(name: &str, request: &ControlRequest) -> Result<A, ControlError> {
    let not_running = |cause| ControlError::NotRunning { name: name.into(), cause };
    let socket = SystemName::new(name)?.control_socket_path().map_err(|error| match error {
        BusError::File { cause, .. } => not_running(cause),
        error => ControlError::Name(error),
    })?;
    let failed_with = |cause: String| ControlError::Failed { name: name.into(), cause: cause.into() };
    let io_failure = |timeout: Option<Duration>| {
        move |cause: io::Error| match (cause.kind(), timeout) {
            (ErrorKind::WouldBlock, Some(timeout)) => {
                ControlError::Timeout { name: name.into(), timeout_s: timeout.as_secs_f64() }
            }
            // The supervisor ended before it had read the request.
            (ErrorKind::ConnectionReset | ErrorKind::BrokenPipe, _) => {
                ControlError::NotRunning { name: name.into(), cause }
            }
            _ => ControlError::Failed { name: name.into(), cause: cause.to_string().into() },
        }
    };
    let mut stream = connect_socket(&socket).map_err(|cause| match cause.kind() {
        ErrorKind::WouldBlock => {
            failed_with("too many clients are waiting; its supervisor may be frozen; check with `plumb doctor`".into())
        }
        _ => not_running(cause),
    })?;
    let text = serde_json::to_string(request).map_err(|cause| failed_with(cause.to_string()))?;
    stream.set_write_timeout(Some(RESPONSE_TIMEOUT)).map_err(io_failure(None))?;
    // If the supervisor rejected this client, the write may fail, but the reason for the rejection
    // can still be read.
    let sent = writeln!(stream, "{text}");
    let mut reader = BufReader::new(stream);
    for timeout in [Some(RESPONSE_TIMEOUT), completion_timeout(request)] {
        reader.get_ref().set_read_timeout(timeout).map_err(io_failure(None))?;
        let mut line = String::new();
        let count = reader.by_ref().take(MAX_LINE_BYTES as u64).read_line(&mut line).map_err(io_failure(timeout))?;
        if count == 0 {
            sent.map_err(io_failure(Some(RESPONSE_TIMEOUT)))?;
            return Err(failed_with("the connection was closed before the response; try again".into()));
        }
        match serde_json::from_str::<Response<A>>(&line).map_err(|cause| failed_with(cause.to_string()))? {
            Response::Accepted => {}
            Response::Completed(response) => return Ok(response),
            Response::Error(cause) => return Err(failed_with(cause)),
        }
    }
    Err(failed_with("the request was acknowledged twice".into()))
}

/// Connects to a control socket. Fails with `WouldBlock` if the socket's queue is full.
pub(super) fn connect_socket(path: &Path) -> io::Result<UnixStream> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(&socket, &SocketAddrUnix::new(path)?)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}

/// Sends a notification and retries until the supervisor has responded, 30 s have elapsed or
/// `should_stop` returns `true`.
///
/// A service can start before the control socket is open. A notification that cannot be delivered
/// within this time is dropped.
pub fn notify(system: &str, request: &ControlRequest, should_stop: impl Fn() -> bool) {
    let deadline = Instant::now() + NOTIFY_TIMEOUT;
    while send_request::<()>(system, request).is_err() && Instant::now() < deadline && !should_stop() {
        thread::sleep(NOTIFY_RETRY_PAUSE);
    }
}
