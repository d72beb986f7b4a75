//! CPU and memory usage of processes, from /proc.

use std::{collections::HashMap, fs};

use runtime::clock::cpu_time_ns;

/// Samples the resource usage of processes. For each process, stores the time and the CPU time of
/// its last sample in ns.
#[derive(Debug, Default)]
pub struct ProcessMonitor(HashMap<u32, (u64, u64)>);

/// Resource usage of a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessUsage {
    /// CPU time since the previous sample as a share of one core, %; `None` for the first sample.
    pub cpu_percent: Option<f64>,
    /// Resident memory, MiB.
    pub resident_mib: f64,
}

impl ProcessMonitor {
    /// Samples a process at `now_ns` (CLOCK_MONOTONIC). Returns `None` if the process does not
    /// exist.
    pub fn sample(&mut self, pid: u32, now_ns: u64) -> Option<ProcessUsage> {
        let text = |file: &str| fs::read_to_string(format!("/proc/{pid}/{file}")).ok();
        let cpu_ns = cpu_time_ns(pid)?;
        let resident_kib = text("status")?
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse::<f64>().ok());
        let previous = self.0.insert(pid, (now_ns, cpu_ns));
        let cpu_percent = previous.filter(|(then_ns, _)| *then_ns < now_ns).map(|(then_ns, then_cpu_ns)| {
            100.0 * cpu_ns.saturating_sub(then_cpu_ns) as f64 / (now_ns - then_ns) as f64
        });
        Some(ProcessUsage { cpu_percent, resident_mib: resident_kib.unwrap_or(0.0) / 1024.0 })
    }
}

/// Returns `true` if the process is stopped, for instance by Ctrl-Z or a debugger.
pub fn is_stopped(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The process name is in parentheses and may itself contain parentheses.
    stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with(['T', 't']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_process_has_cpu_share_after_second_sample() {
        let (mut monitor, own_pid) = (ProcessMonitor::default(), std::process::id());
        let first = monitor.sample(own_pid, 1).unwrap();
        assert!(first.cpu_percent.is_none() && first.resident_mib > 0.1, "{first:?}");
        let mut sum = 0u64;
        (0..20_000_000u64).for_each(|i| sum = std::hint::black_box(sum ^ i));
        assert!(monitor.sample(own_pid, 1_000_000_001).unwrap().cpu_percent.unwrap() > 0.0);
    }

    #[test]
    fn missing_process_has_no_usage() {
        assert_eq!(ProcessMonitor::default().sample(u32::MAX, 1), None);
    }
}
