//! The processes of the system: started, listened to, ended, reaped.
//!
//! Input: what is to be started or ended. Output: processes, and how each ended. Time: the clock, after a death and at the end. Failure: what cannot be
//! started is said; a process that has gone needs no signal.

use std::{
    collections::BTreeMap,
    fs,
    io::{self, Write},
    os::{
        fd::{AsFd, OwnedFd},
        unix::{
            fs::MetadataExt as _,
            process::{CommandExt, ExitStatusExt},
        },
    },
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, SyncSender, TrySendError},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use bus::{MORE_MEMORY, SharedMemory};
use launch::{Service, Source};
use runtime::{ServiceConfig, clock::cpu_ns, stderr_tail::StderrTail};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, WaitIdStatus, kill_process, pidfd_open, waitid},
};

use crate::scheduling::{self, SchedulingClass};

/// In how many parts of a second the kernel tells times there.
const USER_HZ: f64 = 100.0;
/// From the first request to end until a process is killed.
const GRACE: Duration = Duration::from_millis(800);

/// Dead processes that may wait to be reaped beside the supervisor.
const DEAD_MAX: usize = 64;
/// From a death until the process is reaped: its threads have cleared up after themselves by then. Whoever reaps it before that computes in the kernel
/// until they have, and takes the processor that they need for it. At the end nobody waits for that.
const DEAD_PAUSE: Duration = Duration::from_millis(300);
const DEAD_LOOK: Duration = Duration::from_millis(5);
/// How long the end waits until the dead are reaped.
const REAP_LIMIT: Duration = Duration::from_millis(200);

/// The processes that have not ended, by incarnation.
#[derive(Debug, Default)]
pub(crate) struct Processes {
    all: BTreeMap<u32, Process>,
    /// To whom the dead go: to take one out of the kernel's table can last for seconds while somebody looks into its folder of `/proc`.
    reaping: Option<Reaping>,
}

/// The thread that reaps.
#[derive(Debug)]
struct Reaping {
    dead: SyncSender<Dead>,
    ends: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

/// A process that has ended.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) incarnation: u32,
    /// How, for people.
    pub(crate) how: String,
    /// The end of what it said on standard error.
    pub(crate) stderr: String,
}

/// A process that has ended, and when that was seen.
type Dead = (Child, Instant);

#[derive(Debug)]
struct Process {
    pid: u32,
    child: Child,
    fd: Option<OwnedFd>,
    stderr: StderrTail,
}

impl Processes {
    /// Starts a service; its process.
    pub(crate) fn start(
        &mut self,
        service: Service,
        config: &ServiceConfig,
        class: SchedulingClass,
    ) -> Result<u32, String> {
        let failed = |cause| format!("starting the service {service}: {cause}");
        let process = Process::start(service, config).map_err(failed)?;
        let pid = process.pid;
        scheduling::set(pid, class);
        self.all.insert(config.incarnation, process);
        Ok(pid)
    }

    /// Those that have ended since the last time; the others are listened to, so that none has to wait for a reader.
    pub(crate) fn reap(&mut self) -> Vec<Exit> {
        let mut exits = Vec::new();
        let ended = self.all.extract_if(.., |incarnation, process| {
            process.stderr.listen();
            let Some(status) = process.ended() else { return false };
            exits.push(Exit { incarnation: *incarnation, how: how(status), stderr: process.stderr.text() });
            true
        });
        let dead: Vec<_> = ended.map(|(_, process)| process.child).collect();
        dead.into_iter().for_each(|child| self.reap_beside(child));
        exits
    }

    /// Has a process that has ended reaped by a thread of its own; by this one where there is none, or it has too many.
    fn reap_beside(&mut self, child: Child) {
        self.reaping = self.reaping.take().or_else(Reaping::start);
        let sent = match &self.reaping {
            Some(Reaping { dead, .. }) => dead.try_send((child, Instant::now())),
            None => Err(TrySendError::Disconnected((child, Instant::now()))),
        };
        if let Err(TrySendError::Full((mut child, _)) | TrySendError::Disconnected((mut child, _))) = sent {
            // It has ended: only the kernel is waited for.
            let _ = child.wait();
        }
    }

    pub(crate) fn signal(&self, incarnation: u32, signal: Signal) {
        self.all.get(&incarnation).into_iter().for_each(|process| process.signal(signal));
    }

    pub(crate) fn schedule(&self, incarnation: u32, class: SchedulingClass) {
        self.all.get(&incarnation).into_iter().for_each(|process| scheduling::set(process.pid, class));
    }

    /// Sleeps until a process ends, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        let fds = self.all.values().filter_map(|process| process.fd.as_ref());
        let mut fds: Vec<_> = fds.map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
        let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
        // A signal ends it too: the caller looks again.
        let _ = poll(&mut fds, Some(&limit));
    }

    /// Kills all of them.
    pub(crate) fn kill(&mut self) {
        self.all.values().for_each(|process| process.signal(Signal::KILL));
        for process in std::mem::take(&mut self.all).into_values() {
            // A killed process ends; the wait is for the kernel only.
            let _ = process.state(WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
            self.reap_beside(process.child);
        }
    }

    /// Ends and reaps all of them.
    pub(crate) fn end(&mut self) {
        let deadline = Instant::now() + GRACE;
        self.all.values().for_each(|process| process.signal(Signal::TERM));
        while !self.all.is_empty() && Instant::now() < deadline {
            self.reap();
            std::thread::sleep(Duration::from_millis(2));
        }
        self.kill();
        if let Some(reaping) = self.reaping.take() {
            reaping.end();
        }
    }

    /// CPU time of all of them since they started, s, and of those that have been reaped.
    pub(crate) fn cpu_s(&self) -> f64 {
        self.all.values().map(|process| cpu_s(process.pid)).sum::<f64>() + reaped_cpu_s()
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        self.end();
    }
}

impl Process {
    fn start(service: Service, config: &ServiceConfig) -> io::Result<Self> {
        let text = serde_json::to_string(config)?;
        let mut child = Command::new(program()?)
            .args(["service", service.name()])
            .stdin(Stdio::piped())
            .stdout(output(service, config)?)
            .stderr(Stdio::piped())
            // Ctrl-C is for the supervisor, which ends the services.
            .process_group(0)
            .spawn()?;
        let (stdin, stderr) = (child.stdin.take(), StderrTail::on(child.stderr.take()));
        let pid = child.id();
        let fd = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        let process = Self { pid, child, fd, stderr };
        // One that has ended before it read its configuration is found when it is reaped.
        let written = stdin.map_or(Ok(()), |mut stdin| stdin.write_all(text.as_bytes()));
        match written.map_err(|cause| (cause.kind(), cause)) {
            Err((kind, cause)) if kind != io::ErrorKind::BrokenPipe => {
                process.signal(Signal::KILL);
                Err(cause)
            }
            _ => Ok(process),
        }
    }

    /// How it has ended, if it has; it stays in the kernel's table.
    fn ended(&self) -> Option<ExitStatus> {
        let status = self.state(WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT)?;
        let raw = status.exit_status().map(|code| code << 8).or(status.terminating_signal())?;
        Some(ExitStatus::from_raw(raw))
    }

    fn state(&self, options: WaitIdOptions) -> Option<WaitIdStatus> {
        waitid(WaitId::Pid(Pid::from_raw(self.pid as i32)?), options).ok()?
    }

    fn signal(&self, signal: Signal) {
        if let Some(pid) = Pid::from_raw(self.pid as i32) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, signal);
        }
    }
}

impl Reaping {
    fn start() -> Option<Self> {
        let (dead, sent) = mpsc::sync_channel::<Dead>(DEAD_MAX);
        let ends = Arc::new(AtomicBool::new(false));
        let ending = ends.clone();
        let work = move || {
            // The kernel may compute for long to clear up after a process.
            scheduling::set(scheduling::OWN, SchedulingClass::Leaving);
            for (mut child, since) in sent {
                while since.elapsed() < DEAD_PAUSE && !ending.load(Ordering::SeqCst) {
                    thread::sleep(DEAD_LOOK);
                }
                let _ = child.wait();
            }
        };
        let thread = thread::Builder::new().name("reaping".into()).spawn(work).ok()?;
        Some(Self { dead, ends, thread })
    }

    /// Reaps at once those that wait; what takes longer is left to the kernel when this process ends.
    fn end(self) {
        self.ends.store(true, Ordering::SeqCst);
        drop(self.dead);
        let deadline = Instant::now() + REAP_LIMIT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// The program that runs here, also where an upgrade has put another in the place of its file: all processes of a run are of one version.
fn program() -> io::Result<PathBuf> {
    let running = PathBuf::from("/proc/self/exe");
    let file = std::env::current_exe()?;
    let identity = |path: &Path| fs::metadata(path).map(|file| (file.dev(), file.ino())).ok();
    Ok(if identity(&file) == identity(&running) { file } else { running })
}

/// What a service has in the place of its standard output, on which none of them says anything: the drivers have there what comes on the
/// supervisor's standard input, where that is the source; their own brings the configuration.
fn output(service: Service, config: &ServiceConfig) -> io::Result<Stdio> {
    match service {
        Service::Drivers if config.launch.ingest.source == Source::Stdin => {
            Ok(io::stdin().as_fd().try_clone_to_owned()?.into())
        }
        _ => Ok(Stdio::null()),
    }
}

fn how(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(0), _) => "ended with code 0, as if somebody else had sent it SIGTERM".into(),
        (Some(code), _) => format!("ended with code {code}"),
        (None, Some(libc::SIGBUS)) => {
            let state = SharedMemory::now().map_or(String::new(), |memory| format!("{memory}; "));
            format!("found no memory for its part of the bus (signal 7): {state}{MORE_MEMORY}")
        }
        (None, Some(signal)) => format!("was ended by signal {signal}"),
        (None, None) => "ended".into(),
    }
}

/// CPU time of this process, s.
pub(crate) fn own_cpu_s() -> f64 {
    cpu_s(std::process::id())
}

/// CPU time of the processes that this one has reaped, s: the times `cutime` and `cstime` of proc(5).
fn reaped_cpu_s() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of the executable, in parentheses, may have spaces; the state is the first word after it, and the third of the line.
    let words = text.rsplit_once(')').map_or("", |(_, words)| words).split_whitespace();
    words.skip(16 - 3).take(2).filter_map(|word| word.parse::<f64>().ok()).sum::<f64>() / USER_HZ
}

/// CPU time of a process, s; 0 when it is no more.
fn cpu_s(pid: u32) -> f64 {
    cpu_ns(pid).map_or(0.0, |ns| ns as f64 * 1e-9)
}
