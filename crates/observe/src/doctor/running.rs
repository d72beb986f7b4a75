//! Checks of a running system: services, rates, input and flags.

use std::time::Duration;

use bus::{BusError, Observer};
use control::{Diagnostic, RecordStatus, ServiceStatus};
use graph::Topic;
use judge::{Diagnosis, FieldQueue, InputCheck};
use launch::{Service, Source, max_buffer_s, pluralize};
use messages::{AttitudeOutput, Flags, ImuSample, Ticked};
use runtime::{Pace, ServiceConfig, clock::monotonic_ns};

use super::{Check, Severity, at_rest::RestCheck, remedy::Remedy};
use crate::flow::FlowMonitor;

/// Interval between two reads of the topics. It is shorter than the time that their buffers cover.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Relative rate error above which a warning is reported.
const WARNING_RATE_ERROR: f64 = 0.05;
/// Relative rate error above which a problem is reported instead of a warning.
const PROBLEM_RATE_ERROR: f64 = 0.2;

/// Factor by which the suggested buffer time exceeds the longest pause so far.
const BUFFER_RESERVE: f64 = 1.2;

/// Data of a system collected during an observation.
#[derive(Debug)]
pub struct Observation {
    flows: Vec<(Service, FlowMonitor)>,
    at_rest: RestCheck,
    input_check: InputCheck,
    fields: FieldQueue,
    diagnoses: Vec<Diagnosis>,
    attitudes: u64,
    flag_counts: [u64; 64],
}

impl Observation {
    /// Observes a system until `is_over` returns `true`.
    ///
    /// # Errors
    ///
    /// Returns an error if a topic cannot be opened or read.
    pub fn collect(observer: &Observer, is_over: &mut dyn FnMut() -> bool) -> Result<Self, BusError> {
        let mut taps = Vec::new();
        for (service, topic) in Service::PATH.into_iter().filter_map(|service| Some((service, service.output()?))) {
            taps.push((service, observer.tap(topic)?, FlowMonitor::new(topic, &messages::layout(topic))));
        }
        let field = observer.tap(Topic::Mag)?;
        let mut observation = Self {
            flows: Vec::new(),
            at_rest: RestCheck::default(),
            input_check: InputCheck::default(),
            fields: FieldQueue::default(),
            diagnoses: Vec::new(),
            attitudes: 0,
            flag_counts: [0; 64],
        };
        while !is_over() {
            std::thread::sleep(POLL_INTERVAL);
            // The check of a sample does not wait for the magnetic field of its tick, so the fields
            // are read first. A field that arrives between the two reads is not checked.
            field.drain(&mut |bytes| {
                bytemuck::try_pod_read_unaligned(bytes).into_iter().for_each(|field| observation.fields.push(field));
            })?;
            for (service, tap, flow) in &mut taps {
                tap.drain(&mut |bytes| {
                    flow.record(bytes, monotonic_ns());
                    observation.record(*service, bytes);
                })?;
            }
        }
        let last = observation.input_check.finish();
        observation.diagnoses.extend(last);
        observation.flows = taps.into_iter().map(|(service, _, flow)| (service, flow)).collect();
        Ok(observation)
    }

    fn record(&mut self, service: Service, bytes: &[u8]) {
        if service == Service::Ingest {
            let Ok(sample) = bytemuck::try_pod_read_unaligned::<ImuSample>(bytes) else { return };
            self.at_rest.push(&sample);
            let field = self.fields.take(sample.header.tick);
            self.diagnoses.extend(self.input_check.update(&sample, field.as_ref()));
        }
        if service == Service::Course {
            let Ok(output) = bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes) else { return };
            self.attitudes += 1;
            let set = (0..64).filter(|bit| output.header().flags.any(Flags(1 << bit)));
            set.for_each(|bit| self.flag_counts[bit] += 1);
        }
    }

    /// Returns the checks of this observation, based on the service status and the rates in
    /// `config`.
    pub fn checks(&self, statuses: &[ServiceStatus], config: &ServiceConfig) -> Vec<Check> {
        let mut checks: Vec<_> = statuses.iter().map(|status| service_check(status, config)).collect();
        checks.extend(statuses.iter().flat_map(diagnostic_checks));
        checks.extend(self.rate_checks(config));
        checks.extend(self.at_rest.checks(config));
        checks.extend(self.input_checks());
        checks.extend(self.flag_checks());
        checks
    }

    fn rate_checks(&self, config: &ServiceConfig) -> Vec<Check> {
        let declared_hz = match config.pace {
            Pace::Speed(speed) => Some(config.rate_hz * speed),
            Pace::Max => None,
        };
        let rate_of = |(_, flow): &(Service, FlowMonitor)| flow.report().rate_hz;
        let samples_hz = self.flows.iter().find(|(service, _)| *service == Service::Ingest).and_then(rate_of);
        let source = config.launch.ingest.source;
        // The rate of a live sensor is not known in advance. The rate of each topic is therefore
        // compared with that of the samples.
        let expected_hz = if source.is_repeatable() { declared_hz } else { samples_hz.or(declared_hz) };
        let checks = self.flows.iter().map(|(service, flow)| rate_check(*service, flow, expected_hz, config));
        // This check is for readings from the bus. For the other live sources, the drivers report a
        // wrong rate.
        let declared = config.launch.ingest.declared_rate_hz().and(declared_hz);
        let declared = declared.zip(samples_hz).filter(|_| source == Source::Bus);
        checks.chain(declared.and_then(|(declared, measured)| declared_rate_check(declared, measured))).collect()
    }

    fn input_checks(&self) -> Vec<Check> {
        let check = "input";
        if self.diagnoses.is_empty() {
            return vec![Check::ok(check, "units, axes and signs of the sensors look plausible")];
        }
        let warning = |diagnosis: &Diagnosis| {
            let found = format!("{}: {}", diagnosis.issue.name(), diagnosis.evidence);
            Check::warning(check, found, Remedy::CorrectInput(diagnosis.remedies()))
        };
        self.diagnoses.iter().map(warning).collect()
    }

    fn flag_checks(&self) -> Vec<Check> {
        let check = "flags";
        let flag_checks = Flags::NAMES.iter().zip(Flags::MEANINGS).filter_map(|((flag, name), meaning)| {
            let count = self.flag_counts[flag.0.trailing_zeros() as usize];
            let found = format!("{name} on {count} of {}: {meaning}", pluralize(self.attitudes, "attitude"));
            (count > 0).then(|| match Flags::INFORMATIONAL.any(*flag) {
                true => Check::ok(check, found),
                false => Check::warning(check, found, Remedy::ExplainFlags),
            })
        });
        let flag_checks: Vec<_> = flag_checks.collect();
        if flag_checks.is_empty() {
            vec![Check::ok(check, format!("none on {}", pluralize(self.attitudes, "attitude")))]
        } else {
            flag_checks
        }
    }
}

/// Checks that the supervisor recorded all attitudes in its report and in the output file.
pub fn record_check(RecordStatus { not_recorded, output_error }: &RecordStatus, config: &ServiceConfig) -> Check {
    let check = "record";
    let attitudes = pluralize(*not_recorded, "attitude");
    let found = format!("published, but missing from the report's figures and the output file: {attitudes}");
    match output_error {
        Some(error) => Check::problem(check, format!("{error}; {found}"), Remedy::FreeDiskSpace),
        None if *not_recorded > 0 => {
            let found = format!("{found}; the supervisor was stopped or starved for longer than buffer_s");
            Check::warning(check, found, enlarge_buffers(*not_recorded, config))
        }
        None => Check::ok(check, "every attitude is in the report's figures and in the output file, if any"),
    }
}

/// Returns the remedy for messages that were overwritten before they were read.
fn enlarge_buffers(lost: u64, config: &ServiceConfig) -> Remedy {
    let needed_s = config.launch.buffer_s + lost as f64 / config.rate_hz;
    Remedy::EnlargeBuffers((BUFFER_RESERVE * needed_s).ceil().min(max_buffer_s(config.rate_hz)))
}

fn service_check(status: &ServiceStatus, config: &ServiceConfig) -> Check {
    let ServiceStatus { service, state, pid, restarts, lost, .. } = status;
    let check = "services";
    let pid = pid.map_or("none".into(), |pid| pid.to_string());
    let found = format!("{service} {state}, process {pid}, restarts {restarts}, lost {lost}");
    match state.raw() {
        "failed" | "silent" => Check::problem(check, found, Remedy::ReadMessages),
        "backoff" | "starting" => Check::warning(check, found, Remedy::RunAgain),
        _ if *lost > 0 && [Service::Ingest, Service::Drivers].map(Service::name).contains(&service.raw()) => {
            Check::warning(check, format!("{found} before a tick"), enlarge_buffers(*lost, config))
        }
        _ if *lost > 0 => Check::warning(check, found, enlarge_buffers(*lost, config)),
        _ if *restarts > 0 => Check::warning(check, found, Remedy::ReadMessages),
        _ => Check::ok(check, found),
    }
}

/// Returns the diagnostics reported by the service, such as a device fault. A wrong declared rate
/// is only a warning.
fn diagnostic_checks(status: &ServiceStatus) -> impl Iterator<Item = Check> {
    let check = |diagnostic: &Diagnostic| {
        let found = diagnostic.found.to_string();
        let remedy = Remedy::CorrectSource(diagnostic.remedy.to_string());
        match diagnostic.kind.raw() {
            "rate" => Check::warning("source", found, remedy),
            _ => Check::problem("source", found, remedy),
        }
    };
    status.diagnostics.iter().map(check)
}

/// Returns a warning if another program publishes readings at a rate that differs from the declared
/// one.
fn declared_rate_check(declared_hz: f64, measured_hz: f64) -> Option<Check> {
    let is_wrong = (measured_hz / declared_hz - 1.0).abs() > PROBLEM_RATE_ERROR;
    is_wrong.then(|| {
        Check::warning(
            "source",
            format!("{measured_hz:.1} samples/s arrive, rate_hz declares {declared_hz:.1}"),
            Remedy::DeclareRate(measured_hz),
        )
    })
}

fn rate_check(service: Service, flow: &FlowMonitor, expected_hz: Option<f64>, config: &ServiceConfig) -> Check {
    let check = "rates";
    let report = flow.report();
    let topic = &report.topic;
    let Some(rate_hz) = report.rate_hz else {
        let found = format!("{topic}: {} during the observation", pluralize(report.messages, "message"));
        let source = config.launch.ingest.source;
        let remedy = if service != Service::Ingest {
            Remedy::CheckUpstreamServices
        } else if source == Source::Bus {
            Remedy::StartSensorProgram
        } else if source.needs_drivers() {
            Remedy::CheckDevice
        } else {
            Remedy::CheckSourceEnd
        };
        return Check::problem(check, found, remedy);
    };
    let lost = report.lost.unwrap_or(0);
    let found = format!("{topic}: {rate_hz:.1} Hz, lost on the bus {lost}");
    let Some(expected_hz) = expected_hz else { return Check::ok(check, format!("{found}; as fast as possible")) };
    let found = format!("{found}; expected {expected_hz:.1} Hz");
    let error = (rate_hz / expected_hz - 1.0).abs();
    let result = match error {
        _ if error > PROBLEM_RATE_ERROR => Severity::Problem,
        _ if error > WARNING_RATE_ERROR || lost > 0 => Severity::Warning,
        _ => return Check::ok(check, found),
    };
    Check { check, result, found, remedy: Some(Remedy::ReduceLoad) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use launch::Launch;

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
    fn wrong_declared_rate_is_one_warning() {
        let of_drivers = |kind: &str| ServiceStatus {
            diagnostics: vec![Diagnostic { kind: kind.into(), found: "100".into(), remedy: "set rate_hz".into() }],
            ..status("running", 0)
        };
        let results = |kind| diagnostic_checks(&of_drivers(kind)).map(|check| check.result).collect::<Vec<_>>();
        assert_eq!((results("rate"), results("silent")), (vec![Severity::Warning], vec![Severity::Problem]));
        let warned = [100.0, 1000.0, 1190.0, 1210.0].map(|measured| declared_rate_check(1000.0, measured).is_some());
        assert_eq!(warned, [true, false, false, true]);
    }

    #[test]
    fn service_state_and_losses_set_severity() {
        let config = ServiceConfig::standalone(Launch::default(), 1000.0, Pace::Max);
        let results = [("running", 0), ("ready", 0), ("running", 1), ("backoff", 0), ("silent", 0), ("failed", 0)]
            .map(|(state, lost)| service_check(&status(state, lost), &config).result);
        use Severity::{Ok, Problem, Warning};
        assert_eq!(results, [Ok, Ok, Warning, Warning, Problem, Problem]);
    }
}
