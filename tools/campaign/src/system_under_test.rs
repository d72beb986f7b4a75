//! System under test: `plumb up` in a separate process, observed over the bus.

use std::{
    fs::{self, File},
    io,
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use bus::{Bus, Subscriber, SystemName};
use launch::Service;
use messages::{AttitudeOutput, Health, SystemEvent};
use runtime::clock::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use tempfile::TempDir;

use crate::CampaignError;

/// Timeout for the first attitude.
const START_TIMEOUT: Duration = Duration::from_secs(20);
/// Name of the launch file in the system's folder.
const LAUNCH_FILE: &str = "launch.toml";
/// Interval between two checks for the address of the cockpit.
const COCKPIT_INTERVAL_NS: u64 = 20_000_000;
/// Maximum number of messages read from a topic per poll.
const MAX_MESSAGES_PER_POLL: usize = 4096;

pub(crate) struct SystemUnderTest {
    process: SystemProcess,
    attitude: Subscriber<AttitudeOutput>,
    health: Subscriber<Health>,
    event: Subscriber<SystemEvent>,
    pids: [u32; Service::PATH.len()],
    killed: [u32; Service::PATH.len()],
    outputs: Vec<AttitudeOutput>,
    events: Vec<SystemEvent>,
    bus: Bus,
}

/// Totals from the report of `plumb up --json`.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct RunTotals {
    pub(crate) ticks_out: u64,
    pub(crate) lost: u64,
    pub(crate) duplicated: u64,
}

impl SystemUnderTest {
    /// Starts a system with the launch file `text` and waits for its first attitude.
    ///
    /// The system runs for `duration_s`, or until it is interrupted. `buffer` is the number of
    /// messages buffered per topic.
    pub(crate) fn start(name: &str, text: &str, duration_s: Option<f64>, buffer: usize) -> Result<Self, CampaignError> {
        let io_error = |action| move |cause| CampaignError::Io { action, cause };
        let folder = tempfile::tempdir().map_err(io_error("creating a folder"))?;
        let file = folder.path().join(LAUNCH_FILE);
        fs::write(&file, text).map_err(io_error("writing the launch file"))?;
        let log = File::create(folder.path().join("log")).map_err(io_error("writing the log"))?;
        let report = File::create(folder.path().join("report")).map_err(io_error("writing the report"))?;
        let child = Command::new(std::env::current_exe().map_err(io_error("finding plumb"))?)
            .args(["up", "--launch"])
            .arg(&file)
            .arg("--json")
            .args(duration_s.iter().flat_map(|duration_s| ["--for".into(), format!("{duration_s}s")]))
            .arg("--out")
            .arg(folder.path().join("attitude.csv"))
            // The state saved for the next start must stay in the folder.
            .env("XDG_STATE_HOME", folder.path())
            .env_remove("STATE_DIRECTORY")
            .stdin(Stdio::null())
            .stdout(report)
            .stderr(log)
            .spawn()
            .map_err(io_error("starting plumb up"))?;
        let mut process = SystemProcess { child, folder };
        let bus = process.join_bus(name)?;
        let mut system = Self {
            process,
            attitude: bus.subscriber(buffer)?,
            health: bus.subscriber(MAX_MESSAGES_PER_POLL / 64)?,
            event: bus.subscriber(MAX_MESSAGES_PER_POLL / 64)?,
            pids: [0; Service::PATH.len()],
            killed: [0; Service::PATH.len()],
            outputs: Vec::new(),
            events: Vec::new(),
            bus,
        };
        let deadline = Instant::now() + START_TIMEOUT;
        while system.outputs.is_empty() || system.pids.contains(&0) {
            system.poll()?;
            if Instant::now() > deadline {
                return Err(CampaignError::Timeout {
                    timeout_s: START_TIMEOUT.as_secs(),
                    log: system.process.keep_log(),
                });
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(system)
    }

    /// Reads new messages and checks that the system is still running.
    pub(crate) fn poll(&mut self) -> Result<(), CampaignError> {
        if supervisor::is_stop_requested() {
            return Err(CampaignError::Interrupted);
        }
        let Self { attitude, health, event, pids, killed, outputs, events, .. } = self;
        attitude.drain(MAX_MESSAGES_PER_POLL, |output| outputs.push(output))?;
        event.drain(MAX_MESSAGES_PER_POLL, |event| events.push(event))?;
        health.drain(MAX_MESSAGES_PER_POLL, |health| {
            if let Some((pid, last)) = pids.get_mut(health.service as usize).zip(killed.get(health.service as usize))
                && health.pid != *last
            {
                *pid = health.pid;
            }
        })?;
        self.process.check_running()
    }

    /// Polls until `at_ns` (CLOCK_MONOTONIC).
    pub(crate) fn poll_until(&mut self, at_ns: u64) -> Result<(), CampaignError> {
        while monotonic_ns() < at_ns {
            self.poll()?;
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// Returns the attitudes received since the start or the last [`Self::clear_outputs`].
    pub(crate) fn outputs(&self) -> &[AttitudeOutput] {
        &self.outputs
    }

    /// Returns the events received since the start or the last [`Self::clear_outputs`].
    pub(crate) fn events(&self) -> &[SystemEvent] {
        &self.events
    }

    /// Discards the attitudes and events received so far.
    pub(crate) fn clear_outputs(&mut self) {
        self.outputs.clear();
        self.events.clear();
    }

    /// Returns the path of the launch file.
    pub(crate) fn launch_file(&self) -> PathBuf {
        self.process.folder.path().join(LAUNCH_FILE)
    }

    /// Waits until the system has announced the address of its cockpit. Returns `None` after a
    /// timeout. The timeout is not an error, because the system also runs without its cockpit.
    pub(crate) fn wait_for_cockpit(&mut self) -> Result<Option<String>, CampaignError> {
        let log = self.process.folder.path().join("log");
        let deadline = Instant::now() + START_TIMEOUT;
        while Instant::now() < deadline {
            let text = fs::read_to_string(&log).unwrap_or_default();
            let complete_lines = text.rsplit_once('\n').map_or("", |(lines, _)| lines).lines();
            if let Some(address) = complete_lines.into_iter().find_map(|line| line.strip_prefix("cockpit: ")) {
                return Ok(Some(address.into()));
            }
            self.poll_until(monotonic_ns() + COCKPIT_INTERVAL_NS)?;
        }
        Ok(None)
    }

    /// Sends SIGINT to the system to make it exit.
    pub(crate) fn interrupt(&self) {
        // If the process has already ended, `wait_for_end` detects it.
        let _ = Pid::from_raw(self.process.child.id() as i32).map(|pid| kill_process(pid, Signal::INT));
    }

    /// Kills a service and returns the time of the kill in ns (CLOCK_MONOTONIC). Returns `None` if
    /// the service has not reported a new process since the previous kill.
    pub(crate) fn kill(&mut self, service: Service) -> Option<u64> {
        let pid = Pid::from_raw(std::mem::take(&mut self.pids[service as usize]) as i32)?;
        self.killed[service as usize] = pid.as_raw_nonzero().get() as u32;
        let at_ns = monotonic_ns();
        kill_process(pid, Signal::KILL).ok().map(|()| at_ns)
    }

    /// Returns the tick that follows the tick of the newest sample.
    pub(crate) fn next_tick(&self) -> u64 {
        self.bus.next_tick(graph::Topic::Imu.entry())
    }

    /// Waits for the system to exit and returns its totals and its attitude file.
    pub(crate) fn wait_for_end(mut self, timeout: Duration) -> Result<(RunTotals, Vec<u8>), CampaignError> {
        let io_error = |action| move |cause| CampaignError::Io { action, cause };
        let deadline = Instant::now() + timeout;
        while self.process.child.try_wait().map_err(io_error("waiting for the end"))?.is_none() {
            // The attitudes are read while waiting. An unread topic would not block the system, but
            // its buffer would overflow.
            self.attitude.drain(MAX_MESSAGES_PER_POLL, |output| self.outputs.push(output))?;
            if Instant::now() > deadline {
                return Err(CampaignError::Timeout { timeout_s: timeout.as_secs(), log: self.process.keep_log() });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let read_file =
            |name: &str| fs::read(self.process.folder.path().join(name)).map_err(io_error("reading the result"));
        let report = read_file("report")?;
        let last = report.trim_ascii().rsplit(|byte| *byte == b'\n').next().unwrap_or_default();
        let totals = serde_json::from_slice(last)
            .map_err(|cause| CampaignError::Io { action: "reading the report", cause: io::Error::from(cause) })?;
        Ok((totals, read_file("attitude.csv")?))
    }
}

/// Process of the system, and the system's folder. The process is terminated on drop.
struct SystemProcess {
    child: Child,
    folder: TempDir,
}

impl SystemProcess {
    /// Waits until the process owns the system's name, then joins the bus of the system.
    fn join_bus(&mut self, name: &str) -> Result<Bus, CampaignError> {
        let system_name = SystemName::new(name)?;
        let deadline = Instant::now() + START_TIMEOUT;
        loop {
            self.check_running()?;
            if system_name.owner_pid()? == Some(self.child.id()) {
                match Bus::join(&system_name, "campaign") {
                    Ok(bus) => return Ok(bus),
                    Err(error) if Instant::now() > deadline => return Err(error.into()),
                    Err(_) => {}
                }
            } else if Instant::now() > deadline {
                return Err(CampaignError::Timeout { timeout_s: START_TIMEOUT.as_secs(), log: self.keep_log() });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn check_running(&mut self) -> Result<(), CampaignError> {
        if let Ok(None) = self.child.try_wait() {
            return Ok(());
        }
        let log = self.keep_log();
        let text = fs::read_to_string(&log).unwrap_or_default();
        let last_line = text.lines().next_back().unwrap_or("it printed nothing");
        Err(CampaignError::EarlyExit { message: last_line.into(), log })
    }

    fn keep_log(&mut self) -> PathBuf {
        self.folder.disable_cleanup(true);
        self.folder.path().join("log")
    }
}

impl Drop for SystemProcess {
    fn drop(&mut self) {
        if let (Ok(None), Some(pid)) = (self.child.try_wait(), Pid::from_raw(self.child.id() as i32)) {
            // On SIGTERM, the system stops its services and removes its files.
            let _ = kill_process(pid, Signal::TERM);
            let _ = self.child.wait();
        }
    }
}

/// Returns the text of a launch file with simulated sensors and an unlimited number of restarts.
/// The text ends with the section `[ingest.sim]`.
pub(crate) fn launch_text(name: &str, services: &[Service], rate_hz: u32) -> String {
    let services: Vec<_> = services.iter().map(|service| service.name()).collect();
    format!(
        "name = \"{name}\"\nservices = {services:?}\n[restart]\nmin_uptime_s = 0\n[ingest]\nsource = \"sim\"\n\
         [ingest.sim]\nrate_hz = {rate_hz}\n"
    )
}
