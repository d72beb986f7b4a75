//! Background systems: `plumb up --detach`, `plumb down` and `plumb logs`.

use std::{
    env,
    fs::{self, File, TryLockError},
    io::{self, BufRead, BufReader, Seek, SeekFrom},
    os::unix::{fs::OpenOptionsExt, process::CommandExt},
    path::{Path, PathBuf},
    process::{Child, Command, ExitCode, Stdio},
    thread,
    time::{Duration, Instant},
};

use bus::SystemName;
use clap::Args;
use control::{ControlRequest, ServiceStatus, send_request};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    failure::{Failure, Outcome},
    notice::notice,
    stdout::{print, print_item},
    system::{LaunchArgs, LocalSystemArgs, SystemNameArgs},
};

/// Time limit for the start of every service.
const START_TIMEOUT: Duration = Duration::from_secs(60);
/// Time limit for the end of a system. The supervisor kills services that have not ended by then.
const END_TIMEOUT: Duration = Duration::from_secs(30);
/// Interval between two checks.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum number of lines of the log that are shown when a start fails.
const SHOWN_LINES: usize = 20;

/// Failure to start, stop or read the log of a background system.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DetachedError {
    #[error("the system {name:?} is already running, process {pid}; end it with `plumb down`")]
    AlreadyRunning { name: String, pid: u32 },
    #[error("no folder for the log: set HOME or XDG_STATE_HOME to a folder, or run `plumb up` without --detach")]
    NoFolder,
    #[error("cannot write the log {}: {cause}", foreign::path(path))]
    Log { path: PathBuf, cause: io::Error },
    #[error("cannot start the system: {0}")]
    Spawn(io::Error),
    #[error("the system has ended during its start; its last messages:\n{0}")]
    Ended(String),
    #[error("the system {name:?} is not ready after {} s; see `plumb ps` and `plumb logs`", START_TIMEOUT.as_secs())]
    NotReady { name: String },
    #[error("the system {name:?} is not running; select another one with --system or --launch")]
    NotRunning { name: String },
    #[error("cannot end process {pid}: {cause}")]
    Signal { pid: u32, cause: io::Error },
    #[error("process {pid} has not ended within {} s; to end it at once: kill -9 {pid}", END_TIMEOUT.as_secs())]
    Hangs { pid: u32 },
    #[error(
        "no log of {name:?}: only `plumb up --detach` writes one; the messages of plumbline.service are in `journalctl -u plumbline`"
    )]
    NoLog { name: String },
}

impl From<DetachedError> for Failure {
    fn from(error: DetachedError) -> Self {
        Self::new(error, 1)
    }
}

/// Arguments of `plumb down`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb down
  plumb down --system alpha
  plumb down --launch boat.toml

Stops the system like Ctrl-C. To stop a system that systemd runs, use `systemctl
stop plumbline`.")]
pub(crate) struct Down {
    #[command(flatten)]
    system: LocalSystemArgs,
}

/// Arguments of `plumb logs`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb logs
  plumb logs --follow

Prints the messages of the latest `plumb up --detach`.")]
pub(crate) struct Logs {
    #[command(flatten)]
    system: SystemNameArgs,
    /// Wait for further messages until the system ends
    #[arg(long, short)]
    follow: bool,
}

/// Starts this command line again in the background and waits until every service runs.
pub(crate) fn start(launch: &LaunchArgs) -> Outcome {
    let name = launch.read()?.name;
    let (pid, log) = try_start(&name)?;
    let option = launch.launch.iter().map(|file| format!(" --launch {}", foreign::path(file)));
    notice(format_args!(
        "{name} runs in the background, process {pid}, log {}; end it with `plumb down{}`",
        foreign::path(&log),
        option.collect::<String>()
    ));
    Ok(ExitCode::SUCCESS)
}

fn try_start(name: &str) -> Result<(u32, PathBuf), Failure> {
    if let Some(pid) = SystemName::new(name)?.owner_pid()? {
        return Err(DetachedError::AlreadyRunning { name: name.into(), pid }.into());
    }
    let path = log_path(name).ok_or(DetachedError::NoFolder)?;
    let log_error = |cause| DetachedError::Log { path: path.clone(), cause };
    path.parent().map_or(Ok(()), fs::create_dir_all).map_err(log_error)?;
    let previous = path.with_extension("log.1");
    match fs::rename(&path, previous) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(log_error(error).into()),
        _ => {}
    }
    // The log contains the address of the cockpit with its token.
    let log = File::options().write(true).create_new(true).mode(0o600).open(&path).map_err(log_error)?;
    // The processes of the system inherit the lock. It is released when the last one has ended.
    log.lock().map_err(log_error)?;
    let arguments = env::args_os().skip(1).filter(|argument| argument != "--detach");
    let mut command = Command::new(env::current_exe().map_err(DetachedError::Spawn)?);
    command.args(arguments).stdin(Stdio::null()).stdout(log.try_clone().map_err(log_error)?).stderr(log);
    // The system has its own process group, so it does not receive signals from the terminal.
    let mut child = command.process_group(0).spawn().map_err(DetachedError::Spawn)?;
    wait_until_ready(name, &mut child, &path)?;
    Ok((child.id(), path))
}

fn wait_until_ready(name: &str, child: &mut Child, log: &Path) -> Result<(), Failure> {
    let started = Instant::now();
    while started.elapsed() < START_TIMEOUT {
        if !matches!(child.try_wait(), Ok(None)) {
            return Err(DetachedError::Ended(last_lines(log)).into());
        }
        let is_own = SystemName::new(name)?.owner_pid()? == Some(child.id());
        let services = send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status);
        let is_started = |service: &ServiceStatus| ["running", "ready", "finished"].contains(&service.state.raw());
        if is_own && services.is_ok_and(|all| !all.is_empty() && all.iter().all(is_started)) {
            return Ok(());
        }
        thread::sleep(POLL_INTERVAL);
    }
    Err(DetachedError::NotReady { name: name.into() }.into())
}

/// Returns the last lines of a log, with their control characters escaped.
fn last_lines(log: &Path) -> String {
    let text = fs::read(log).unwrap_or_default();
    let lines: Vec<_> = text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).collect();
    let shown = lines.iter().skip(lines.len().saturating_sub(SHOWN_LINES));
    shown.map(|line| format!("  {}\n", foreign::ForeignText::from_bytes(line))).collect()
}

pub(crate) fn down(Down { system }: Down) -> Outcome {
    let name = system.name()?;
    let pid = end(&name)?;
    if system.json {
        return Ok(print(&serde_json::json!({ "system": name, "ended_process": pid })));
    }
    notice(format_args!("{name} has ended, process {pid}"));
    Ok(ExitCode::SUCCESS)
}

/// Ends a system and returns the process identifier of its supervisor.
fn end(name: &str) -> Result<u32, Failure> {
    let system_name = SystemName::new(name)?;
    let not_running = || DetachedError::NotRunning { name: name.into() };
    // The identifier is 0 until the supervisor has recorded it.
    let pid = system_name.owner_pid()?.filter(|pid| *pid > 0).ok_or_else(not_running)?;
    let process = Pid::from_raw(pid.cast_signed()).ok_or_else(not_running)?;
    kill_process(process, Signal::TERM).map_err(|cause| DetachedError::Signal { pid, cause: cause.into() })?;
    let started = Instant::now();
    while started.elapsed() < END_TIMEOUT {
        if system_name.owner_pid()? != Some(pid) {
            return Ok(pid);
        }
        thread::sleep(POLL_INTERVAL);
    }
    Err(DetachedError::Hangs { pid }.into())
}

pub(crate) fn logs(Logs { system, follow }: Logs) -> Outcome {
    let name = system.name()?;
    SystemName::new(&name)?;
    let path = log_path(&name).ok_or(DetachedError::NoFolder)?;
    let no_log = |_| DetachedError::NoLog { name };
    let mut log = BufReader::new(File::open(&path).map_err(no_log)?);
    loop {
        // This is checked before the lines are read, because the log is complete once all processes
        // have ended.
        let is_running = follow && matches!(log.get_ref().try_lock_shared(), Err(TryLockError::WouldBlock));
        let mut line = Vec::new();
        while log.read_until(b'\n', &mut line).map_err(|cause| DetachedError::Log { path: path.clone(), cause })? > 0 {
            if line.last() != Some(&b'\n') && is_running {
                break;
            }
            let text = line.strip_suffix(b"\n").unwrap_or(&line);
            if let std::ops::ControlFlow::Break(code) = print_item(&foreign::ForeignText::from_bytes(text)) {
                return Ok(code);
            }
            line.clear();
        }
        // An incomplete line is read again.
        let unread = -(line.len() as i64);
        log.seek(SeekFrom::Current(unread)).map_err(|cause| DetachedError::Log { path: path.clone(), cause })?;
        if !is_running {
            return Ok(ExitCode::SUCCESS);
        }
        thread::sleep(POLL_INTERVAL);
    }
}

fn log_path(name: &str) -> Option<PathBuf> {
    Some(runtime::machine::state_folder()?.join(format!("{name}.log")))
}
