//! Report of a run: a JSON object for scripts and a short text for the user.

use std::{fmt, path::PathBuf};

use launch::pluralize;
use messages::Flags;
use pipeline::Collector;
use serde::Serialize;

use crate::error::UpError;

/// Report of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Report {
    /// Number of ticks received from ingest.
    pub ticks_in: u64,
    /// Number of ticks with an attitude. If another host computes the attitude, this is the number
    /// of ticks that all local slots have published.
    pub ticks_out: u64,
    /// Number of ticks without an attitude.
    pub lost: u64,
    /// Number of datagrams and readings that were lost before ingest numbered them.
    pub lost_readings: u64,
    /// Number of attitudes that are missing from the figures of this report and from the output
    /// file.
    ///
    /// The supervisor did not collect these attitudes before they were overwritten in the topic.
    pub not_recorded: u64,
    /// Number of attitudes published more than once.
    pub duplicated: u64,
    /// Latency from the reception of a sample at ingest to the publication of its attitude.
    pub latency_us: LatencyUs,
    /// CPU time of all processes per second of the run, s.
    pub cpu_s_per_s: f64,
    /// Error against the reference attitude, if the source has one.
    pub error_deg: Option<ErrorDeg>,
    /// Services of the system.
    pub services: Vec<ServiceReport>,
    /// Summary of the flight recording, if there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingReport>,
    /// Warnings about implausible input, with remedies.
    pub warnings: Vec<String>,
    /// Reasons why the run failed, one per line; `None` if it succeeded.
    pub error: Option<String>,
    /// Digest of all attitudes. Equal digests mean bit-identical attitudes.
    #[serde(skip)]
    pub digest: u64,
    /// Number of readings rejected at the source.
    #[serde(skip)]
    pub rejected: u64,
    /// Union of the flags of all attitudes.
    #[serde(skip)]
    pub flags: Flags,
    /// Exit code of `plumb`.
    #[serde(skip)]
    pub exit_code: u8,
}

/// Latency quantiles, µs.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LatencyUs {
    /// Median, µs.
    pub p50: f64,
    /// 99th percentile, µs.
    pub p99: f64,
    /// 99.9th percentile, µs.
    pub p999: f64,
    /// Maximum, µs.
    pub max: f64,
}

/// Error of the inclination against the reference attitude, in degrees.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ErrorDeg {
    /// Root mean square error, in degrees.
    pub inclination_rmse: f64,
    /// Maximum error, degrees.
    pub inclination_max: f64,
}

/// Service of a run.
#[derive(Debug, Clone, Serialize)]
pub struct ServiceReport {
    /// Service name.
    pub name: &'static str,
    /// Process ID, if a process runs.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u32,
}

/// Totals of a run that are not available from the collector.
#[derive(Debug, Clone, Default)]
pub struct RunTotals {
    /// Number of ticks received from ingest or from another host.
    pub ticks_in: u64,
    /// Number of ticks that all local slots have published, if another host computes the attitude.
    pub ticks_out: Option<u64>,
    /// Number of readings rejected at the source.
    pub rejected: u64,
    /// Number of datagrams and readings that were lost before ingest numbered them.
    pub lost_readings: u64,
    /// CPU time of all processes per second of the run, s.
    pub cpu_s_per_s: f64,
    /// Services of the system.
    pub services: Vec<ServiceReport>,
    /// Warnings about implausible input.
    pub warnings: Vec<String>,
}

impl Report {
    /// Creates the report of a run that ended normally or with `failure`.
    pub fn new(mut collector: Collector, totals: RunTotals, failure: Option<UpError>) -> Self {
        let unwritten = collector.finish().err().map(UpError::from);
        let without_fused = collector.lines_without_fused();
        let partial = (without_fused > 0).then_some(UpError::WithoutFused { without_fused });
        let accuracy = collector.accuracy();
        let not_recorded = collector.not_recorded();
        let ticks_out = totals.ticks_out.unwrap_or(collector.ticks() + not_recorded);
        // `totals.ticks_in` may be outdated, so it is raised to the number of ticks already output.
        let ticks_in = totals.ticks_in.max(collector.next_tick()).max(ticks_out);
        let lost = ticks_in - ticks_out;
        let losses = (lost > 0).then_some(UpError::Lost { lost, ticks_in });
        let gaps = (not_recorded > 0).then_some(UpError::NotRecorded { not_recorded });
        let errors: Vec<_> = [failure, losses, gaps, partial, unwritten].into_iter().flatten().collect();
        let error = errors.iter().map(UpError::to_string).collect::<Vec<_>>().join("\n");
        Self {
            ticks_in,
            ticks_out,
            lost,
            lost_readings: totals.lost_readings,
            not_recorded,
            duplicated: collector.duplicated(),
            latency_us: LatencyUs::from_collector(&collector),
            cpu_s_per_s: totals.cpu_s_per_s,
            error_deg: accuracy.rmse().map(|rmse| ErrorDeg {
                inclination_rmse: rmse.inclination_deg,
                inclination_max: accuracy.max.inclination_deg,
            }),
            services: totals.services,
            recording: None,
            warnings: totals.warnings,
            error: Some(error).filter(|error| !error.is_empty()),
            digest: collector.digest(),
            rejected: totals.rejected,
            flags: collector.flags(),
            exit_code: errors.first().map_or(0, UpError::exit_code),
        }
    }

    /// Adds the summary of the recording. An incomplete recording is a failure of the run.
    pub(crate) fn set_recording(&mut self, recording: RecordingReport) {
        if let Some(error) = &recording.error {
            let errors: Vec<_> = self.error.take().into_iter().chain([error.clone()]).collect();
            self.error = Some(errors.join("\n"));
            self.exit_code = self.exit_code.max(1);
        }
        self.recording = Some(recording);
    }

    /// Creates the report of a run that did not start.
    pub fn from_error(error: &dyn fmt::Display, exit_code: u8) -> Self {
        Self { error: Some(error.to_string()), exit_code, ..Self::default() }
    }

    /// Returns the report as a JSON object on one line.
    pub fn to_json(&self) -> String {
        // Serialising numbers, strings and lists cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl LatencyUs {
    pub(crate) fn from_collector(collector: &Collector) -> Self {
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
        let Self { ticks_in, ticks_out, lost, lost_readings, duplicated, rejected, .. } = self;
        let rejected = pluralize(*rejected, "reading");
        writeln!(
            f,
            "ticks    {ticks_in} in, {ticks_out} out, {lost} lost, {duplicated} duplicated, {rejected} rejected"
        )?;
        if *lost_readings > 0 {
            writeln!(f, "input    {} lost before a tick", pluralize(*lost_readings, "reading"))?;
        }
        writeln!(f, "latency  {}", self.latency_us)?;
        writeln!(f, "cpu      {:.3} s per s", self.cpu_s_per_s)?;
        match self.error_deg {
            Some(ErrorDeg { inclination_rmse, inclination_max }) => {
                writeln!(f, "error    inclination {inclination_rmse:.3}° RMSE, {inclination_max:.3}° max")?;
            }
            None => writeln!(f, "accuracy not measured: the source has no reference attitude")?,
        }
        if self.flags != Flags::NONE {
            writeln!(f, "flags    {}", self.flags)?;
        }
        if let Some(RecordingReport { file, messages, missed, bytes, .. }) = &self.recording {
            let size = *bytes as f64 * 1e-6;
            let messages = pluralize(*messages, "message");
            writeln!(f, "flight   {}: {messages}, {missed} missed, {size:.1} MB", foreign::path(file))?;
        }
        write!(f, "digest   {:016x}", self.digest)
    }
}

/// Summary of a recording.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RecordingReport {
    /// Path of the file.
    pub file: PathBuf,
    /// Number of recorded messages.
    pub messages: u64,
    /// Lower bound on the number of published messages that are missing from the file.
    pub missed: u64,
    /// File size in bytes.
    pub bytes: u64,
    /// Reason why the recording is incomplete; `None` if it is complete.
    pub error: Option<String>,
}
