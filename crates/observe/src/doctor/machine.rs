//! Checks of shared memory, limits, clocks and processor of this machine.

use std::{fs, path::Path};

use bus::{REQUIRED_OPEN_FILES, SharedMemory};
use rustix::{
    process::{Resource, geteuid, getrlimit},
    time::{ClockId, clock_getres},
};

use super::{
    Check,
    remedy::{CLOCK_SOURCE_FILE, Remedy},
};

/// Free shared memory in MiB below which a problem is reported. A system at 1 kHz uses 5 MiB. Three
/// times that amount allows for a higher rate or a second system.
const MIN_SHARED_MEMORY_MIB: u64 = 16;
/// Free shared memory in MiB below which a warning is reported. A system at 1 kHz uses 83 MiB if it
/// has the maximum number of subscribers and all of them are as slow as possible. The remainder is
/// a reserve.
const AMPLE_SHARED_MEMORY_MIB: u64 = 128;
/// Open-file limit below which a warning is reported. It leaves room for a recorder, a gateway and
/// observers.
const AMPLE_OPEN_FILES: u64 = 1024;
/// Minimum lockable memory, MiB. It covers code, stacks and topic buffers of a service.
const MIN_LOCKED_MEMORY_MIB: u64 = 8;
/// Clock sources that are read without a system call.
const FAST_CLOCK_SOURCES: [&str; 6] =
    ["tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "riscv_clocksource", "xen"];

/// File that lists the clock sources of the kernel.
const AVAILABLE_CLOCK_SOURCES_FILE: &str = "/sys/devices/system/clocksource/clocksource0/available_clocksource";
/// Maximum resolution of the monotonic clock, ns. Without high-resolution timers it is 1 ms or
/// more.
const MAX_RESOLUTION_NS: i64 = 1_000;

/// Runs all checks of the machine.
pub fn checks() -> Vec<Check> {
    vec![shared_memory(), open_files(), locked_memory(), real_time(), monotonic_clock(), wall_clock(), cpu_governor()]
}

fn shared_memory() -> Check {
    let check = "shared-memory";
    SharedMemory::query().map_or_else(
        || Check::problem(check, "/dev/shm does not exist", Remedy::MountSharedMemory),
        |memory| shared_memory_check(memory.free_bytes >> 20),
    )
}

fn shared_memory_check(mib: u64) -> Check {
    let (check, found) = ("shared-memory", format!("{mib} MiB free in /dev/shm"));
    match mib {
        _ if mib < MIN_SHARED_MEMORY_MIB => Check::problem(check, found, Remedy::EnlargeSharedMemory),
        _ if mib < AMPLE_SHARED_MEMORY_MIB => Check::warning(check, found, Remedy::EnlargeSharedMemory),
        _ => Check::ok(check, found),
    }
}

fn open_files() -> Check {
    let check = "open-files";
    // A process that joins a system raises its soft limit to the hard limit, so the hard limit is
    // checked.
    match getrlimit(Resource::Nofile).maximum {
        Some(limit) if limit < REQUIRED_OPEN_FILES => {
            Check::problem(check, format!("limit {limit}"), Remedy::RaiseOpenFileLimit)
        }
        Some(limit) if limit < AMPLE_OPEN_FILES => {
            Check::warning(check, format!("limit {limit}"), Remedy::RaiseOpenFileLimit)
        }
        Some(limit) => Check::ok(check, format!("limit {limit}")),
        None => Check::ok(check, "no limit"),
    }
}

fn locked_memory() -> Check {
    let check = "locked-memory";
    match getrlimit(Resource::Memlock).current.map(|bytes| bytes >> 20) {
        Some(mib) if mib < MIN_LOCKED_MEMORY_MIB => Check::warning(
            check,
            format!("limit {mib} MiB: under memory pressure the kernel can page out a service, which delays it"),
            Remedy::RaiseLockedMemoryLimit,
        ),
        Some(mib) => Check::ok(check, format!("limit {mib} MiB")),
        None => Check::ok(check, "no limit"),
    }
}

fn real_time() -> Check {
    let check = "real-time";
    match getrlimit(Resource::Rtprio).current {
        Some(0) if !geteuid().is_root() => Check::warning(
            check,
            "no real-time priority is allowed: other load on the machine increases the latency",
            Remedy::AllowRealTime,
        ),
        Some(0) | None => Check::ok(check, "real-time priorities are allowed"),
        Some(limit) => Check::ok(check, format!("real-time priorities up to {limit} are allowed")),
    }
}

fn monotonic_clock() -> Check {
    let check = "clock-monotonic";
    let resolution_ns = clock_getres(ClockId::Monotonic).tv_nsec;
    let Some(source) = read_trimmed(CLOCK_SOURCE_FILE) else {
        return Check::ok(check, format!("resolution {resolution_ns} ns; clock source unknown"));
    };
    let found = format!("source {source}, resolution {resolution_ns} ns");
    let is_fast = |name: &&str| FAST_CLOCK_SOURCES.contains(name);
    if is_fast(&source.as_str()) {
        return match resolution_ns {
            ..=MAX_RESOLUTION_NS => Check::ok(check, found),
            _ => Check::warning(check, found, Remedy::EnableHighResolutionTimers),
        };
    }
    let available = read_trimmed(AVAILABLE_CLOCK_SOURCES_FILE).unwrap_or_default();
    let faster = available.split_whitespace().find(is_fast);
    let remedy = faster.map_or(Remedy::InvestigateClockSource, |name| Remedy::SelectClockSource(name.into()));
    Check::warning(check, format!("{found}: each read of the clock is a system call"), remedy)
}

/// Checks whether the wall clock is synchronised.
///
/// The data path does not use the wall clock, but recordings and vehicles are easier to compare if
/// their clocks are synchronised.
fn wall_clock() -> Check {
    let check = "wall-clock";
    let timesyncd = Path::new("/run/systemd/timesync");
    if timesyncd.join("synchronized").exists() {
        Check::ok(check, "synchronised by systemd-timesyncd")
    } else if timesyncd.exists() {
        Check::warning(check, "systemd-timesyncd runs but has not synchronised", Remedy::ConnectTimeServer)
    } else {
        Check::ok(check, "sync state unknown (not needed)")
    }
}

fn cpu_governor() -> Check {
    let check = "processor";
    let cpus = fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    let governors = cpus.filter_map(|cpu| read_trimmed(cpu.path().join("cpufreq/scaling_governor")));
    let governors: Vec<_> = governors.collect();
    let slow = |name: &&String| ["powersave", "conservative", "ondemand"].contains(&name.as_str());
    match (governors.iter().find(slow), governors.first()) {
        (Some(name), _) => Check::warning(
            check,
            format!("governor {name}: a core that idles between ticks wakes up slowly"),
            Remedy::SelectGovernor,
        ),
        (None, Some(name)) => Check::ok(check, format!("governor {name}")),
        (None, None) => Check::ok(check, "no frequency governor (fixed frequency or virtual machine)"),
    }
}

fn read_trimmed(path: impl AsRef<Path>) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Severity;

    #[test]
    fn shared_memory_thresholds_set_severity() {
        assert_eq!(
            [10, 64, 1000].map(|mib| shared_memory_check(mib).result),
            [Severity::Problem, Severity::Warning, Severity::Ok]
        );
    }

    #[test]
    fn every_finding_on_this_machine_has_a_remedy() {
        let checks = checks();
        assert_eq!(checks.len(), 7);
        for check in checks {
            assert_eq!(check.remedy.is_none(), check.result == Severity::Ok, "{check}");
        }
    }
}
