//! Metadata at the start of a flight.

use std::{collections::BTreeMap, fs, path::PathBuf};

use launch::Output;
use runtime::ServiceConfig;
use time::OffsetDateTime;

/// Metadata at the start of a flight.
#[derive(Debug, Clone)]
pub struct FlightHeader {
    /// Version of Plumbline.
    pub version: &'static str,
    /// Name of the system.
    pub system: String,
    /// Host name.
    pub host: String,
    /// Path of the launch file, if known.
    pub launch_file: Option<PathBuf>,
    /// Text of the launch file, if known.
    pub launch: Option<String>,
    /// Configuration of the services including defaults, JSON.
    pub config: String,
    /// Tick rate in source time, Hz.
    pub rate_hz: f64,
    /// Frame of the attitude output. The recorded topics remain in the native frame.
    pub output: Output,
}

impl FlightHeader {
    /// Creates the header for a system with this configuration.
    pub fn new(version: &'static str, config: &ServiceConfig) -> Self {
        Self {
            version,
            system: config.launch.name.clone(),
            host: fs::read_to_string("/proc/sys/kernel/hostname").map_or("unknown".into(), |host| host.trim().into()),
            launch_file: None,
            launch: None,
            // The configuration can always be serialised: it has only named maps, lists, numbers
            // and strings.
            config: serde_json::to_string_pretty(config).unwrap_or_default(),
            rate_hz: config.rate_hz,
            output: config.launch.output,
        }
    }

    pub(crate) fn metadata(&self, offset_ns: i64) -> BTreeMap<String, String> {
        let Self { version, system, host, launch_file, rate_hz, output, .. } = self;
        let entries = [
            ("version", Some((*version).to_owned())),
            ("system", Some(system.clone())),
            ("host", Some(host.clone())),
            ("launch_file", launch_file.as_ref().map(|path| path.to_string_lossy().into_owned())),
            ("start_utc", Some(utc((now_ns(offset_ns) / 1_000_000_000).cast_signed(), ["-", "T", ":"]))),
            ("rate_hz", Some(rate_hz.to_string())),
            ("realtime_minus_monotonic_ns", Some(offset_ns.to_string())),
            ("world", Some("east, north, up if the course is true, otherwise rotated about the vertical".to_owned())),
            ("body", Some("forward, left, up".to_owned())),
            ("topics_frame", Some(Output::default().frame.name().to_owned())),
            ("output_frame", Some(output.frame.name().to_owned())),
            ("output_quaternion", Some(output.quaternion.name().to_owned())),
        ];
        entries.into_iter().filter_map(|(name, entry)| Some((name.to_owned(), entry?))).collect()
    }
}

/// Returns the current time on CLOCK_REALTIME in ns, computed with the clock offset of the
/// recording.
pub(crate) fn now_ns(offset_ns: i64) -> u64 {
    runtime::clock::monotonic_ns().saturating_add_signed(offset_ns)
}

/// Formats a Unix time in seconds. The separators are used within the date, between date and time,
/// and within the time.
pub(crate) fn utc(unix_s: i64, [date, middle, clock]: [&str; 3]) -> String {
    let time = OffsetDateTime::from_unix_timestamp(unix_s).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    let (year, month, day) = (time.year(), u8::from(time.month()), time.day());
    let (hour, minute, second) = (time.hour(), time.minute(), time.second());
    format!("{year:04}{date}{month:02}{date}{day:02}{middle}{hour:02}{clock}{minute:02}{clock}{second:02}Z")
}
