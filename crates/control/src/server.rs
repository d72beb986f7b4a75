//! The supervisor's side of the control socket.

use std::{
    fs::{self, Permissions},
    io::{ErrorKind, Read, Write},
    os::unix::{
        fs::{MetadataExt, PermissionsExt},
        net::{UnixListener, UnixStream},
    },
    path::Path,
    time::{Duration, Instant},
};

use bus::SystemName;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::Serialize;

use crate::{ControlError, ControlRequest, MAX_LINE_BYTES, Response, is_long_running};

/// Maximum number of simultaneous clients.
pub(super) const MAX_CLIENTS: usize = 16;
/// Maximum number of connections accepted per poll. Further connections wait for the next poll.
const MAX_ACCEPTS_PER_POLL: usize = 64;
/// Time within which a client must send its request. Otherwise it is disconnected.
pub(super) const REQUEST_TIMEOUT: Duration = Duration::from_secs(1);

/// Listening control socket of a system and its connected clients.
#[derive(Debug)]
pub struct ControlSocket {
    listener: UnixListener,
    /// Inode of the socket's file.
    inode: u64,
    clients: Vec<Client>,
    next_client: u64,
    /// Clients that disconnected after sending a request.
    disconnected: Vec<u64>,
}

#[derive(Debug)]
struct Client {
    number: u64,
    stream: UnixStream,
    text: Vec<u8>,
    connected_at: Instant,
    has_request: bool,
    is_closed: bool,
}

impl ControlSocket {
    /// Opens the control socket of a system, accessible to this user only.
    ///
    /// # Errors
    ///
    /// Fails if the folder is not private to this user or the socket cannot be bound.
    pub fn open(system_name: &SystemName) -> Result<Self, ControlError> {
        let (listener, inode) = bind(&system_name.control_socket_path()?)?;
        Ok(Self { listener, inode, clients: Vec::new(), next_client: 0, disconnected: Vec::new() })
    }

    /// Opens the socket again if its file was removed or replaced. Returns `true` if it did so.
    /// Connected clients stay connected.
    ///
    /// # Errors
    ///
    /// Fails like [`open`](Self::open), or if another file at the socket's path cannot be removed.
    pub fn reopen_if_missing(&mut self, system_name: &SystemName) -> Result<bool, ControlError> {
        let path = system_name.control_socket_path()?;
        let failed = |cause| ControlError::Open { path: path.clone(), cause };
        match fs::symlink_metadata(&path) {
            Ok(found) if found.ino() == self.inode => return Ok(false),
            Ok(found) if found.is_dir() => fs::remove_dir(&path).map_err(failed)?,
            Ok(_) => fs::remove_file(&path).map_err(failed)?,
            Err(cause) if cause.kind() == ErrorKind::NotFound => {}
            Err(cause) => return Err(failed(cause)),
        }
        (self.listener, self.inode) = bind(&path)?;
        Ok(true)
    }

    /// Accepts clients and returns the requests that have arrived, each with the identifier of its
    /// client.
    pub fn poll_requests(&mut self) -> Vec<(u64, ControlRequest)> {
        self.accept_clients();
        let mut requests = Vec::new();
        let mut invalid = Vec::new();
        for client in &mut self.clients {
            match client.read_request() {
                Some(Ok(request)) => {
                    if is_long_running(&request) {
                        client.send(&Response::<()>::Accepted);
                    }
                    requests.push((client.number, request));
                }
                Some(Err(cause)) => invalid.push((client.number, cause)),
                None => {}
            }
        }
        for (client, cause) in invalid {
            self.send(client, &Response::<()>::Error(cause));
        }
        let disconnected =
            self.clients.iter().filter(|client| client.is_closed && client.has_request).map(|client| client.number);
        self.disconnected.extend(disconnected);
        self.clients.retain(|client| {
            !client.is_closed && (client.has_request || client.connected_at.elapsed() < REQUEST_TIMEOUT)
        });
        requests
    }

    /// Removes and returns the clients that disconnected while they waited for a response.
    pub fn take_disconnected(&mut self) -> Vec<u64> {
        std::mem::take(&mut self.disconnected)
    }

    /// Sends the response to a client and disconnects it.
    pub fn respond(&mut self, client: u64, response: &impl Serialize) {
        self.send(client, &Response::Completed(response));
    }

    /// Accepts new clients. Clients beyond [`MAX_CLIENTS`] receive an error.
    fn accept_clients(&mut self) {
        // Linux creates a socket for the client before it looks for one, so an `accept` without a
        // client costs several times as much as a poll.
        let mut listener = [PollFd::new(&self.listener, PollFlags::IN)];
        if poll(&mut listener, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })) == Ok(0) {
            return;
        }
        for _ in 0..MAX_ACCEPTS_PER_POLL {
            let Ok((stream, _)) = self.listener.accept() else { return };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            self.next_client += 1;
            let (number, connected_at) = (self.next_client, Instant::now());
            let mut client =
                Client { number, stream, text: Vec::new(), connected_at, has_request: false, is_closed: false };
            if self.clients.len() < MAX_CLIENTS {
                self.clients.push(client);
            } else {
                client.send(&Response::<()>::Error(format!(
                    "{MAX_CLIENTS} other clients are waiting for a response; try again"
                )));
            }
        }
    }

    fn send(&mut self, client: u64, response: &Response<impl Serialize>) {
        let Some(index) = self.clients.iter().position(|one| one.number == client) else { return };
        self.clients.swap_remove(index).send(response);
    }
}

/// Binds a socket that only this user can open. Returns it with the inode of its file.
fn bind(path: &Path) -> Result<(UnixListener, u64), ControlError> {
    let failed = |cause| ControlError::Open { path: path.to_owned(), cause };
    let listener = UnixListener::bind(path).map_err(failed)?;
    fs::set_permissions(path, Permissions::from_mode(0o600)).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let inode = fs::symlink_metadata(path).map_err(failed)?.ino();
    Ok((listener, inode))
}

impl Client {
    /// Returns the request once a full line has arrived. Returns `None` before that, or if the
    /// client has disconnected.
    fn read_request(&mut self) -> Option<Result<ControlRequest, String>> {
        let mut chunk = [0; 4096];
        loop {
            match self.stream.read(&mut chunk) {
                Ok(0) => {
                    self.is_closed = true;
                    return None;
                }
                Ok(count) => self.text.extend_from_slice(&chunk[..count]),
                Err(cause) if cause.kind() == ErrorKind::WouldBlock => break,
                Err(_) => {
                    self.is_closed = true;
                    return None;
                }
            }
            if self.text.len() > MAX_LINE_BYTES {
                return Some(Err(format!("the request is longer than {MAX_LINE_BYTES} bytes")));
            }
        }
        let end = self.text.iter().position(|byte| *byte == b'\n').filter(|_| !self.has_request)?;
        self.has_request = true;
        Some(serde_json::from_slice(&self.text[..end]).map_err(|cause| format!("invalid request: {cause}")))
    }

    fn send(&mut self, response: &Response<impl Serialize>) {
        let text = serde_json::to_string(response).unwrap_or_default();
        // The line fits into the socket buffer. Errors from disconnected clients are ignored.
        let _ = writeln!(self.stream, "{text}");
    }
}
