//! Shared memory, limits, clock and processor of this machine.

use std::{fs, path::Path};

use bus::{REQUIRED_OPEN_FILES, OPEN_FILES_REMEDY, SHARED_MEMORY_REMEDY, SharedMemory};
use rustix::{
    process::{Resource, geteuid, getrlimit},
    time::{ClockId, clock_getres},
};

use super::Check;

/// A system at 1 kHz fills 5 MiB; three times that, for one at more or two of them.
const SHARED_MEMORY_MIB: u64 = 16;
/// The same system where every reader that it may have is as slow as can be: 83 MiB; and half as much again.
const SHARED_MEMORY_AMPLE_MIB: u64 = 128;
/// The same with room for a recorder, a gateway and observers.
const FILES_AMPLE: u64 = 1024;
/// What locks its memory needs its code, its stacks and its end of the topics, MiB.
const LOCKED_MIB: u64 = 8;
/// Clock sources that are read without a call of the kernel.
const FAST_SOURCES: [&str; 6] =
    ["tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "riscv_clocksource", "xen"];

/// Everything about the machine.
pub fn checks() -> Vec<Check> {
    vec![shared_memory(), open_files(), locked_memory(), real_time(), monotonic(), synchronised(), governor()]
}

fn shared_memory() -> Check {
    let check = "shared-memory";
    SharedMemory::query().map_or_else(
        || Check::problem(check, "there is no /dev/shm", "mount it: mount -t tmpfs tmpfs /dev/shm"),
        |memory| free(memory.free_bytes >> 20),
    )
}

fn free(mib: u64) -> Check {
    let (check, found) = ("shared-memory", format!("{mib} MiB free in /dev/shm"));
    match mib {
        _ if mib < SHARED_MEMORY_MIB => Check::problem(check, found, SHARED_MEMORY_REMEDY),
        _ if mib < SHARED_MEMORY_AMPLE_MIB => Check::warning(check, found, SHARED_MEMORY_REMEDY),
        _ => Check::ok(check, found),
    }
}

fn open_files() -> Check {
    let check = "open-files";
    // Whoever joins a system raises its limit to this one.
    match getrlimit(Resource::Nofile).maximum {
        Some(limit) if limit < REQUIRED_OPEN_FILES => Check::problem(check, format!("{limit} allowed"), OPEN_FILES_REMEDY),
        Some(limit) if limit < FILES_AMPLE => Check::warning(check, format!("{limit} allowed"), OPEN_FILES_REMEDY),
        Some(limit) => Check::ok(check, format!("{limit} allowed")),
        None => Check::ok(check, "no limit"),
    }
}

fn locked_memory() -> Check {
    let check = "locked-memory";
    match getrlimit(Resource::Memlock).current.map(|bytes| bytes >> 20) {
        Some(mib) if mib < LOCKED_MIB => Check::warning(
            check,
            format!("{mib} MiB may be locked: under memory pressure a service can be paged out and be late"),
            "allow more: ulimit -l unlimited, or LimitMEMLOCK=infinity in the unit",
        ),
        Some(mib) => Check::ok(check, format!("{mib} MiB may be locked")),
        None => Check::ok(check, "no limit"),
    }
}

fn real_time() -> Check {
    let check = "real-time";
    match getrlimit(Resource::Rtprio).current {
        Some(0) if !geteuid().is_root() => Check::warning(
            check,
            "no real-time priority is allowed: other load on the machine shows in the latency",
            "allow it: rtprio 50 in /etc/security/limits.conf, or LimitRTPRIO=50 in the unit",
        ),
        Some(0) | None => Check::ok(check, "real-time priorities are allowed"),
        Some(limit) => Check::ok(check, format!("real-time priorities up to {limit} are allowed")),
    }
}

fn monotonic() -> Check {
    let check = "clock-monotonic";
    let resolution_ns = clock_getres(ClockId::Monotonic).tv_nsec;
    let Some(source) = read("/sys/devices/system/clocksource/clocksource0/current_clocksource") else {
        return Check::ok(check, format!("resolution {resolution_ns} ns; its source cannot be read here"));
    };
    let found = format!("source {source}, resolution {resolution_ns} ns");
    if FAST_SOURCES.contains(&source.as_str()) && resolution_ns <= 1_000 {
        Check::ok(check, found)
    } else {
        Check::warning(
            check,
            found,
            "stamps cost time and are coarse; boot with clocksource=tsc if the processor has it",
        )
    }
}

/// Nothing on the path depends on the time of day; recordings and fleets are easier to compare where it is right.
fn synchronised() -> Check {
    let check = "clock-of-day";
    let timesyncd = Path::new("/run/systemd/timesync");
    if timesyncd.join("synchronized").exists() {
        Check::ok(check, "synchronised by systemd-timesyncd")
    } else if timesyncd.exists() {
        Check::warning(check, "systemd-timesyncd runs and has not synchronised", "see timedatectl timesync-status")
    } else {
        Check::ok(check, "whether it is synchronised cannot be known here; the path does not depend on it")
    }
}

fn governor() -> Check {
    let check = "processor";
    let cpus = fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    let governors = cpus.filter_map(|cpu| read(cpu.path().join("cpufreq/scaling_governor")));
    let governors: Vec<_> = governors.collect();
    let slow = |name: &&String| ["powersave", "conservative", "ondemand"].contains(&name.as_str());
    match (governors.iter().find(slow), governors.first()) {
        (Some(name), _) => Check::warning(
            check,
            format!("governor {name}: a core that idles between ticks wakes up slowly"),
            "cpupower frequency-set -g performance",
        ),
        (None, Some(name)) => Check::ok(check, format!("governor {name}")),
        (None, None) => Check::ok(check, "its frequency is not scaled, or that cannot be read (virtual machine)"),
    }
}

fn read(path: impl AsRef<Path>) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Outcome;

    #[test]
    fn little_shared_memory_is_a_problem_before_it_is_none() {
        assert_eq!([10, 64, 1000].map(|mib| free(mib).result), [Outcome::Problem, Outcome::Warning, Outcome::Ok]);
    }

    #[test]
    fn this_machine_can_be_looked_at_and_whatever_is_wrong_has_a_remedy() {
        let checks = checks();
        assert_eq!(checks.len(), 7);
        for check in checks {
            assert_eq!(check.remedy.is_none(), check.result == Outcome::Ok, "{check}");
        }
    }
}
