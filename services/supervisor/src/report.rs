//! How a run went: one JSON object for scripts, a few lines for people.

use std::fmt;

use launch::counted;
use messages::Flags;
use pipeline::Collector;
use serde::Serialize;

use crate::{RecordingReport, UpError};

/// How a run went.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Report {
    /// Ticks that ingest numbered.
    pub ticks_in: u64,
    /// Ticks with an attitude; where that is made on another host, ticks that every slot here has published.
    pub ticks_out: u64,
    /// Ticks without.
    pub lost: u64,
    /// Of the ticks with an attitude those that the figures below and the file do not have: the supervisor did not take them while the topic
    /// held them.
    pub not_recorded: u64,
    /// Attitudes that came again.
    pub duplicated: u64,
    /// From birth at ingest to publication of the attitude.
    pub latency_us: LatencyUs,
    /// CPU time of all processes per second of the run.
    pub cpu_s_per_s: f64,
    /// Against the truth, where the source knows it.
    pub error_deg: Option<ErrorDeg>,
    /// The processes.
    pub services: Vec<ServiceReport>,
    /// The recording of the flight, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingReport>,
    /// What seems wrong with the input, each with the remedy.
    pub warnings: Vec<String>,
    /// Why it is not as it should be, one reason a line; `None` where it is.
    pub error: Option<String>,
    /// Shared by runs whose attitudes are the same to the last bit.
    #[serde(skip)]
    pub digest: u64,
    /// Readings refused at the source.
    #[serde(skip)]
    pub refused: u64,
    /// Every flag of any attitude.
    #[serde(skip)]
    pub flags: Flags,
    /// What `plumb` ends with.
    #[serde(skip)]
    pub exit_code: u8,
}

/// Latency, µs.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LatencyUs {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

/// Inclination error, degrees.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ErrorDeg {
    /// Root of the mean square.
    pub inclination_rmse: f64,
    /// Largest.
    pub inclination_max: f64,
}

/// A process.
#[derive(Debug, Clone, Serialize)]
pub struct ServiceReport {
    /// Its name.
    pub name: &'static str,
    /// Its process, where there is one.
    pub pid: Option<u32>,
    /// Times it was started again.
    pub restarts: u32,
}

/// What a run knows beside its attitudes.
#[derive(Debug, Clone, Default)]
pub struct Account {
    /// Ticks that ingest numbered, or that were imported.
    pub ticks_in: u64,
    /// Ticks that every slot here has published, where the attitude is made on another host.
    pub ticks_out: Option<u64>,
    /// Readings refused at the source.
    pub refused: u64,
    /// CPU time of all processes per second of the run.
    pub cpu_s_per_s: f64,
    /// The processes.
    pub services: Vec<ServiceReport>,
    /// What the judge of the input has said.
    pub warnings: Vec<String>,
}

impl Report {
    /// The report of a run that has come to its end, or to `failure`.
    pub fn new(mut collector: Collector, account: Account, failure: Option<UpError>) -> Self {
        let unwritten = collector.finish().err().map(UpError::from);
        let without_fused = collector.without_fused();
        let partial = (without_fused > 0).then_some(UpError::WithoutFused { without_fused });
        let accuracy = collector.accuracy();
        let not_recorded = collector.not_recorded();
        // What ingest said last may be older than what came out.
        let ticks_out = account.ticks_out.unwrap_or(collector.ticks() + not_recorded);
        let ticks_in = account.ticks_in.max(collector.next_tick()).max(ticks_out);
        let lost = ticks_in - ticks_out;
        let losses = (lost > 0).then_some(UpError::Lost { lost, ticks_in });
        let gaps = (not_recorded > 0).then_some(UpError::NotRecorded { not_recorded });
        let errors: Vec<_> = [failure, losses, gaps, partial, unwritten].into_iter().flatten().collect();
        let error = errors.iter().map(UpError::to_string).collect::<Vec<_>>().join("\n");
        Self {
            ticks_in,
            ticks_out,
            lost,
            not_recorded,
            duplicated: collector.duplicated(),
            latency_us: LatencyUs::of(&collector),
            cpu_s_per_s: account.cpu_s_per_s,
            error_deg: accuracy.rmse().map(|rmse| ErrorDeg {
                inclination_rmse: rmse.inclination_deg,
                inclination_max: accuracy.max.inclination_deg,
            }),
            services: account.services,
            recording: None,
            warnings: account.warnings,
            error: Some(error).filter(|error| !error.is_empty()),
            digest: collector.digest(),
            refused: account.refused,
            flags: collector.flags(),
            exit_code: errors.first().map_or(0, UpError::exit_code),
        }
    }

    /// Puts down what became of the recording. One that is not whole is told, and is a failure.
    pub(crate) fn record(&mut self, recording: RecordingReport) {
        if let Some(error) = &recording.error {
            let errors: Vec<_> = self.error.take().into_iter().chain([error.clone()]).collect();
            self.error = Some(errors.join("\n"));
            self.exit_code = self.exit_code.max(1);
        }
        self.recording = Some(recording);
    }

    /// The report of what did not run, and with which code it ends.
    pub fn none(error: &dyn fmt::Display, exit_code: u8) -> Self {
        Self { error: Some(error.to_string()), exit_code, ..Self::default() }
    }

    /// The report for scripts: one object on one line.
    pub fn json(&self) -> String {
        // Numbers, strings and lists always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl LatencyUs {
    pub(crate) fn of(collector: &Collector) -> Self {
        let latency = collector.latency_ns();
        let us = |ns: u64| ns as f64 / 1000.0;
        Self {
            p50: us(latency.value_at_quantile(0.5)),
            p99: us(latency.value_at_quantile(0.99)),
            p999: us(latency.value_at_quantile(0.999)),
            max: us(latency.max()),
        }
    }
}

impl fmt::Display for LatencyUs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { p50, p99, p999, max } = self;
        write!(f, "p50 {p50:.0} µs, p99 {p99:.0} µs, p99.9 {p999:.0} µs, max {max:.0} µs")
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ticks_in, ticks_out, lost, duplicated, refused, .. } = self;
        let refused = counted(*refused, "reading");
        writeln!(
            f,
            "ticks    {ticks_in} in, {ticks_out} out, {lost} lost, {duplicated} duplicated, {refused} refused"
        )?;
        writeln!(f, "latency  {}", self.latency_us)?;
        writeln!(f, "cpu      {:.3} s per s", self.cpu_s_per_s)?;
        match self.error_deg {
            Some(ErrorDeg { inclination_rmse, inclination_max }) => {
                writeln!(f, "error    inclination {inclination_rmse:.3}° RMSE, {inclination_max:.3}° max")?;
            }
            None => writeln!(f, "error    unknown: the source has no reference attitude")?,
        }
        if self.flags != Flags::NONE {
            writeln!(f, "flags    {}", self.flags)?;
        }
        if let Some(RecordingReport { file, messages, missed, bytes, .. }) = &self.recording {
            let size = *bytes as f64 * 1e-6;
            let messages = counted(*messages, "message");
            writeln!(f, "flight   {}: {messages}, {missed} missed, {size:.1} MB", file.display())?;
        }
        write!(f, "digest   {:016x}", self.digest)
    }
}
