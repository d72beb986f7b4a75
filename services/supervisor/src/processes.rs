//! Processes of the system: start, monitoring, termination, reaping.
//!
//! - Input: processes to start or end.
//! - Output: running processes, and the exit status of each.
//! - Time: the system clock, for delays after an exit and at shutdown.
//! - Failure: a failed start is reported. Signals to an exited process are ignored.

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

use bus::{SHARED_MEMORY_REMEDY, SharedMemory};
use foreign::ForeignText;
use launch::{Service, Source};
use runtime::{ServiceConfig, clock::cpu_time_ns, stderr_tail::StderrTail};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, WaitIdStatus, kill_process, pidfd_open, waitid},
};

use crate::{
    kernel_state,
    orphans::Orphans,
    scheduling::{self, SchedulingClass},
};

/// Number of clock ticks per second. CPU times in `/proc/PID/stat` are in clock ticks.
const USER_HZ: f64 = 100.0;
/// Time allowed for a process to exit at shutdown before it is killed.
const TERMINATE_TIMEOUT: Duration = Duration::from_millis(800);

/// Shortest delay that is reported if a killed process takes long to exit.
const LATE_EXIT: Duration = Duration::from_millis(100);

/// Maximum number of exited processes that wait for the reaper thread.
const MAX_UNREAPED: usize = 64;
/// Delay between the exit of a process and its reaping, during which the threads of the process
/// clean up.
///
/// Reaping earlier would spin in the kernel until the threads have finished, on the processor that
/// the threads need. The delay is skipped at shutdown.
const REAP_DELAY: Duration = Duration::from_millis(300);
const REAP_POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Time limit for reaping at shutdown.
const REAP_TIMEOUT: Duration = Duration::from_millis(200);

/// Running processes by incarnation.
#[derive(Debug, Default)]
pub(crate) struct Processes {
    all: BTreeMap<u32, Process>,
    /// Thread that reaps exited processes. Reaping can take seconds while another process reads the
    /// exited process's `/proc` directory.
    reaper: Option<ReaperThread>,
    orphans: Orphans,
}

#[derive(Debug)]
struct ReaperThread {
    exited: SyncSender<ExitedChild>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

/// Exit of a process.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) incarnation: u32,
    /// Exit status, shown to the user.
    pub(crate) exit_status: String,
    /// Last output on standard error.
    pub(crate) stderr: ForeignText,
}

/// Exited child process and the time at which its exit was noticed.
type ExitedChild = (Child, Instant);

#[derive(Debug)]
struct Process {
    pid: u32,
    child: Child,
    fd: Option<OwnedFd>,
    stderr: StderrTail,
    killed: Option<Kill>,
}

/// Kill of a process that did not respond.
#[derive(Debug)]
struct Kill {
    at: Instant,
    /// State of the process in the kernel before the kill.
    kernel_state: String,
}

impl Processes {
    /// Starts a service and returns its process ID.
    ///
    /// # Errors
    ///
    /// Returns a message for the user if the process could not be started or configured.
    pub(crate) fn start(
        &mut self,
        service: Service,
        config: &ServiceConfig,
        class: SchedulingClass,
    ) -> Result<u32, String> {
        let failed = |cause| format!("cannot start service {service}: {cause}");
        let process = Process::start(service, config).map_err(failed)?;
        let pid = process.pid;
        self.orphans.add_known(pid);
        scheduling::set_class(pid, class);
        self.all.insert(config.incarnation, process);
        Ok(pid)
    }

    /// Returns the processes that have exited since the previous call.
    ///
    /// Also reads the standard error of running processes, so that none blocks on a full pipe.
    pub(crate) fn reap(&mut self) -> Vec<Exit> {
        let with_events = self.with_events();
        let mut exits = Vec::new();
        let ended = self.all.extract_if(.., |incarnation, process| {
            if !with_events.contains(incarnation) {
                return false;
            }
            process.stderr.poll();
            let Some(status) = process.exit_status() else { return false };
            exits.push(Exit {
                incarnation: *incarnation,
                exit_status: describe_exit(status) + &process.killed.as_ref().map_or_else(String::new, Kill::describe),
                stderr: process.stderr.text(),
            });
            true
        });
        let children: Vec<_> = ended.map(|(_, process)| process.child).collect();
        children.into_iter().for_each(|child| self.reap_in_background(child));
        self.orphans.poll(!exits.is_empty());
        exits
    }

    /// Returns the incarnations of the processes that have exited or written to standard error.
    ///
    /// One call for all processes costs less than a call for each of them.
    fn with_events(&self) -> Vec<u32> {
        let fds = self.all.iter().flat_map(|(incarnation, process)| {
            let exit = process.fd.as_ref().map(AsFd::as_fd);
            let stderr = process.stderr.pipe().map(AsFd::as_fd);
            [exit, stderr].into_iter().flatten().map(|fd| (*incarnation, PollFd::from_borrowed_fd(fd, PollFlags::IN)))
        });
        let (incarnations, mut fds): (Vec<_>, Vec<_>) = fds.unzip();
        let has_polled = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })).is_ok();
        let has_event = |fd: &PollFd| !has_polled || !fd.revents().is_empty();
        let with_events = incarnations.into_iter().zip(&fds).filter(|(_, fd)| has_event(fd)).map(|(one, _)| one);
        let without_fd = self.all.iter().filter(|(_, process)| process.fd.is_none()).map(|(one, _)| *one);
        with_events.chain(without_fd).collect()
    }

    /// Passes an exited process to the reaper thread.
    ///
    /// Reaps the process on the calling thread if the reaper thread is missing or its queue is
    /// full.
    fn reap_in_background(&mut self, child: Child) {
        self.reaper = self.reaper.take().or_else(ReaperThread::start);
        let result = match &self.reaper {
            Some(ReaperThread { exited, .. }) => exited.try_send((child, Instant::now())),
            None => Err(TrySendError::Disconnected((child, Instant::now()))),
        };
        if let Err(TrySendError::Full((mut child, _)) | TrySendError::Disconnected((mut child, _))) = result {
            // The process has exited, so this waits only for the kernel.
            let _ = child.wait();
        }
    }

    pub(crate) fn signal(&self, incarnation: u32, signal: Signal) {
        self.all.get(&incarnation).into_iter().for_each(|process| process.signal(signal));
    }

    /// Kills a process that does not respond. The state of its threads in the kernel is kept and
    /// added to the report of its exit.
    pub(crate) fn kill(&mut self, incarnation: u32) {
        let Some(process) = self.all.get_mut(&incarnation) else { return };
        if process.killed.is_none() {
            let kernel_state = kernel_state::describe(process.pid);
            process.killed = Some(Kill { at: Instant::now(), kernel_state });
        }
        process.signal(Signal::KILL);
    }

    pub(crate) fn schedule(&self, incarnation: u32, class: SchedulingClass) {
        self.all.get(&incarnation).into_iter().for_each(|process| scheduling::set_class(process.pid, class));
    }

    /// Sleeps until a process exits, for at most `timeout`.
    pub(crate) fn wait(&self, timeout: Duration) {
        let fds = self.all.values().filter_map(|process| process.fd.as_ref());
        let mut fds: Vec<_> = fds.map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
        let timeout = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
        // A signal also ends the wait; the caller polls again.
        let _ = poll(&mut fds, Some(&timeout));
    }

    /// Kills all processes.
    pub(crate) fn kill_all(&mut self) {
        self.all.values().for_each(|process| process.signal(Signal::KILL));
        for process in std::mem::take(&mut self.all).into_values() {
            // The process has been killed, so this waits only for the kernel.
            let _ = process.state(WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
            self.reap_in_background(process.child);
        }
    }

    /// Terminates and reaps all processes.
    pub(crate) fn terminate_all(&mut self) {
        let deadline = Instant::now() + TERMINATE_TIMEOUT;
        self.all.values().for_each(|process| process.signal(Signal::TERM));
        while !self.all.is_empty() && Instant::now() < deadline {
            self.reap();
            std::thread::sleep(Duration::from_millis(2));
        }
        self.kill_all();
        if let Some(reaper) = self.reaper.take() {
            reaper.finish();
        }
    }

    /// Returns the CPU time of all processes since their start, including reaped ones, s.
    pub(crate) fn cpu_s(&self) -> f64 {
        self.all.values().map(|process| cpu_s(process.pid)).sum::<f64>() + reaped_cpu_s()
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        self.terminate_all();
    }
}

impl Process {
    fn start(service: Service, config: &ServiceConfig) -> io::Result<Self> {
        let text = serde_json::to_string(config)?;
        let mut child = Command::new(executable()?)
            .args(["service", service.name()])
            .stdin(Stdio::piped())
            .stdout(stdout_for(service, config)?)
            .stderr(Stdio::piped())
            // Ctrl-C is handled by the supervisor, which terminates the services.
            .process_group(0)
            .spawn()?;
        let (stdin, stderr) = (child.stdin.take(), StderrTail::new(child.stderr.take()));
        let pid = child.id();
        let fd = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        let process = Self { pid, child, fd, stderr, killed: None };
        // If the process exited before it read its configuration, the exit is noticed when it is
        // reaped.
        let written = stdin.map_or(Ok(()), |mut stdin| stdin.write_all(text.as_bytes()));
        match written.map_err(|cause| (cause.kind(), cause)) {
            Err((kind, cause)) if kind != io::ErrorKind::BrokenPipe => {
                process.signal(Signal::KILL);
                Err(cause)
            }
            _ => Ok(process),
        }
    }

    /// Returns the exit status if the process has exited. The process is not reaped.
    fn exit_status(&self) -> Option<ExitStatus> {
        let status = self.state(WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT)?;
        let raw = status.exit_status().map(|code| code << 8).or(status.terminating_signal())?;
        Some(ExitStatus::from_raw(raw))
    }

    fn state(&self, options: WaitIdOptions) -> Option<WaitIdStatus> {
        waitid(WaitId::Pid(Pid::from_raw(self.pid as i32)?), options).ok()?
    }

    fn signal(&self, signal: Signal) {
        if let Some(pid) = Pid::from_raw(self.pid as i32) {
            // An error means that the process has just exited.
            let _ = kill_process(pid, signal);
        }
    }
}

impl Kill {
    /// Describes the state of the process before the kill. If the process was slow to end, adds how
    /// long it took.
    fn describe(&self) -> String {
        let Self { at, kernel_state } = self;
        let duration = at.elapsed();
        let late =
            if duration < LATE_EXIT { String::new() } else { format!(", ended after {} ms", duration.as_millis()) };
        format!(" (kernel state before: {kernel_state}{late})")
    }
}

impl ReaperThread {
    fn start() -> Option<Self> {
        let (exited, received) = mpsc::sync_channel::<ExitedChild>(MAX_UNREAPED);
        let stop = Arc::new(AtomicBool::new(false));
        let stop_flag = stop.clone();
        let work = move || {
            // Reaping may occupy the processor for a long time, so it has a low priority.
            scheduling::set_class(scheduling::CALLING_THREAD, SchedulingClass::Leaving);
            for (mut child, exited_at) in received {
                while exited_at.elapsed() < REAP_DELAY && !stop_flag.load(Ordering::SeqCst) {
                    thread::sleep(REAP_POLL_INTERVAL);
                }
                let _ = child.wait();
            }
        };
        let thread = thread::Builder::new().name("reaping".into()).spawn(work).ok()?;
        Some(Self { exited, stop, thread })
    }

    /// Reaps the waiting processes without delay, within a time limit. The kernel reaps the rest
    /// when the supervisor exits.
    fn finish(self) {
        self.stop.store(true, Ordering::SeqCst);
        drop(self.exited);
        let deadline = Instant::now() + REAP_TIMEOUT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Returns the path of the running executable.
///
/// Uses `/proc/self/exe` if an upgrade has replaced the file, so that all processes of a run have
/// the same version.
fn executable() -> io::Result<PathBuf> {
    let running = PathBuf::from("/proc/self/exe");
    let file = std::env::current_exe()?;
    let identity = |path: &Path| fs::metadata(path).map(|file| (file.dev(), file.ino())).ok();
    Ok(if identity(&file) == identity(&running) { file } else { running })
}

/// Returns the standard output for a service. Services do not write to it.
///
/// If standard input is the source, the drivers inherit it as their standard output, because their
/// standard input carries the configuration.
fn stdout_for(service: Service, config: &ServiceConfig) -> io::Result<Stdio> {
    if service == Service::Drivers && config.launch.ingest.source == Source::Stdin {
        return Ok(io::stdin().as_fd().try_clone_to_owned()?.into());
    }
    Ok(Stdio::null())
}

fn describe_exit(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(0), _) => "exited with code 0, as after a SIGTERM from another process".into(),
        (Some(code), _) => format!("exited with code {code}"),
        (None, Some(libc::SIGBUS)) => {
            let state = SharedMemory::query().map_or(String::new(), |memory| format!("{memory}; "));
            format!("ran out of shared memory for the bus (signal 7): {state}{SHARED_MEMORY_REMEDY}")
        }
        (None, Some(signal)) => format!("was killed by signal {signal}"),
        (None, None) => "exited".into(),
    }
}

/// Returns the CPU time of this process, s.
pub(crate) fn own_cpu_s() -> f64 {
    cpu_s(std::process::id())
}

/// Returns the CPU time of the reaped child processes in seconds: `cutime` and `cstime` of proc(5).
fn reaped_cpu_s() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The executable name in parentheses may contain spaces. The word after the parentheses is
    // field 3, the state.
    let words = text.rsplit_once(')').map_or("", |(_, words)| words).split_whitespace();
    words.skip(16 - 3).take(2).filter_map(|word| word.parse::<f64>().ok()).sum::<f64>() / USER_HZ
}

/// Returns the CPU time of a process, s; 0 if the process no longer exists.
fn cpu_s(pid: u32) -> f64 {
    cpu_time_ns(pid).map_or(0.0, |ns| ns as f64 * 1e-9)
}
