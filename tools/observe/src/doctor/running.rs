//! Services, rates and flags of a running system.

use std::time::Duration;

use bus::{BusError, Observer};
use control::{RecordStatus, ServiceStatus, Diagnostic};
use graph::Topic;
use judge::{FieldQueue, Diagnosis, InputCheck};
use launch::{Service, Source, pluralize};
use messages::{AttitudeOutput, Flags, ImuSample, Ticked};
use runtime::{Pace, ServiceConfig, clock::monotonic_ns};

use super::{Check, Outcome, still::Still};
use crate::flow::Flow;

/// Between two looks at the topics: shorter than what their buffers hold.
const LOOK: Duration = Duration::from_millis(5);
/// A rate may be this far from the one declared.
const RATE_SHARE: f64 = 0.05;
/// Beyond it samples are missing.
const MAX_RATE_SHARE: f64 = 0.2;

/// What a system did while it was looked at.
#[derive(Debug)]
pub struct Seen {
    flows: Vec<(Service, Flow)>,
    still: Still,
    judge: InputCheck,
    fields: FieldQueue,
    findings: Vec<Diagnosis>,
    attitudes: u64,
    flags: [u64; 64],
}

impl Seen {
    /// Looks at a system until `ends`.
    pub fn watch(observer: &Observer, ends: &mut dyn FnMut() -> bool) -> Result<Self, BusError> {
        let mut taps = Vec::new();
        for (service, topic) in Service::PATH.into_iter().filter_map(|service| Some((service, service.output()?))) {
            taps.push((service, observer.tap(topic)?, Flow::new(topic, &messages::layout(topic))));
        }
        let field = observer.tap(Topic::Mag)?;
        let mut seen = Self {
            flows: Vec::new(),
            still: Still::default(),
            judge: InputCheck::default(),
            fields: FieldQueue::default(),
            findings: Vec::new(),
            attitudes: 0,
            flags: [0; 64],
        };
        while !ends() {
            std::thread::sleep(LOOK);
            // Before their samples, which do not wait: of a field that comes meanwhile nothing is said.
            field.drain(&mut |bytes| {
                bytemuck::try_pod_read_unaligned(bytes).into_iter().for_each(|field| seen.fields.push(field));
            })?;
            for (service, tap, flow) in &mut taps {
                tap.drain(&mut |bytes| {
                    flow.take(bytes, monotonic_ns());
                    seen.take(*service, bytes);
                })?;
            }
        }
        let last = seen.judge.finish();
        seen.findings.extend(last);
        seen.flows = taps.into_iter().map(|(service, _, flow)| (service, flow)).collect();
        Ok(seen)
    }

    fn take(&mut self, service: Service, bytes: &[u8]) {
        match service {
            Service::Ingest => {
                let Ok(sample) = bytemuck::try_pod_read_unaligned::<ImuSample>(bytes) else { return };
                self.still.take(&sample);
                let field = self.fields.take(sample.header.tick);
                self.findings.extend(self.judge.update(&sample, field.as_ref()));
            }
            Service::Course => {
                let Ok(output) = bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes) else { return };
                self.attitudes += 1;
                let set = (0..64).filter(|bit| output.header().flags.any(Flags(1 << bit)));
                set.for_each(|bit| self.flags[bit] += 1);
            }
            _ => {}
        }
    }

    /// What is to be said about it, with what the supervisor says and what was to run.
    pub fn checks(&self, statuses: &[ServiceStatus], config: &ServiceConfig) -> Vec<Check> {
        let mut checks: Vec<_> = statuses.iter().map(service).collect();
        checks.extend(statuses.iter().flat_map(troubles));
        checks.extend(self.rates(config));
        checks.extend(self.still.checks());
        checks.extend(self.input());
        checks.extend(self.flags());
        checks
    }

    fn rates(&self, config: &ServiceConfig) -> Vec<Check> {
        let expected_hz = match config.pace {
            Pace::Speed(speed) => Some(config.rate_hz * speed),
            Pace::Max => None,
        };
        self.flows.iter().map(|(service, flow)| rate(*service, flow, expected_hz, config)).collect()
    }

    /// Units, axes and signs of what comes in.
    fn input(&self) -> Vec<Check> {
        let check = "input";
        if self.findings.is_empty() {
            return vec![Check::ok(check, "units, axes and signs of the sensors are such as can be")];
        }
        let warning = |finding: &Diagnosis| {
            let found = format!("{}: {}", finding.issue.name(), finding.evidence);
            Check::warning(check, found, finding.remedies())
        };
        self.findings.iter().map(warning).collect()
    }

    fn flags(&self) -> Vec<Check> {
        let check = "flags";
        let explained = Flags::NAMES.iter().zip(Flags::MEANINGS).filter_map(|((flag, name), meaning)| {
            let count = self.flags[flag.0.trailing_zeros() as usize];
            let found = format!("{name} on {count} of {}: {meaning}", pluralize(self.attitudes, "attitude"));
            (count > 0).then(|| match Flags::INFORMATIONAL.any(*flag) {
                true => Check::ok(check, found),
                false => Check::warning(check, found, "see `plumb topic echo attitude`, and docs/bad-input.md"),
            })
        });
        let explained: Vec<_> = explained.collect();
        if explained.is_empty() {
            vec![Check::ok(check, format!("none on {}", pluralize(self.attitudes, "attitude")))]
        } else {
            explained
        }
    }
}

/// What is to be said about the report and the file that it will leave.
pub fn record(RecordStatus { not_recorded, output_error: out_ended }: &RecordStatus) -> Check {
    let check = "record";
    let attitudes = pluralize(*not_recorded, "attitude");
    let found = format!("published, but neither in the report's figures nor in the file: {attitudes}");
    match out_ended {
        Some(error) => {
            Check::problem(check, format!("{error}; {found}"), "make room, and start the system anew when it may rest")
        }
        None if *not_recorded > 0 => {
            let remedy = "its supervisor stood still for longer than buffer_s: raise it, and see who stopped it or took the machine";
            Check::warning(check, found, remedy)
        }
        None => Check::ok(check, "every attitude is in the report's figures, and in the file where there is one"),
    }
}

fn service(status: &ServiceStatus) -> Check {
    let ServiceStatus { service, state, pid, restarts, lost, .. } = status;
    let check = "services";
    let pid = pid.map_or("none".into(), |pid| pid.to_string());
    let found = format!("{service} {state}, process {pid}, restarts {restarts}, lost {lost}");
    match state.as_str() {
        "failed" | "silent" => {
            Check::problem(check, found, "see what it said on the terminal of `plumb up`, or its journal")
        }
        "backoff" | "starting" => {
            Check::warning(check, found, "look again; a service that cannot live is given up after `[restart] limit`")
        }
        _ if *lost > 0 => {
            Check::warning(check, found, "ticks were lost: is the machine overloaded? raise buffer_s and lateness_s")
        }
        _ if *restarts > 0 => {
            Check::warning(check, found, "it ended by itself; see what it said on the terminal of `plumb up`")
        }
        _ => Check::ok(check, found),
    }
}

/// What is wrong with what the service reads.
fn troubles(status: &ServiceStatus) -> impl Iterator<Item = Check> {
    let check = |trouble: &Diagnostic| Check::problem("source", &trouble.found, &trouble.remedy);
    status.diagnostics.iter().map(check)
}

fn rate(service: Service, flow: &Flow, expected_hz: Option<f64>, config: &ServiceConfig) -> Check {
    let check = "rates";
    let report = flow.report();
    let topic = &report.topic;
    let Some(rate_hz) = report.rate_hz else {
        let found = format!("{topic}: {} while it was looked at", pluralize(report.messages, "message"));
        let remedy = match (service, config.launch.ingest.source) {
            (Service::Ingest, Source::Bus) => "is the sensor's driver running? it publishes on the topic `sensor`",
            (Service::Ingest, source) if source.needs_drivers() => {
                "does the device send? what the drivers say of it is on the terminal of `plumb up`"
            }
            (Service::Ingest, _) => "is the source at its end? see `plumb ps`",
            _ => "see the services before it",
        };
        return Check::problem(check, found, remedy);
    };
    let lost = report.lost.unwrap_or(0);
    let found = format!("{topic}: {rate_hz:.1} Hz, lost on the bus {lost}");
    let Some(expected_hz) = expected_hz else { return Check::ok(check, format!("{found}; as fast as possible")) };
    let found = format!("{found}; declared {expected_hz:.1} Hz");
    let off = (rate_hz / expected_hz - 1.0).abs();
    let remedy = "is the machine overloaded, or is rate_hz in launch.toml not the sensor's?";
    let result = match off {
        _ if off > MAX_RATE_SHARE => Outcome::Problem,
        _ if off > RATE_SHARE || lost > 0 => Outcome::Warning,
        _ => return Check::ok(check, found),
    };
    Check { check, result, found, remedy: Some(remedy.into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(state: &str, lost: u64) -> ServiceStatus {
        ServiceStatus {
            service: "gyro".into(),
            stage: None,
            state: state.into(),
            pid: Some(1),
            restarts: 0,
            incarnation: 1,
            epoch: 1,
            ticks: 10,
            lost,
            address: None,
            diagnostics: Vec::new(),
        }
    }

    #[test]
    fn a_service_that_does_not_work_is_never_found_ok() {
        let results = [("running", 0), ("ready", 0), ("running", 1), ("backoff", 0), ("silent", 0), ("failed", 0)]
            .map(|(state, lost)| service(&status(state, lost)).result);
        use Outcome::{Ok, Problem, Warning};
        assert_eq!(results, [Ok, Ok, Warning, Warning, Problem, Problem]);
    }
}
