//! `plumb record`: records a running system to a file.

use std::{path::PathBuf, thread, time::Duration};

use clap::Args;
use flight::{FlightError, RecordingSummary};
use graph::Topic;
use mapping::names::UnknownName;
use observe::system_recording::{SystemRecording, SystemRecordingError};

use crate::{
    duration::duration,
    failure::{Failure, Outcome, fail_after_result},
    stdout::print_result,
    system::LocalSystemArgs,
    topics::{POLL_INTERVAL, StopCondition},
};

/// Arguments of `plumb record`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb record -o flight.mcap         # until Ctrl-C or the end of the system
  plumb record -o part.mcap --topics imu,attitude --for 10s
  plumb record -o alpha.mcap --system alpha --json

Exit codes: 0 complete, 1 messages missed or recording cut short, 2 wrong usage.")]
pub(crate) struct Record {
    #[command(flatten)]
    system: LocalSystemArgs,
    /// MCAP file to create; it must not exist
    #[arg(short, long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Topics separated by commas, see `plumb topic list` [default: all]
    #[arg(long, value_name = "TOPICS", value_delimiter = ',', value_parser = parse_topic)]
    topics: Vec<Topic>,
    /// Recording time, such as 500ms, 10s, 2m or 1h [default: until Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
}

/// Returns the exit code for an error of the recording.
fn exit_code(error: &SystemRecordingError) -> u8 {
    if matches!(error, SystemRecordingError::Flight(FlightError::Exists { .. })) { 2 } else { 1 }
}

pub(crate) fn run(record: &Record) -> Outcome {
    let recorded = record_until_stopped(&record.system.name()?, record);
    let summary = recorded.map_err(|error| Failure::new(&error, exit_code(&error)))?;
    let printed = print_result(&summary, record.system.json);
    Ok(summary.error.map_or(printed, |error| fail_after_result(&error, 1)))
}

/// Records until the time limit is reached, a signal arrives or the system ends.
fn record_until_stopped(
    name: &str,
    Record { out, topics, duration, .. }: &Record,
) -> Result<RecordingSummary, SystemRecordingError> {
    let topics = if topics.is_empty() { Topic::ALL } else { topics };
    let mut recording = SystemRecording::start(name, topics, out, env!("CARGO_PKG_VERSION"))?;
    let mut stop = StopCondition::new(|| true, *duration);
    let end_reason = loop {
        if stop.is_met() {
            break "stopped on request";
        }
        if let Some(reason) = recording.poll() {
            break reason;
        }
        thread::sleep(POLL_INTERVAL);
    };
    Ok(recording.finish(end_reason))
}

fn parse_topic(name: &str) -> Result<Topic, String> {
    let unknown = || UnknownName::new("topic", name, Topic::ALL.iter().map(|topic| topic.name()));
    Topic::from_name(name).ok_or_else(|| unknown().to_string())
}
