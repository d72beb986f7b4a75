//! The system under test: `plumb up` as a process, watched from the bus.

use std::{
    fs::{self, File},
    io,
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use bus::{Bus, Subscriber, SystemName};
use launch::Service;
use messages::{AttitudeOutput, Health};
use runtime::clock::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use tempfile::TempDir;

use crate::CampaignError;

/// From the start until the first attitude.
const START_LIMIT: Duration = Duration::from_secs(20);
/// Messages taken at a look.
const LOOK: usize = 4096;

/// A running system.
pub(crate) struct SystemUnderTest {
    child: Child,
    folder: TempDir,
    attitude: Subscriber<AttitudeOutput>,
    health: Subscriber<Health>,
    pids: [u32; Service::PATH.len()],
    killed: [u32; Service::PATH.len()],
    outputs: Vec<AttitudeOutput>,
    _bus: Bus,
}

/// What `plumb up --json` says at its end, as far as it matters here.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct Outcome {
    pub(crate) ticks_out: u64,
    pub(crate) lost: u64,
    pub(crate) duplicated: u64,
}

impl SystemUnderTest {
    /// Starts the launch file `text` for so long, or until it is ended, and waits for the first attitude. `buffer` is what its topics hold.
    pub(crate) fn start(name: &str, text: &str, duration_s: Option<f64>, buffer: usize) -> Result<Self, CampaignError> {
        let system = |doing| move |cause| CampaignError::System { doing, cause };
        let folder = tempfile::tempdir().map_err(system("making a folder"))?;
        let file = folder.path().join("launch.toml");
        fs::write(&file, text).map_err(system("writing the launch file"))?;
        let log = File::create(folder.path().join("log")).map_err(system("writing the log"))?;
        let report = File::create(folder.path().join("report")).map_err(system("writing the report"))?;
        let child = Command::new(std::env::current_exe().map_err(system("finding plumb"))?)
            .arg("up")
            .arg(&file)
            .arg("--json")
            .args(duration_s.iter().flat_map(|duration_s| ["--for".into(), format!("{duration_s}s")]))
            .arg("--out")
            .arg(folder.path().join("attitude.csv"))
            .stdin(Stdio::null())
            .stdout(report)
            .stderr(log)
            .spawn()
            .map_err(system("starting plumb up"))?;
        let bus = Self::join(name)?;
        let mut system = Self {
            child,
            attitude: bus.subscriber(buffer)?,
            health: bus.subscriber(LOOK / 64)?,
            pids: [0; Service::PATH.len()],
            killed: [0; Service::PATH.len()],
            outputs: Vec::new(),
            folder,
            _bus: bus,
        };
        let deadline = Instant::now() + START_LIMIT;
        while system.outputs.is_empty() || system.pids.contains(&0) {
            system.look()?;
            if Instant::now() > deadline {
                return Err(CampaignError::Silent { limit_s: START_LIMIT.as_secs(), log: system.keep_log() });
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(system)
    }

    fn join(name: &str) -> Result<Bus, CampaignError> {
        let system_name = SystemName::new(name)?;
        let deadline = Instant::now() + START_LIMIT;
        loop {
            match Bus::join(&system_name, "campaign") {
                Ok(bus) => return Ok(bus),
                Err(error) if Instant::now() > deadline => return Err(error.into()),
                Err(_) => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }

    /// Takes what was published since the last look, and sees that the system runs.
    pub(crate) fn look(&mut self) -> Result<(), CampaignError> {
        let Self { attitude, health, pids, killed, outputs, .. } = self;
        attitude.drain(LOOK, |output| outputs.push(output))?;
        health.drain(LOOK, |health| {
            if let Some((pid, last)) = pids.get_mut(health.service as usize).zip(killed.get(health.service as usize))
                && health.pid != *last
            {
                *pid = health.pid;
            }
        })?;
        match self.child.try_wait() {
            Ok(None) => Ok(()),
            _ => Err(CampaignError::Ended { log: self.keep_log() }),
        }
    }

    /// Looks until `at_ns`.
    pub(crate) fn watch_until(&mut self, at_ns: u64) -> Result<(), CampaignError> {
        while monotonic_ns() < at_ns {
            self.look()?;
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// Every attitude seen so far.
    pub(crate) fn outputs(&self) -> &[AttitudeOutput] {
        &self.outputs
    }

    /// Forgets the attitudes seen so far.
    pub(crate) fn forget(&mut self) {
        self.outputs.clear();
    }

    /// Asks the system to end.
    pub(crate) fn interrupt(&self) {
        // One that has ended is found by whoever waits for its end.
        let _ = Pid::from_raw(self.child.id() as i32).map(|pid| kill_process(pid, Signal::INT));
    }

    /// Kills a service; when, ns. One that has not spoken since it was killed last is left alone.
    pub(crate) fn kill(&mut self, service: Service) -> Option<u64> {
        let pid = Pid::from_raw(std::mem::take(&mut self.pids[service as usize]) as i32)?;
        self.killed[service as usize] = pid.as_raw_nonzero().get() as u32;
        let at_ns = monotonic_ns();
        kill_process(pid, Signal::KILL).ok().map(|()| at_ns)
    }

    /// The tick after the newest sample.
    pub(crate) fn next_tick(&self) -> u64 {
        self._bus.next_tick(graph::Topic::Imu.entry())
    }

    /// Waits for the end; what the system said, and the attitudes it wrote.
    pub(crate) fn end(mut self, limit: Duration) -> Result<(Outcome, Vec<u8>), CampaignError> {
        let system = |doing| move |cause| CampaignError::System { doing, cause };
        let deadline = Instant::now() + limit;
        while self.child.try_wait().map_err(system("waiting for the end"))?.is_none() {
            // Whoever is not read holds up nobody; it is read so that nothing grows.
            self.attitude.drain(LOOK, |output| self.outputs.push(output))?;
            if Instant::now() > deadline {
                return Err(CampaignError::Silent { limit_s: limit.as_secs(), log: self.keep_log() });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let read = |name: &str| fs::read(self.folder.path().join(name)).map_err(system("reading the result"));
        let report = read("report")?;
        let last = report.trim_ascii().rsplit(|byte| *byte == b'\n').next().unwrap_or_default();
        let outcome = serde_json::from_slice(last)
            .map_err(|cause| CampaignError::System { doing: "reading the report", cause: io::Error::from(cause) })?;
        Ok((outcome, read("attitude.csv")?))
    }

    fn keep_log(&mut self) -> PathBuf {
        self.folder.disable_cleanup(true);
        self.folder.path().join("log")
    }
}

impl Drop for SystemUnderTest {
    fn drop(&mut self) {
        if let (Ok(None), Some(pid)) = (self.child.try_wait(), Pid::from_raw(self.child.id() as i32)) {
            // It ends its services and removes its name.
            let _ = kill_process(pid, Signal::TERM);
            let _ = self.child.wait();
        }
    }
}
