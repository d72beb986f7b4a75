//! What the service manager is told (sd_notify(3)): that the system runs, that its data flows, that it ends.
//!
//! The watchdog is fed by ticks that arrive at the collector and by nothing else: a supervisor that lives while its path stands still
//! is not alive.

use std::{
    env,
    ffi::OsStr,
    io,
    os::{
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            net::{SocketAddr, UnixDatagram},
        },
    },
    time::{Duration, Instant},
};

use crate::UpError;

/// How long a manager that does not listen is waited for.
const WAIT: Duration = Duration::from_millis(10);
/// The watchdog is fed so many times as often as it asks for.
const FEEDS: u32 = 4;

/// Tells the service manager, where there is one.
#[derive(Debug)]
pub(crate) struct Notifier {
    manager: Option<UnixDatagram>,
    /// Between two feeds of the watchdog, where there is one.
    interval: Option<Duration>,
    fed: Instant,
    fed_tick: u64,
    /// It has been told of the end.
    stopping: bool,
}

impl Notifier {
    /// As the environment says: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
    pub(crate) fn new() -> Result<Self, UpError> {
        let manager = env::var_os("NOTIFY_SOCKET").filter(|address| !address.is_empty());
        let manager = manager
            .map(|address| connect(&address))
            .transpose()
            .map_err(|cause| UpError::System { doing: "calling the service manager at NOTIFY_SOCKET".into(), cause })?;
        Ok(Self {
            manager,
            interval: watchdog().map(|limit| limit / FEEDS),
            fed: Instant::now(),
            fed_tick: 0,
            stopping: false,
        })
    }

    /// Every service runs.
    pub(crate) fn ready(&mut self) {
        self.send("READY=1");
        self.fed = Instant::now();
    }

    /// Ticks have come up to this one.
    pub(crate) fn flowing(&mut self, next_tick: u64) {
        if next_tick > self.fed_tick && self.interval.is_some_and(|interval| self.fed.elapsed() >= interval) {
            (self.fed, self.fed_tick) = (Instant::now(), next_tick);
            self.send("WATCHDOG=1");
        }
    }

    /// The end has begun.
    pub(crate) fn stopping(&mut self) {
        if !std::mem::replace(&mut self.stopping, true) {
            self.send("STOPPING=1");
        }
    }

    fn send(&self, state: &str) {
        if let Some(manager) = &self.manager {
            // A manager that cannot be told draws its own conclusions.
            let _ = manager.send(state.as_bytes());
        }
    }
}

fn connect(address: &OsStr) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    socket.set_write_timeout(Some(WAIT))?;
    match address.as_bytes() {
        [b'@', name @ ..] => socket.connect_addr(&SocketAddr::from_abstract_name(name)?)?,
        _ => socket.connect(address)?,
    }
    Ok(socket)
}

/// After how long without being fed the service manager ends this process.
fn watchdog() -> Option<Duration> {
    let of_another = env::var("WATCHDOG_PID").is_ok_and(|pid| pid != std::process::id().to_string());
    let limit_us: u64 = env::var("WATCHDOG_USEC").ok()?.parse().ok()?;
    Some(Duration::from_micros(limit_us)).filter(|_| !of_another)
}
