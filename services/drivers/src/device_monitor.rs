//! Detects device problems: unavailable or silent device, wrong format, ambiguous dates, no
//! measurements, corrupted data, second sender, foreign systems, dropped datagrams, rate other than
//! declared, unsteady clock.
//!
//! Input: one report per second.
//!
//! Output: the current problems with their remedies.
//!
//! Time: counted in reports, one per second.

use std::collections::VecDeque;

use control::Diagnostic;

use crate::input::DeviceReport;

/// Problem kind: the port cannot be opened or read.
pub(crate) const UNAVAILABLE: &str = "unavailable";
/// Problem kind: the device is open but sends no bytes.
const SILENT: &str = "silent";
/// Problem kind: many bytes have arrived, but no valid message.
const FORMAT: &str = "format";
/// Problem kind: the order of day and month in the dates is unknown.
const DATE: &str = "date";
/// Problem kind: the messages contain no measurement.
const NO_MEASUREMENT: &str = "no-measurement";
/// Problem kind: too many messages are rejected, or too many bytes belong to no message.
const CORRUPTED: &str = "corrupted";
/// Problem kind: a second sender sends datagrams to the same port.
const SECOND_SENDER: &str = "second-sender";
/// Problem kind: measurements arrive only from systems or components that are not decoded.
const FOREIGN_SYSTEM: &str = "foreign-system";
/// Problem kind: the kernel dropped datagrams before they were read.
const DROPPED: &str = "dropped";
/// Problem kind: measurements arrive faster or slower than declared.
const RATE: &str = "rate";
/// Problem kind: the device's clock often jumps, steps back or stands still.
const CLOCK: &str = "clock";

/// Duration of the evaluated window, s. It is also the number of reports in the window, because
/// there is one report per second.
const WINDOW_S: usize = 10;
/// Time without bytes after which an open device counts as silent, s.
const SILENCE_S: usize = 3;
/// Number of bytes without a valid message at which a wrong format or baud rate is reported. It is
/// many times the length of a typical message.
const FORMAT_BYTES: u64 = 1024;
/// Number of received messages without a measurement at which a problem is reported.
const MIN_MESSAGES: u64 = 100;
/// Maximum share of rejected messages. An intact connection stays below it.
const MAX_REJECTED_SHARE: f64 = 0.01;
/// Maximum share of bytes that belong to no message. An intact connection stays below it.
const MAX_SKIPPED_SHARE: f64 = 0.05;
/// Maximum ratio between the measured and the declared rate, in either direction. Above it, the
/// declared rate counts as wrong. The clock fit allows the same deviation.
const MAX_RATE_RATIO: f64 = 1.5;
/// Minimum number of clock steps within the window at which a problem is reported. A device that
/// merely restarts causes fewer steps.
const MIN_CLOCK_STEPS: u64 = 5;

/// Check of the measured rate.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) enum RateCheck {
    /// Measurements may arrive at any rate.
    #[default]
    None,
    /// Declared rate, Hz.
    Declared(f64),
    /// No rate is declared. The buffers are sized for the given rate, Hz.
    AtMost(f64),
}

/// Reports of one device from the last [`WINDOW_S`] seconds.
#[derive(Debug, Default)]
pub(crate) struct DeviceMonitor {
    /// Prefix of the problem kinds, to distinguish two devices.
    kind_prefix: &'static str,
    rate: RateCheck,
    reports: VecDeque<(DeviceReport, u64)>,
    silent_s: usize,
}

impl DeviceMonitor {
    pub(crate) fn new(kind_prefix: &'static str, rate: RateCheck) -> Self {
        Self { kind_prefix, rate, ..Self::default() }
    }

    /// Records the report of one second and returns the current problems.
    ///
    /// `clock_steps` is the total number of steps of the device's clock.
    pub(crate) fn update(&mut self, report: DeviceReport, clock_steps: u64) -> Vec<Diagnostic> {
        let previous_bytes = self.reports.back().map_or(0, |(last, _)| last.bytes);
        let is_silent = report.failure.is_none() && report.bytes == previous_bytes;
        self.silent_s = if is_silent { self.silent_s + 1 } else { 0 };
        self.reports.push_back((report, clock_steps));
        if self.reports.len() > WINDOW_S + 1 {
            self.reports.pop_front();
        }
        let (Some((first, first_steps)), Some((last, _))) = (self.reports.front(), self.reports.back()) else {
            return Vec::new();
        };
        let mut diagnostics = Vec::new();
        let mut add = |kind: &str, found: String, remedy: String| {
            let kind = format!("{}{kind}", self.kind_prefix);
            diagnostics.push(Diagnostic { kind: kind.into(), found: found.into(), remedy: remedy.into() });
        };
        let DeviceReport { port, format, .. } = last;
        if let Some(failure) = &last.failure {
            add(
                UNAVAILABLE,
                format!("cannot read {port}: {}", failure.cause),
                format!("{}; it is retried automatically", failure.remedy),
            );
        } else if self.silent_s >= SILENCE_S && *port != "standard input" {
            add(
                SILENT,
                format!("{port} is open but sends no data"),
                "check the device's power, wiring and settings".into(),
            );
        }
        let counts = last.counts;
        if counts.ambiguous_dates > 0 && last.measurements == 0 {
            add(
                DATE,
                format!(
                    "{port}: the first number of the date is the month or the day in {} lines, which are rejected",
                    counts.ambiguous_dates
                ),
                DATE_REMEDY.into(),
            );
            return diagnostics;
        }
        if counts.frames == 0 && last.bytes >= FORMAT_BYTES {
            add(
                FORMAT,
                format!("{port}: received {} bytes but no {format} message", last.bytes),
                "check that format and baud match the device".into(),
            );
            return diagnostics;
        }
        let recent = self.reports.len().saturating_sub(SILENCE_S + 1);
        let recent = self.reports.get(recent).map_or(first, |(report, _)| report);
        let foreign = counts.foreign - recent.counts.foreign;
        if foreign > 0 && last.measurements == recent.measurements {
            add(
                FOREIGN_SYSTEM,
                format!(
                    "{port}: no measurement of the selected system for {SILENCE_S} s, but {foreign} {format} messages of other systems or components, {} in total",
                    counts.foreign
                ),
                "set system to the number of the autopilot, or to 0 for the first that sends".into(),
            );
        } else if last.measurements == 0 && counts.frames >= MIN_MESSAGES {
            add(
                NO_MEASUREMENT,
                format!("{port}: received {} {format} messages, but none with a required measurement", counts.frames),
                remedy_without_measurement(format).into(),
            );
        }
        let frames = counts.frames - first.counts.frames;
        let rejected = counts.rejected - first.counts.rejected;
        let skipped = counts.skipped_bytes - first.counts.skipped_bytes;
        let bytes = last.bytes - first.bytes;
        // Streams in these formats normally contain other messages as well, which count as skipped.
        let is_shared = matches!(*format, "mavlink" | "ubx" | "nmea");
        if rejected as f64 > MAX_REJECTED_SHARE * frames as f64 + 1.0
            || (!is_shared && skipped as f64 > MAX_SKIPPED_SHARE * bytes as f64 + 100.0)
        {
            add(
                CORRUPTED,
                format!(
                    "{port}: in {WINDOW_S} s {skipped} of {bytes} bytes belonged to no message, and {rejected} messages were rejected, {frames} accepted"
                ),
                "check cable, ground, baud, and whether a second device sends on the same line".into(),
            );
        }
        if last.foreign_datagrams > first.foreign_datagrams {
            add(
                SECOND_SENDER,
                format!("{port}: ignored {} datagrams from another sender", last.foreign_datagrams),
                "send them to another port; only the first sender is read".into(),
            );
        }
        let dropped = last.dropped_datagrams - first.dropped_datagrams;
        if dropped > 0 {
            add(
                DROPPED,
                format!(
                    "{port}: in {WINDOW_S} s {dropped} datagrams were lost because the socket's buffer was full, {} in total",
                    last.dropped_datagrams
                ),
                "reduce the rate of the senders, and let only the sensor send to the port".into(),
            );
        }
        let seconds = self.reports.len() as f64 - 1.0;
        let rate_hz = (last.measurements - first.measurements) as f64 / seconds;
        let expectation = match self.rate {
            RateCheck::Declared(declared_hz)
                if rate_hz > MAX_RATE_RATIO * declared_hz || self.is_slower_than(declared_hz / MAX_RATE_RATIO) =>
            {
                Some(format!("rate_hz declares {declared_hz:.0}"))
            }
            RateCheck::AtMost(nominal_hz) if rate_hz > MAX_RATE_RATIO * nominal_hz => {
                Some(format!("the buffers are made for {nominal_hz:.0}"))
            }
            RateCheck::None | RateCheck::Declared(_) | RateCheck::AtMost(_) => None,
        };
        if let Some(expectation) = expectation.filter(|_| seconds >= SILENCE_S as f64) {
            let measured_hz = self.recent_rates_hz().sum::<f64>() / SILENCE_S as f64;
            add(
                RATE,
                format!("{port}: {measured_hz:.0} measurements/s arrive, {expectation}"),
                format!(
                    "set rate_hz = {measured_hz:.0}: buffers follow from it, and measurements without room are lost"
                ),
            );
        }
        if clock_steps.saturating_sub(*first_steps) >= MIN_CLOCK_STEPS {
            add(
                CLOCK,
                format!(
                    "{port}: the device's clock jumped, stepped back or stood still {} times in {WINDOW_S} s",
                    clock_steps - first_steps
                ),
                "check whether a second sensor sends on the same line, and check clock, units and time_bits".into(),
            );
        }
        diagnostics
    }

    /// Returns the number of measurements in each of the last [`SILENCE_S`] seconds.
    fn recent_rates_hz(&self) -> impl Iterator<Item = f64> {
        let first = self.reports.len().saturating_sub(SILENCE_S + 1);
        let totals = self.reports.iter().skip(first).map(|(report, _)| report.measurements);
        let after = self.reports.iter().skip(first + 1).map(|(report, _)| report.measurements);
        totals.zip(after).map(|(before, after)| (after - before) as f64)
    }

    /// Returns `true` if measurements arrived in each of the last [`SILENCE_S`] seconds, but fewer
    /// than `min_hz`.
    ///
    /// A device that starts, ends or pauses does not count as slower, because one of these seconds
    /// is without measurements or at the full rate.
    fn is_slower_than(&self, min_hz: f64) -> bool {
        self.reports.len() > SILENCE_S && self.recent_rates_hz().all(|rate_hz| rate_hz > 0.0 && rate_hz < min_hz)
    }
}

/// Remedy for dates of unknown order. Expressions of `sed` are between backquotes.
const DATE_REMEDY: &str = "write the year first: pipe the lines through `sed -u -E 's|([0-9]+)/([0-9]+)/([0-9]{4})|\\3-\\1-\\2|'` to --source stdin if months come first, with \\3-\\2-\\1 if days do; or leave t out of map, then arrival gives the time";

/// Returns the remedy for a device that sends valid messages without a measurement.
fn remedy_without_measurement(format: &str) -> &'static str {
    match format {
        "mavlink" => {
            "make the autopilot stream HIGHRES_IMU, or select another message with imu; on PX4: mavlink stream -u 14540 -s HIGHRES_IMU -r 200"
        }
        "witmotion" => "enable acceleration (0x51) and rate (0x52) in the device",
        "xsens" => "enable rate of turn and acceleration in the device's output configuration",
        "ubx" => "enable UBX-NAV-PVT in the receiver and give it a view of the sky",
        "nmea" => "enable RMC or VTG in the receiver and give it a view of the sky",
        _ => "send rate and force",
    }
}

#[cfg(test)]
mod tests {
    use decoders::Counts;

    use super::*;
    use crate::reconnecting_port::DeviceFailure;

    /// Returns the kinds of the problems that are present after `seconds` reports, one per second.
    fn kinds_after(seconds: u64, report_at: impl Fn(u64) -> (DeviceReport, u64)) -> Vec<String> {
        let mut monitor = DeviceMonitor::new("", RateCheck::Declared(100.0));
        let mut diagnostics = Vec::new();
        for second in 1..=seconds {
            let (report, steps) = report_at(second);
            diagnostics = monitor.update(DeviceReport { port: "/dev/ttyUSB0".into(), ..report }, steps);
        }
        diagnostics.into_iter().map(|diagnostic| diagnostic.kind.to_string()).collect()
    }

    fn good(second: u64) -> DeviceReport {
        let counts = Counts { frames: 100 * second, ..Counts::default() };
        DeviceReport {
            format: "witmotion",
            bytes: 3300 * second,
            counts,
            measurements: 100 * second,
            ..DeviceReport::default()
        }
    }

    #[test]
    fn healthy_device_has_no_diagnostics() {
        assert_eq!(kinds_after(30, |second| (good(second), 0)), [""; 0]);
        // A partial frame at the start and a restart of the device are not reported.
        let restarted = |second| DeviceReport {
            counts: Counts { skipped_bytes: 40, rejected: 1, ..good(second).counts },
            ..good(second)
        };
        assert_eq!(kinds_after(5, |second| (restarted(second), 1)), [""; 0]);
    }

    #[test]
    fn each_problem_has_its_kind() {
        let unavailable = DeviceFailure { cause: "no such file".into(), remedy: "plug it in" };
        type Each<'a> = &'a dyn Fn(u64) -> (DeviceReport, u64);
        let cases: [(&str, Each<'_>); 11] = [
            (UNAVAILABLE, &|_| (DeviceReport { failure: Some(unavailable.clone()), ..DeviceReport::default() }, 0)),
            (SILENT, &|_| (good(1), 0)),
            (FORMAT, &|second| (DeviceReport { bytes: 3300 * second, ..DeviceReport::default() }, 0)),
            (DATE, &|second| {
                let counts = Counts { rejected: 1, ambiguous_dates: 1, ..good(second).counts };
                (DeviceReport { counts, measurements: 0, ..good(second) }, 0)
            }),
            (NO_MEASUREMENT, &|second| (DeviceReport { measurements: 0, ..good(second) }, 0)),
            (CORRUPTED, &|second| {
                (DeviceReport { counts: Counts { rejected: 5 * second, ..good(second).counts }, ..good(second) }, 0)
            }),
            (SECOND_SENDER, &|second| (DeviceReport { foreign_datagrams: second, ..good(second) }, 0)),
            (FOREIGN_SYSTEM, &|second| {
                let counts = Counts { foreign: 50 * second, ..good(second).counts };
                (DeviceReport { counts, measurements: 0, ..good(second) }, 0)
            }),
            (DROPPED, &|second| (DeviceReport { dropped_datagrams: second, ..good(second) }, 0)),
            (RATE, &|second| (DeviceReport { measurements: 10_000 * second, ..good(second) }, 0)),
            (CLOCK, &|second| (good(second), 50 * second)),
        ];
        for (kind, each) in cases {
            assert_eq!(kinds_after(8, each), [kind]);
        }
    }

    #[test]
    fn wrong_declared_rate_is_reported_with_the_measured_one() {
        let at = |rate_hz: u64| move |second: u64| (DeviceReport { measurements: rate_hz * second, ..good(second) }, 0);
        for (rate_hz, expected) in [(160, vec![RATE]), (140, vec![]), (70, vec![]), (60, vec![RATE]), (1, vec![RATE])] {
            assert_eq!(kinds_after(8, at(rate_hz)), expected, "{rate_hz} Hz, declared 100");
        }
        let paused =
            |second: u64| (DeviceReport { measurements: 100 * (second - u64::from(second > 5)), ..good(second) }, 0);
        assert_eq!(kinds_after(7, paused), [""; 0], "a pause of 1 s");
    }

    #[test]
    fn undeclared_rate_is_reported_only_above_the_buffers() {
        for (rate_hz, expected) in [(10, 0), (1400, 0), (1600, 1)] {
            let mut monitor = DeviceMonitor::new("", RateCheck::AtMost(1000.0));
            let report = |second: u64| DeviceReport { measurements: rate_hz * second, ..good(second) };
            let last = (1..=8).map(|second| monitor.update(report(second), 0)).last().unwrap();
            assert_eq!(last.len(), expected, "{rate_hz} Hz: {last:?}");
            assert!(last.iter().all(|problem| problem.found.raw().contains("made for 1000")), "{last:?}");
        }
    }

    #[test]
    fn foreign_systems_matter_only_without_measurements() {
        let shared = |second: u64| DeviceReport {
            counts: Counts { foreign: 50 * second, ..good(second).counts },
            measurements: 100 * second.min(10),
            ..good(second)
        };
        assert_eq!(kinds_after(10, |second| (shared(second), 0)), [""; 0]);
        assert_eq!(kinds_after(13, |second| (shared(second), 0)), [FOREIGN_SYSTEM], "3 s after the last one");
    }

    #[test]
    fn resolved_problem_disappears() {
        let noise = |second: u64| Counts { skipped_bytes: 1000 * second.min(5), ..good(second).counts };
        assert_eq!(kinds_after(5, |second| (DeviceReport { counts: noise(second), ..good(second) }, 0)), [CORRUPTED]);
        assert_eq!(kinds_after(20, |second| (DeviceReport { counts: noise(second), ..good(second) }, 0)), [""; 0]);
    }
}
