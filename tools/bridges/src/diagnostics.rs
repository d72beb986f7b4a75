//! Statuses of a system for `diagnostic_msgs/msg/DiagnosticArray`.
//!
//! - Input: attitudes, and the statuses of the services as reported by the supervisor.
//! - Output: a status for the attitude and one for each service, with level, message and values.
//! - Time: CLOCK_MONOTONIC, ns.

use control::ServiceStatus;
use messages::{AttitudeOutput, Flags};

use crate::{
    ros::NODE_NAME,
    validity::{self, WithholdReason},
};

/// Time in ns without a new attitude after which the attitude is reported as stale.
pub const STALE_AFTER_NS: u64 = 1_000_000_000;
/// Flags of unusable attitudes. Such an attitude is an initial value or does not follow the motion.
const ERRORS: Flags =
    Flags(Flags::UNALIGNED.0 | Flags::RESET.0 | Flags::RATE_INVALID.0 | Flags::RATE_STUCK.0 | Flags::GYRO_MISSING.0);

/// Level of a status, as numbered in `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// No problem.
    Ok = 0,
    /// The attitude has restricted validity, or the service is starting, restarting or reporting a
    /// problem.
    Warn = 1,
    /// The attitude is unusable, or the service has failed or is silent.
    Error = 2,
    /// No recent attitude.
    Stale = 3,
}

/// Status of a component of the system.
#[derive(Debug, Clone, PartialEq)]
pub struct Status {
    /// Severity.
    pub level: Level,
    /// Name of the component, preceded by the node name.
    pub name: String,
    /// Description of the condition.
    pub message: String,
    /// Keys and values.
    pub values: Vec<(&'static str, String)>,
}

/// Collects attitudes between two reports.
#[derive(Debug, Default)]
pub struct AttitudeMonitor {
    newest: Option<AttitudeOutput>,
    /// Union of the flags since the last report.
    flags: Flags,
    /// Tick of the newest attitude at the last report, and time of its publication in ns. Before
    /// the first report, these are the values of the first attitude.
    previous: Option<(u64, u64)>,
}

impl AttitudeMonitor {
    /// Records an attitude.
    pub fn record(&mut self, output: &AttitudeOutput) {
        self.flags |= output.header.flags;
        self.previous.get_or_insert((output.header.tick, output.header.t_sent_ns));
        self.newest = Some(*output);
    }

    /// Returns the status of the attitude. Flags and rate cover the time since the last report.
    pub fn report(&mut self, now_ns: u64) -> Status {
        let flags = std::mem::take(&mut self.flags);
        let name = format!("{NODE_NAME}: attitude");
        let Some(newest) = self.newest else {
            return Status { level: Level::Stale, name, message: "no attitude yet".into(), values: Vec::new() };
        };
        let (tick, sent_ns) = (newest.header.tick, newest.header.t_sent_ns);
        let age_ns = now_ns.saturating_sub(sent_ns);
        let age_s = age_ns as f64 * 1e-9;
        let (previous_tick, previous_ns) = self.previous.replace((tick, sent_ns)).unwrap_or((tick, sent_ns));
        let interval_s = sent_ns.saturating_sub(previous_ns) as f64 * 1e-9;
        let rate_hz = if interval_s > 0.0 { tick.saturating_sub(previous_tick) as f64 / interval_s } else { 0.0 };
        let listed = |flags: Flags| flags.names().collect::<Vec<_>>().join(" ");
        let notable = Flags(flags.0 & !Flags::INFORMATIONAL.0);
        let (level, message) = if age_ns > STALE_AFTER_NS {
            (Level::Stale, format!("no attitude for {age_s:.1} s"))
        } else if validity::validate(&newest, sent_ns) == Err(WithholdReason::Invalid) {
            (Level::Error, "the attitude is not a finite rotation".into())
        } else if notable.any(ERRORS) {
            (Level::Error, format!("unusable attitudes: {}", listed(notable)))
        } else if notable != Flags::NONE {
            (Level::Warn, format!("restricted attitudes: {}", listed(notable)))
        } else {
            (Level::Ok, "attitudes are valid".into())
        };
        let values = vec![
            ("rate_hz", format!("{rate_hz:.1}")),
            ("age_s", format!("{age_s:.3}")),
            ("tick", tick.to_string()),
            ("course_reference", newest.course_reference.name().into()),
            ("inclination_sd_deg", format!("{:.3}", newest.inclination_sd_rad.to_degrees())),
            ("course_sd_deg", format!("{:.3}", newest.course_sd_rad.to_degrees())),
            ("reset_counter", newest.reset_counter.to_string()),
            ("flags", listed(flags)),
        ];
        Status { level, name, message, values }
    }
}

/// Returns the status of a service.
pub fn service_status(service: &ServiceStatus) -> Status {
    let diagnostics: Vec<_> = service.diagnostics.iter().map(|one| one.found.to_string()).collect();
    let level = match service.state.raw() {
        "failed" | "silent" => Level::Error,
        "ready" | "running" | "finished" if diagnostics.is_empty() => Level::Ok,
        // The service is starting, is about to be restarted, or reports problems with its input.
        _ => Level::Warn,
    };
    let stage = service.stage.iter().map(|stage| ("stage", stage.to_string()));
    let counts = [("ticks", service.ticks), ("lost", service.lost), ("restarts", service.restarts.into())];
    Status {
        level,
        name: format!("{NODE_NAME}: {}", service.service),
        message: [vec![service.state.to_string()], diagnostics].concat().join("; "),
        values: stage.chain(counts.map(|(key, count)| (key, count.to_string()))).collect(),
    }
}

/// Returns the status of a supervisor that does not respond. `cause` is the error of the request.
pub fn silent_supervisor_status(cause: &dyn std::fmt::Display) -> Status {
    let name = format!("{NODE_NAME}: supervisor");
    Status { level: Level::Error, name, message: cause.to_string(), values: Vec::new() }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use control::Diagnostic;

    use super::*;

    const S: u64 = 1_000_000_000;

    fn attitude(tick: u64, t_sent_ns: u64, flags: Flags) -> AttitudeOutput {
        let mut output = AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], ..Zeroable::zeroed() };
        (output.header.tick, output.header.t_sent_ns, output.header.flags) = (tick, t_sent_ns, flags);
        output
    }

    fn value<'a>(status: &'a Status, key: &str) -> &'a str {
        status.values.iter().find(|(name, _)| *name == key).map_or("", |(_, value)| value)
    }

    #[test]
    fn missing_and_old_attitudes_are_stale() {
        let mut monitor = AttitudeMonitor::default();
        assert_eq!(monitor.report(S).level, Level::Stale);
        monitor.record(&attitude(1, S, Flags::NONE));
        assert_eq!(monitor.report(S + STALE_AFTER_NS).level, Level::Ok);
        let status = monitor.report(S + STALE_AFTER_NS + 1);
        assert_eq!((status.level, status.message.as_str()), (Level::Stale, "no attitude for 1.0 s"));
        assert_eq!(value(&status, "rate_hz"), "0.0");
    }

    #[test]
    fn level_follows_worst_flag_since_last_report() {
        let level = |flags: &[Flags]| {
            let mut monitor = AttitudeMonitor::default();
            flags.iter().for_each(|flags| monitor.record(&attitude(1, S, *flags)));
            let level = monitor.report(S).level;
            assert_eq!(monitor.report(S).level, Level::Ok, "flags are reported once");
            level
        };
        assert_eq!(level(&[Flags::NONE, Flags::INFORMATIONAL]), Level::Ok);
        assert_eq!(level(&[Flags::FORCE_CLIPPED, Flags::NONE]), Level::Warn);
        assert_eq!(level(&[Flags::GYRO_MISSING, Flags::FORCE_CLIPPED, Flags::NONE]), Level::Error);
        assert_eq!(level(&[Flags::UNALIGNED]), Level::Error);
        let mut monitor = AttitudeMonitor::default();
        monitor.record(&AttitudeOutput { quaternion: [0.0; 4], ..attitude(1, S, Flags::NONE) });
        assert_eq!(monitor.report(S).level, Level::Error);
    }

    #[test]
    fn values_contain_rate_age_and_flags() {
        let mut monitor = AttitudeMonitor::default();
        for tick in 0..=200 {
            monitor.record(&attitude(tick, S + tick * S / 200, Flags::AT_REST));
        }
        let status = monitor.report(2 * S + S / 4);
        let found = ["rate_hz", "age_s", "tick", "course_reference", "flags"].map(|key| value(&status, key));
        assert_eq!(found, ["200.0", "0.250", "200", "arbitrary", "at-rest"]);
    }

    #[test]
    fn service_status_has_stage_and_problems() {
        let status = |state: &str, problems: &[&str]| {
            let problem =
                |found: &&str| Diagnostic { kind: "rate-unit".into(), found: (*found).into(), remedy: "".into() };
            service_status(&ServiceStatus {
                service: "fuser".into(),
                stage: Some("wz".into()),
                state: state.into(),
                diagnostics: problems.iter().map(problem).collect(),
                ..ServiceStatus::default()
            })
        };
        let running = status("running", &[]);
        assert_eq!((running.level, running.name.as_str()), (Level::Ok, "plumbline: fuser"));
        assert_eq!((running.message.as_str(), value(&running, "stage")), ("running", "wz"));
        let warned = status("running", &["the rate is in °/s"]);
        assert_eq!((warned.level, warned.message.as_str()), (Level::Warn, "running; the rate is in °/s"));
        let levels = ["finished", "starting", "backoff", "silent", "failed"].map(|state| status(state, &[]).level);
        assert_eq!(levels, [Level::Ok, Level::Warn, Level::Warn, Level::Error, Level::Error]);
    }
}
