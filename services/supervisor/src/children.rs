//! The services as processes: started, watched, ended, and reaped.

use std::{
    fs,
    io::{self, Read, Write},
    os::unix::process::{CommandExt, ExitStatusExt},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use launch::Service;
use runtime::Orders;
use rustix::process::{Pid, Signal, kill_process};

use crate::UpError;

/// From the first request to end until a process is killed.
const GRACE: Duration = Duration::from_millis(400);
/// What a service says last is kept up to this, bytes.
const SAID_MAX: u64 = 8192;

/// The processes of a system.
#[derive(Debug, Default)]
pub(crate) struct Children(Vec<Running>);

/// A service's process.
#[derive(Debug)]
pub(crate) struct Running {
    pub(crate) service: Service,
    pub(crate) pid: u32,
    child: Child,
    ended: Option<ExitStatus>,
}

impl Children {
    /// Starts every service in the order of the launch file.
    pub(crate) fn start(orders: &Orders) -> Result<Self, UpError> {
        let mut children = Self::default();
        for (service, incarnation) in orders.launch.services.iter().zip(1..) {
            let orders = Orders { incarnation, ..orders.clone() };
            let doing = || format!("starting the service {service}");
            let failed = |cause: io::Error| UpError::System { doing: doing(), cause };
            let text = serde_json::to_vec(&orders).map_err(|cause| failed(cause.into()))?;
            let mut child = Command::new(std::env::current_exe().map_err(failed)?)
                .args(["service", service.name()])
                .stdin(Stdio::piped())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                // Ctrl-C is for the supervisor, which ends the services in their order.
                .process_group(0)
                .spawn()
                .map_err(failed)?;
            let stdin = child.stdin.take();
            children.0.push(Running { service: *service, pid: child.id(), child, ended: None });
            if let Some(mut stdin) = stdin {
                stdin.write_all(&text).map_err(failed)?;
            }
        }
        Ok(children)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Running> {
        self.0.iter()
    }

    /// The first service that has ended, other than those in `expected`.
    pub(crate) fn ended(&mut self, expected: &[Service]) -> Option<UpError> {
        self.0.iter_mut().find_map(|running| {
            let status = running.reap()?;
            if expected.contains(&running.service) && status.success() {
                return None;
            }
            let how = match (status.code(), status.signal()) {
                (Some(code), _) => format!("ended with code {code}"),
                (None, Some(signal)) => format!("was ended by signal {signal}"),
                (None, None) => "ended".into(),
            };
            let said = running.said();
            let said = if said.is_empty() { said } else { format!(":\n{said}") };
            Some(UpError::ServiceEnded { service: running.service, pid: running.pid, how, said })
        })
    }

    /// Asks one service to end.
    pub(crate) fn ask_to_end(&self, service: Service) {
        self.0.iter().filter(|running| running.service == service).for_each(|running| running.signal(Signal::TERM));
    }

    /// Ends every process and reaps it.
    pub(crate) fn end(&mut self) {
        let deadline = Instant::now() + GRACE;
        self.0.iter().for_each(|running| running.signal(Signal::TERM));
        while self.0.iter_mut().any(|running| running.reap().is_none()) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        for running in &mut self.0 {
            if running.reap().is_none() {
                running.signal(Signal::KILL);
                // A killed process ends; the wait is for the kernel only.
                running.ended = running.child.wait().ok();
            }
        }
    }

    /// CPU time of all processes since they started, s.
    pub(crate) fn cpu_s(&self) -> f64 {
        self.0.iter().map(|running| cpu_s(&running.pid.to_string())).sum()
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        self.end();
    }
}

impl Running {
    fn reap(&mut self) -> Option<ExitStatus> {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended
    }

    fn signal(&self, signal: Signal) {
        if self.ended.is_some() {
            return;
        }
        if let Some(pid) = Pid::from_raw(self.pid as i32) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, signal);
        }
    }

    /// What an ended service said last.
    fn said(&mut self) -> String {
        let mut said = Vec::new();
        if let Some(stderr) = self.child.stderr.take() {
            // What cannot be read cannot be shown; the exit status is.
            let _ = stderr.take(SAID_MAX).read_to_end(&mut said);
        }
        String::from_utf8_lossy(&said).trim_end().to_owned()
    }
}

/// CPU time of this process, s.
pub(crate) fn own_cpu_s() -> f64 {
    cpu_s("self")
}

/// CPU time of a process of one thread, s; 0 when it is no more.
fn cpu_s(process: &str) -> f64 {
    let text = fs::read_to_string(format!("/proc/{process}/schedstat")).unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}
