//! `plumb topic`: lists, inspects and echoes topics of a running system or remote vehicle.

use std::{
    ops::ControlFlow,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use observe::{
    flow::{FlowMonitor, FlowReport},
    topics::{ONBOARD_ONLY_NOTE, TopicInfo},
};

use crate::{
    duration::duration,
    failure::{Failure, Outcome},
    notice::notice,
    stdout::{print, print_item},
    system::SystemArgs,
    topics::{OnMessage, POLL_INTERVAL, StopCondition, TopicSource, TopicView, frame::DisplayFrame},
};

/// Default time over which rates are measured.
const DEFAULT_RATE_PERIOD: Duration = Duration::from_secs(1);
/// Interval between two printed rates.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Subcommand)]
pub(crate) enum TopicCommand {
    /// List topics with type, publishers, subscribers, buffer and rate
    #[command(after_help = "\
Examples:
  plumb topic list
  plumb topic list --for 5s --json
  plumb topic list --remote alpha --connect quic/base:7447 --keys keys/wall")]
    List {
        #[command(flatten)]
        system: SystemArgs,
        /// Time over which rates are measured, such as 500ms [default: 1s]
        #[arg(long = "for", value_name = "TIME", value_parser = duration)]
        duration: Option<Duration>,
    },
    /// Show a topic's fields, units, fingerprint and ports
    #[command(after_help = "\
Examples:
  plumb topic info fused
  plumb topic info attitude --json")]
    Info(TopicArgs),
    /// Print the messages of a topic as they arrive
    #[command(after_help = "\
Examples:
  plumb topic echo attitude --every 100       # in the frame of [output]
  plumb topic echo event
  plumb topic echo imu --count 1 --json       # one JSON object per line")]
    Echo {
        #[command(flatten)]
        args: TopicArgs,
        /// Print every Nth message; --count counts printed ones only
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
        every: u64,
    },
    /// Measure rate, intervals, jitter and losses of a topic
    #[command(after_help = "\
Examples:
  plumb topic hz imu --for 10s
  plumb topic hz attitude --remote alpha --connect quic/base:7447")]
    Hz(TopicArgs),
    /// Measure the bandwidth of a topic in bytes per second
    #[command(after_help = "\
Examples:
  plumb topic bw imu
  plumb topic bw attitude --for 10s --json")]
    Bw(TopicArgs),
}

/// Arguments that select a topic and the number and time of its messages.
#[derive(Args)]
pub(crate) struct TopicArgs {
    /// Topic name, see `plumb topic list`
    topic: String,
    #[command(flatten)]
    system: SystemArgs,
    /// Number of messages before stopping, at least 1 [default: unlimited]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Time before stopping [default: 1s for info, else until Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
}

pub(crate) fn run(command: TopicCommand) -> Outcome {
    match command {
        TopicCommand::List { system, duration } => list(&system, duration),
        TopicCommand::Info(args) => info(&args),
        TopicCommand::Echo { args, every } => echo(&args, every),
        TopicCommand::Hz(args) => print_rate(&args, FlowReport::rate_line),
        TopicCommand::Bw(args) => print_rate(&args, FlowReport::bandwidth_line),
    }
}

fn list(system: &SystemArgs, duration: Option<Duration>) -> Outcome {
    let source = TopicSource::open(system, "topic list")?;
    let views = source.open_all()?;
    let topics =
        observe(views, StopCondition::new(|| source.is_running(), Some(duration.unwrap_or(DEFAULT_RATE_PERIOD))))?;
    if system.json() {
        return Ok(print(&serde_json::json!({ "topics": topics.iter().map(TopicInfo::to_json).collect::<Vec<_>>() })));
    }
    let mut lines: Vec<_> =
        [TopicInfo::table_header()].into_iter().chain(topics.iter().map(TopicInfo::to_row)).collect();
    if let Some((vehicle, _)) = system.remote() {
        lines.push(format!("topics of {vehicle} as received here; {ONBOARD_ONLY_NOTE}"));
    }
    Ok(print(&lines.join("\n")))
}

fn info(TopicArgs { topic, system, duration, .. }: &TopicArgs) -> Outcome {
    let source = TopicSource::open(system, "topic info")?;
    let view = source.open_topic(topic)?;
    let stop = StopCondition::new(|| source.is_running(), Some(duration.unwrap_or(DEFAULT_RATE_PERIOD)));
    Ok(match observe(vec![view], stop)?.first() {
        Some(topic) if system.json() => print(&topic.to_json_with_layout()),
        Some(topic) => print(topic),
        None => ExitCode::FAILURE,
    })
}

/// Receives messages of the topics until the stop condition is met.
fn observe(mut views: Vec<TopicView>, mut stop: StopCondition) -> Result<Vec<TopicInfo>, Failure> {
    while !stop.is_met() {
        std::thread::sleep(POLL_INTERVAL);
        views.iter_mut().try_for_each(|topic| topic.poll(&mut |_, _, _| true))?;
    }
    views.into_iter().map(TopicView::into_topic).collect()
}

fn echo(args: &TopicArgs, every: u64) -> Outcome {
    let frame = DisplayFrame::from_system(&args.system)?;
    let (mut received, mut printed) = (0, ControlFlow::Continue(()));
    let messages = args.count.map(|count| (count - 1).saturating_mul(every).saturating_add(1));
    let report = follow_topic(
        args,
        messages,
        "topic echo",
        &mut |layout, bytes, reported| {
            received += 1;
            if (received - 1u64).is_multiple_of(every) {
                printed = match frame.record(layout, bytes, reported) {
                    Ok(record) if args.system.json() => print_item(&record.to_json()),
                    Ok(record) => print_item(&format_args!("{}:{record}", args.topic)),
                    Err(error) => ControlFlow::Break(Failure::new(error, 1).report()),
                };
            }
            printed.is_continue()
        },
        &mut |_| true,
    )?;
    if let ControlFlow::Break(code) = printed {
        return Ok(code);
    }
    notice(format_args!("{}: {report}", args.topic));
    Ok(ExitCode::SUCCESS)
}

fn print_rate(args: &TopicArgs, line: impl Fn(&FlowReport) -> String) -> Outcome {
    let json = args.system.json();
    let (mut printed_at, mut printed) = (None, ControlFlow::Continue(()));
    let report = follow_topic(args, args.count, "topic hz", &mut |_, _, _| true, &mut |flow| {
        if json || printed_at.get_or_insert_with(Instant::now).elapsed() < LINE_INTERVAL {
            return true;
        }
        printed_at = Some(Instant::now());
        printed = print_item(&line(&flow.report()));
        printed.is_continue()
    })?;
    if let ControlFlow::Break(code) = printed {
        return Ok(code);
    }
    // Serialising numbers and strings cannot fail.
    Ok(if json { print(&serde_json::to_string(&report).unwrap_or_default()) } else { print(&line(&report)) })
}

/// Receives up to `messages` messages of a topic while both callbacks return `true`. Returns the
/// flow report.
///
/// `on_poll` is called with the flow before each poll, but not with the final flow.
fn follow_topic(
    TopicArgs { topic, system, duration, .. }: &TopicArgs,
    messages: Option<u64>,
    observer_name: &str,
    on_message: &mut OnMessage<'_>,
    on_poll: &mut dyn FnMut(&FlowMonitor) -> bool,
) -> Result<FlowReport, Failure> {
    let source = TopicSource::open(system, observer_name)?;
    let mut view = source.open_topic(topic)?;
    let mut stop = StopCondition::new(|| source.is_running(), *duration);
    let (mut left, mut wanted) = (messages.unwrap_or(u64::MAX), true);
    while wanted && left > 0 && !stop.is_met() && on_poll(&view.flow) {
        std::thread::sleep(POLL_INTERVAL);
        view.poll(&mut |layout, bytes, reported| {
            left -= 1;
            wanted = on_message(layout, bytes, reported);
            wanted && left > 0
        })?;
    }
    if stop.system_ended() {
        notice(source.end_message());
    }
    Ok(view.flow.report())
}
