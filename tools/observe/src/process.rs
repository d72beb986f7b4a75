//! What a process costs: from /proc.

use std::{collections::HashMap, fs};

use runtime::clock::cpu_time_ns;

/// CPU time between looks at the same processes.
#[derive(Debug, Default)]
pub struct Processes(HashMap<u32, (u64, u64)>);

/// What a process costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Share of one core since the last look, %; `None` at the first.
    pub cpu_percent: Option<f64>,
    /// Resident memory, MiB.
    pub resident_mib: f64,
}

impl Processes {
    /// Looks at a process; `None` when it is no more.
    pub fn look(&mut self, pid: u32, now_ns: u64) -> Option<Cost> {
        let text = |file: &str| fs::read_to_string(format!("/proc/{pid}/{file}")).ok();
        let ran_ns = cpu_time_ns(pid)?;
        let resident_kib = text("status")?
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse::<f64>().ok());
        let before = self.0.insert(pid, (now_ns, ran_ns));
        let cpu_percent = before.filter(|(then_ns, _)| *then_ns < now_ns).map(|(then_ns, then_ran_ns)| {
            100.0 * ran_ns.saturating_sub(then_ran_ns) as f64 / (now_ns - then_ns) as f64
        });
        Some(Cost { cpu_percent, resident_mib: resident_kib.unwrap_or(0.0) / 1024.0 })
    }
}

/// The process has been stopped, as by Ctrl-Z, and does nothing until it is let go on.
pub fn is_stopped(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // Its name is in parentheses and may hold some itself.
    stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with(['T', 't']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_works_is_seen_to_work() {
        let (mut processes, own) = (Processes::default(), std::process::id());
        let first = processes.look(own, 1).unwrap();
        assert!(first.cpu_percent.is_none() && first.resident_mib > 0.1, "{first:?}");
        let mut sum = 0u64;
        (0..20_000_000u64).for_each(|i| sum = std::hint::black_box(sum ^ i));
        assert!(processes.look(own, 1_000_000_001).unwrap().cpu_percent.unwrap() > 0.0);
    }

    #[test]
    fn a_process_that_is_no_more_costs_nothing_that_could_be_shown() {
        assert_eq!(Processes::default().look(u32::MAX, 1), None);
    }
}
