//! Notifications to the service manager, sd_notify(3): ready, watchdog, stopping.
//!
//! The watchdog is fed only when new ticks arrive at the collector. A supervisor whose data path
//! has stalled therefore counts as hung.

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

use crate::error::UpError;

/// Timeout for sending to a service manager that does not respond.
const SEND_TIMEOUT: Duration = Duration::from_millis(10);
/// Number of watchdog feeds per watchdog timeout.
const FEEDS_PER_TIMEOUT: u32 = 4;

/// Connection to the service manager, if there is one.
#[derive(Debug)]
pub(crate) struct Notifier {
    manager: Option<UnixDatagram>,
    /// Interval between two feeds of the watchdog; `None` without a watchdog.
    feed_interval: Option<Duration>,
    last_fed: Instant,
    last_fed_tick: u64,
    stopping: bool,
}

impl Notifier {
    /// Connects as specified by the environment: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
    pub(crate) fn new() -> Result<Self, UpError> {
        let manager = env::var_os("NOTIFY_SOCKET").filter(|address| !address.is_empty());
        let manager = manager.map(|address| connect(&address)).transpose().map_err(|cause| UpError::System {
            action: "connecting to the service manager at NOTIFY_SOCKET".into(),
            cause,
        })?;
        Ok(Self {
            manager,
            feed_interval: watchdog_timeout().map(|timeout| timeout / FEEDS_PER_TIMEOUT),
            last_fed: Instant::now(),
            last_fed_tick: 0,
            stopping: false,
        })
    }

    /// Reports that every service is running.
    pub(crate) fn notify_ready(&mut self) {
        self.send("READY=1");
        self.last_fed = Instant::now();
    }

    /// Feeds the watchdog if the tick has advanced and the feed interval has elapsed.
    pub(crate) fn feed_watchdog(&mut self, next_tick: u64) {
        if next_tick > self.last_fed_tick
            && self.feed_interval.is_some_and(|feed_interval| self.last_fed.elapsed() >= feed_interval)
        {
            (self.last_fed, self.last_fed_tick) = (Instant::now(), next_tick);
            self.send("WATCHDOG=1");
        }
    }

    /// Reports once that the shutdown has started.
    pub(crate) fn notify_stopping(&mut self) {
        if !std::mem::replace(&mut self.stopping, true) {
            self.send("STOPPING=1");
        }
    }

    fn send(&self, state: &str) {
        if let Some(manager) = &self.manager {
            // If a notification fails, the service manager's own timeouts apply.
            let _ = manager.send(state.as_bytes());
        }
    }
}

fn connect(address: &OsStr) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    socket.set_write_timeout(Some(SEND_TIMEOUT))?;
    match address.as_bytes() {
        [b'@', name @ ..] => socket.connect_addr(&SocketAddr::from_abstract_name(name)?)?,
        _ => socket.connect(address)?,
    }
    Ok(socket)
}

/// Returns the timeout of this process's watchdog; `None` without a watchdog.
fn watchdog_timeout() -> Option<Duration> {
    let is_for_other_process = env::var("WATCHDOG_PID").is_ok_and(|pid| pid != std::process::id().to_string());
    let timeout_us: u64 = env::var("WATCHDOG_USEC").ok()?.parse().ok()?;
    Some(Duration::from_micros(timeout_us)).filter(|_| !is_for_other_process)
}
