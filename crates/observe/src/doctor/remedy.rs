//! Remedies of `plumb doctor`.
//!
//! Input: a finding with the values that its remedy needs.
//!
//! Output: the text of the remedy. Commands and lines of the launch file are between backquotes, so
//! that they can be pasted.
//!
//! Failure: if no command can remove the cause, the text states the required action.

use std::{fmt, path::PathBuf};

use bus::{BusError, OPEN_FILES_REMEDY, SHARED_MEMORY_REMEDY};
use rustix::process::geteuid;
use serde::{Serialize, Serializer};

/// File that selects the clock source of the kernel.
pub(super) const CLOCK_SOURCE_FILE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

/// Remedy for a finding.
///
/// `tests/cli/doctor.rs` names the test of each variant.
#[derive(Debug, Clone, PartialEq)]
pub enum Remedy {
    /// `/dev/shm` does not exist.
    MountSharedMemory,
    /// `/dev/shm` is nearly full.
    EnlargeSharedMemory,
    /// The open-file limit is too low.
    RaiseOpenFileLimit,
    /// The limit on locked memory is too low.
    RaiseLockedMemoryLimit,
    /// Real-time priorities are not allowed.
    AllowRealTime,
    /// The kernel uses a slow clock source and offers this faster one.
    SelectClockSource(String),
    /// The kernel offers only slow clock sources.
    InvestigateClockSource,
    /// The kernel's timers are coarse.
    EnableHighResolutionTimers,
    /// The wall clock is not synchronised.
    ConnectTimeServer,
    /// The processor's frequency governor saves energy.
    SelectGovernor,
    /// Killed processes of the system left files.
    RemoveLeftovers(String),
    /// The leftovers of the system could not be removed because processes are starting or ending.
    RetryRemoval(String),
    /// A file of the system belongs to another user or has the wrong type.
    RemoveForeignFile(PathBuf),
    /// Processes of the system still run without a supervisor.
    KillProcesses(String, Vec<u32>),
    /// Files of a running system were removed. If a service of the system is found, the remedy
    /// contains its process ID.
    RenewBus(Option<u32>),
    /// A killed process of the system with this supervisor left an incomplete segment.
    RestartSystem(u32),
    /// The last run of the system failed.
    StartSystem,
    /// The system has the maximum number of observers. The list contains those of this user.
    EndObserver(Vec<u32>),
    /// The supervisor is stopped.
    ResumeSupervisor(u32),
    /// The check failed for another reason, or the finding may be temporary.
    RunAgain,
    /// The input check found an issue. The judge provides the text.
    CorrectInput(String),
    /// A service reported a diagnostic and provides the text.
    CorrectSource(String),
    /// Readings arrive at another rate in Hz than declared.
    DeclareRate(f64),
    /// Attitudes have flags of faults.
    ExplainFlags,
    /// The output file cannot be written.
    FreeDiskSpace,
    /// Messages were lost. Buffer time in seconds that would have sufficed.
    EnlargeBuffers(f64),
    /// A service failed or was restarted.
    ReadMessages,
    /// A service publishes nothing.
    CheckUpstreamServices,
    /// No program publishes readings.
    StartSensorProgram,
    /// A device sends nothing.
    CheckDevice,
    /// The source publishes nothing.
    CheckSourceEnd,
    /// A rate is too low.
    ReduceLoad,
    /// The accelerometer reports g.
    ConvertFromG,
    /// A sensor is not calibrated.
    Calibrate(SensorCalibration),
}

/// Calibration of a sensor of a running system.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorCalibration {
    /// Sensor name, as in `plumb calibrate`.
    pub sensor: &'static str,
    /// Action during the calibration.
    pub action: &'static str,
    /// System name.
    pub system: String,
    /// Launch file; `None` for the built-in one.
    pub launch_file: Option<PathBuf>,
}

impl Remedy {
    /// Returns the remedy for an error of the bus.
    pub fn for_bus_error(error: &BusError) -> Self {
        match error {
            BusError::ForeignFile { path, .. } => Self::RemoveForeignFile(path.clone()),
            BusError::TooManyObservers { pids, .. } => Self::EndObserver(pids.clone()),
            BusError::FilesRemoved { pids, .. } => Self::renew_bus(pids),
            BusError::Lingering { name } => Self::RetryRemoval(name.clone()),
            BusError::OpenFileLimit { .. } => Self::RaiseOpenFileLimit,
            BusError::SharedMemory { .. } => Self::EnlargeSharedMemory,
            BusError::InvalidName { .. }
            | BusError::NameInUse { .. }
            | BusError::File { .. }
            | BusError::NotRunning { .. }
            | BusError::SharedStateDamaged { .. }
            | BusError::Node { .. }
            | BusError::IncompleteSegment { .. }
            | BusError::TopicNotOpen { .. }
            | BusError::LayoutMismatch { .. }
            | BusError::BufferMismatch { .. }
            | BusError::Topic { .. }
            | BusError::Send { .. }
            | BusError::Receive { .. } => Self::RunAgain,
        }
    }

    /// Returns the remedy for removed files of the running system with these processes.
    pub(super) fn renew_bus(pids: &[u32]) -> Self {
        // The supervisor starts the services, so a process with a parent in the system is a
        // service.
        let is_service = |pid: &&u32| parent_pid(**pid).is_some_and(|parent| pids.contains(&parent));
        Self::RenewBus(pids.iter().find(is_service).copied())
    }
}

/// Returns the process ID of the parent of a process.
fn parent_pid(pid: u32) -> Option<u32> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    status.lines().find_map(|line| line.strip_prefix("PPid:")?.trim().parse().ok())
}

/// Returns `command` as a command for this user's shell that runs with root privileges.
fn as_root(command: &str) -> String {
    if geteuid().is_root() { command.to_owned() } else { format!("sudo {command}") }
}

fn fix_command(system: &str) -> String {
    format!("plumb doctor --fix --system {system}")
}

fn joined(pids: &[u32]) -> String {
    pids.iter().map(u32::to_string).collect::<Vec<_>>().join(" ")
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MountSharedMemory => {
                write!(f, "`{} && ", as_root("mkdir -p /dev/shm"))?;
                write!(f, "{}`", as_root("mount -t tmpfs -o mode=1777 tmpfs /dev/shm"))
            }
            Self::EnlargeSharedMemory => f.write_str(SHARED_MEMORY_REMEDY),
            Self::RaiseOpenFileLimit => f.write_str(OPEN_FILES_REMEDY),
            Self::RaiseLockedMemoryLimit => {
                let command = as_root("prlimit --pid $$ --memlock=unlimited");
                write!(f, "`{command}` in the shell that starts plumb, or LimitMEMLOCK=infinity in the unit; in a container --ulimit memlock=-1")
            }
            Self::AllowRealTime => {
                let command = as_root("prlimit --pid $$ --rtprio=50");
                write!(f, "`{command}` in the shell that starts plumb, or LimitRTPRIO=50 in the unit; in a container --ulimit rtprio=50")
            }
            Self::SelectClockSource(source) => {
                write!(f, "`echo {source} | {}`", as_root(&format!("tee {CLOCK_SOURCE_FILE}")))
            }
            Self::InvestigateClockSource => {
                f.write_str("the kernel offers no faster source; its log (`dmesg`) states why it rejected others")
            }
            Self::EnableHighResolutionTimers => f.write_str("boot the kernel without the parameter highres=off"),
            Self::ConnectTimeServer => {
                f.write_str("connect the machine to a network with a time server, or ignore this: plumb does not need it")
            }
            Self::SelectGovernor => {
                let command = as_root("tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor");
                write!(f, "`echo performance | {command}`")
            }
            Self::RemoveLeftovers(name) => write!(f, "`{}`", fix_command(name)),
            Self::RetryRemoval(name) => {
                write!(f, "`{}` again, when no process of the system starts or ends", fix_command(name))
            }
            Self::RemoveForeignFile(path) => {
                let command = format!("rm -r {}", foreign::shell_word(&path.to_string_lossy()));
                write!(f, "`{}`, if no running system of another user needs it", as_root(&command))
            }
            Self::KillProcesses(name, pids) => write!(f, "`kill -KILL {}`, then `{}`", joined(pids), fix_command(name)),
            Self::RenewBus(service) => {
                match service {
                    Some(pid) => write!(f, "`kill {pid}`: the service restarts, and the system renews its bus")?,
                    None => f.write_str("wait until a service ends: the system then renews its bus")?,
                }
                let folder = "/etc/systemd/logind.conf.d";
                write!(f, "; if logind removed the files at logout, `{} && ", as_root(&format!("mkdir -p {folder}")))?;
                write!(f, "printf '[Login]\\nRemoveIPC=no\\n' | {} && ", as_root(&format!("tee {folder}/plumbline.conf")))?;
                write!(f, "{}`", as_root("systemctl restart systemd-logind"))
            }
            Self::RestartSystem(pid) => write!(f, "`kill {pid}`, then `plumb up`"),
            Self::StartSystem => f.write_str(
                "`plumb up`; messages of the last run are in `plumb logs` after `plumb up --detach`, in `journalctl -u plumbline` after a start by systemd",
            ),
            Self::EndObserver(pids) => match pids.first() {
                Some(pid) => write!(f, "`kill {pid}`, which ends one of them, then run plumb doctor again"),
                None => f.write_str("ask the users of the observers to end one, then run plumb doctor again"),
            },
            Self::ResumeSupervisor(pid) => write!(f, "`kill -CONT {pid}`"),
            Self::RunAgain => {
                f.write_str("run plumb doctor again; if the finding persists, restart the system")
            }
            Self::CorrectInput(remedy) | Self::CorrectSource(remedy) => f.write_str(remedy),
            Self::DeclareRate(rate_hz) => {
                write!(f, "`ingest.bus.rate_hz = {rate_hz:.0}` in the launch file: buffers follow from it")
            }
            Self::ExplainFlags => {
                f.write_str("see docs/explanation/bad-input.md; `plumb topic echo attitude` shows the flags of each tick")
            }
            Self::FreeDiskSpace => f.write_str("free disk space, then restart the system when possible"),
            Self::EnlargeBuffers(buffer_s) => write!(
                f,
                "`buffer_s = {buffer_s}` in the launch file, which bridges such a pause of a process; if the machine is overloaded, reduce the load"
            ),
            Self::ReadMessages => {
                f.write_str("it ended or hung; its messages in the output of plumb up or in the journal state the cause")
            }
            Self::CheckUpstreamServices => f.write_str("cure the first service of the path that publishes nothing"),
            Self::StartSensorProgram => f.write_str("start the program that publishes on the topic `sensor`"),
            Self::CheckDevice => {
                f.write_str("check that the device sends; driver messages are in the output of plumb up")
            }
            Self::CheckSourceEnd => f.write_str("the source may have reached its end: start the system again"),
            Self::ReduceLoad => f.write_str("reduce the load on the machine"),
            Self::ConvertFromG => f.write_str(
                "`ingest.calibration.accel.scale = [9.80665, 9.80665, 9.80665]` in the launch file: the accelerometer reports g instead of m/s²",
            ),
            Self::Calibrate(SensorCalibration { sensor, action, system, launch_file }) => {
                let file = launch_file.as_ref().map_or("launch.toml".into(), |path| path.to_string_lossy());
                let file = foreign::shell_word(&file);
                write!(f, "`plumb calibrate {sensor} --live --system {system} --write {file}`, {action}, then restart the system")
            }
        }
    }
}

impl Serialize for Remedy {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
