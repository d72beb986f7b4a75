//! One life of a service: a process, what it says, and how it ends.

use std::{
    io::{self, Write},
    os::{fd::OwnedFd, unix::process::CommandExt},
    process::{Child, Command, ExitStatus, Stdio},
    time::Instant,
};

use launch::Service;
use messages::Health;
use runtime::{Orders, Role, said::Said};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};

use crate::UpError;

/// One life.
#[derive(Debug)]
pub(super) struct Process {
    pub(super) pid: u32,
    pub(super) incarnation: u32,
    /// It publishes from its start on.
    pub(super) owns: bool,
    /// What it said of itself last.
    pub(super) heard: Option<Health>,
    /// When it did; before its first word, when it was started.
    pub(super) quiet_since: Instant,
    /// Its silence since then has been forgiven once.
    pub(super) forgiven: bool,
    pub(super) said: Said,
    child: Child,
    pub(super) fd: Option<OwnedFd>,
    pub(super) since: Instant,
    pub(super) ended: Option<ExitStatus>,
    /// It was asked to end.
    pub(super) asked: bool,
    /// It was killed because it said nothing.
    pub(super) given_up: bool,
}

impl Process {
    /// Starts the service.
    pub(super) fn start(service: Service, orders: &Orders) -> Result<Self, UpError> {
        let of_ones_own =
            orders.launch.program(service).map_or(String::new(), |program| format!(" ({})", program.command.join(" ")));
        Self::spawn(service, orders)
            .map_err(|cause| UpError::System { doing: format!("starting the service {service}{of_ones_own}"), cause })
    }

    /// Starts this executable as the service, or what the launch file names for the slot.
    fn command(service: Service, orders: &Orders) -> io::Result<Command> {
        if let Some(program) = orders.launch.program(service) {
            return Ok(program.command());
        }
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["service", service.name()]);
        Ok(command)
    }

    fn spawn(service: Service, orders: &Orders) -> io::Result<Self> {
        let text = orders.text(service).map_err(io::Error::other)?;
        let mut child = Self::command(service, orders)?
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl-C is for the supervisor, which ends the services in their order.
            .process_group(0)
            .spawn()?;
        let (stdin, said) = (child.stdin.take(), Said::on(child.stderr.take()));
        let pid = child.id();
        let fd = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        let incarnation = orders.incarnation;
        let since = Instant::now();
        let process = Self {
            pid,
            incarnation,
            owns: orders.role != Role::Candidate,
            heard: None,
            quiet_since: since,
            forgiven: false,
            said,
            child,
            fd,
            since,
            ended: None,
            asked: false,
            given_up: false,
        };
        // One that has ended before it read its orders is found when it is reaped.
        stdin.map_or(Ok(()), |mut stdin| stdin.write_all(text.as_bytes())).or_else(|cause| match cause.kind() {
            io::ErrorKind::BrokenPipe => Ok(()),
            _ => Err(cause),
        })?;
        Ok(process)
    }

    /// Whether it has ended; until then it is listened to, so that it need not wait for a reader.
    pub(super) fn reap(&mut self) -> Option<ExitStatus> {
        self.said.listen();
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended
    }

    /// Ends it in any case.
    pub(super) fn kill(&mut self) {
        self.signal(Signal::KILL);
        // A killed process ends; the wait is for the kernel only.
        self.ended = self.child.wait().ok();
    }

    pub(super) fn signal(&self, signal: Signal) {
        if self.ended.is_some() {
            return;
        }
        if let Some(pid) = Pid::from_raw(self.pid as i32) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, signal);
        }
    }
}

/// CPU time of this process, s.
pub(crate) fn own_cpu_s() -> f64 {
    cpu_s("self")
}

/// CPU time of the threads of a process, s; 0 when it is no more.
pub(super) fn cpu_s(process: &str) -> f64 {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    let ns = threads.filter_map(|thread| {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    });
    ns.sum::<f64>() * 1e-9
}
