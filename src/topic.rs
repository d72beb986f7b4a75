//! `plumb topic`: what flows through a running system.

use std::{
    ops::ControlFlow,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use observe::{
    flow::{Flow, FlowReport},
    topics::{ELSEWHERE, Topic},
};

use crate::{
    fail,
    out::{print, show},
    seeing::{LOOK, SeeError, TakeMessage, Until, Viewpoint, Watched, duration, frame::Shown},
    system::System,
};

/// How long topics are watched for their rates.
const RATES_LIMIT: Duration = Duration::from_secs(1);
/// Between two lines of a rate.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Subcommand)]
pub(crate) enum TopicCommand {
    /// Print every topic with its type, how many are at it, what it holds for each reader, and its rate.
    List {
        #[command(flatten)]
        system: System,
        /// How long the rates are watched [default: 1].
        #[arg(long, value_parser = duration)]
        seconds: Option<Duration>,
    },
    /// Print a topic's layout with units and meanings, its fingerprint, and who is at it.
    Info(Watch),
    /// Print messages as they come, attitudes in the frame of `[output]`; with --json one object per line.
    Echo {
        #[command(flatten)]
        watch: Watch,
        /// Only each so-many-th message; the others do not count.
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
        every: u64,
    },
    /// Print the rate, the intervals with their jitter, and what was lost where.
    Hz(Watch),
    /// Print bytes per second.
    Bw(Watch),
}

/// Which topic, and for how long.
#[derive(Args)]
pub(crate) struct Watch {
    /// The topic, as `plumb topic list` names it.
    topic: String,
    #[command(flatten)]
    system: System,
    /// End after so many messages.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// End after so long [default: Ctrl-C ends it].
    #[arg(long, value_parser = duration)]
    seconds: Option<Duration>,
}

pub(crate) fn run(command: TopicCommand) -> ExitCode {
    let ran = match command {
        TopicCommand::List { system, seconds } => list(&system, seconds),
        TopicCommand::Info(watch) => info(&watch),
        TopicCommand::Echo { watch, every } => echo(&watch, every),
        TopicCommand::Hz(watch) => rate(&watch, FlowReport::hz),
        TopicCommand::Bw(watch) => rate(&watch, FlowReport::bw),
    };
    ran.unwrap_or_else(|error| fail(&error, error.exit_code()))
}

fn list(system: &System, seconds: Option<Duration>) -> Result<ExitCode, SeeError> {
    let place = Viewpoint::of(system, "topic list")?;
    let watched = place.watch_all()?;
    let topics = watch(watched, Until::new(|| place.is_running(), Some(seconds.unwrap_or(RATES_LIMIT))))?;
    if system.json() {
        return Ok(print(&serde_json::Value::from_iter(topics.iter().map(Topic::json))));
    }
    let mut lines: Vec<_> = [Topic::head()].into_iter().chain(topics.iter().map(Topic::line)).collect();
    if let Some((vehicle, _)) = system.remote() {
        lines.push(format!("what {vehicle} sends, as it arrives here; {ELSEWHERE}"));
    }
    Ok(print(&lines.join("\n")))
}

fn info(Watch { topic, system, seconds, .. }: &Watch) -> Result<ExitCode, SeeError> {
    let place = Viewpoint::of(system, "topic info")?;
    let watched = place.watch(topic)?;
    let until = Until::new(|| place.is_running(), Some(seconds.unwrap_or(RATES_LIMIT)));
    Ok(match watch(vec![watched], until)?.first() {
        Some(topic) if system.json() => print(&topic.info_json()),
        Some(topic) => print(topic),
        None => ExitCode::FAILURE,
    })
}

/// Lets topics flow for a while.
fn watch(mut watched: Vec<Watched>, mut until: Until) -> Result<Vec<Topic>, SeeError> {
    while !until.is_over() {
        std::thread::sleep(LOOK);
        watched.iter_mut().try_for_each(|topic| topic.look(&mut |_, _, _| true))?;
    }
    watched.into_iter().map(Watched::topic).collect()
}

fn echo(watch: &Watch, every: u64) -> Result<ExitCode, SeeError> {
    let frame = Shown::of(&watch.system);
    let (mut came, mut shown) = (0, ControlFlow::Continue(()));
    let messages = watch.count.map(|count| (count - 1).saturating_mul(every).saturating_add(1));
    let report = follow(
        watch,
        messages,
        "topic echo",
        &mut |layout, bytes, said| {
            came += 1;
            if (came - 1u64).is_multiple_of(every) {
                shown = match frame.record(layout, bytes, said) {
                    Ok(record) if watch.system.json() => show(&record.json()),
                    Ok(record) => show(&format_args!("{}:{record}", watch.topic)),
                    Err(error) => ControlFlow::Break(fail(&error, 1)),
                };
            }
            shown.is_continue()
        },
        &mut |_| true,
    )?;
    if let ControlFlow::Break(code) = shown {
        return Ok(code);
    }
    supervisor::announce(format_args!("{}: {report}", watch.topic));
    Ok(ExitCode::SUCCESS)
}

fn rate(watch: &Watch, line: impl Fn(&FlowReport) -> String) -> Result<ExitCode, SeeError> {
    let json = watch.system.json();
    let (mut told, mut shown) = (None, ControlFlow::Continue(()));
    let report = follow(watch, watch.count, "topic hz", &mut |_, _, _| true, &mut |flow| {
        if json || told.get_or_insert_with(Instant::now).elapsed() < LINE_INTERVAL {
            return true;
        }
        told = Some(Instant::now());
        shown = show(&line(&flow.report()));
        shown.is_continue()
    })?;
    if let ControlFlow::Break(code) = shown {
        return Ok(code);
    }
    // Numbers and strings always serialise.
    Ok(if json { print(&serde_json::to_string(&report).unwrap_or_default()) } else { print(&line(&report)) })
}

/// Follows a topic for so many messages, as long as both callers want more; what there is to be said about its flow then. `round` is
/// shown the flow before each look, so not that of the end.
fn follow(
    Watch { topic, system, seconds, .. }: &Watch,
    messages: Option<u64>,
    who: &str,
    take: &mut TakeMessage<'_>,
    round: &mut dyn FnMut(&Flow) -> bool,
) -> Result<FlowReport, SeeError> {
    let place = Viewpoint::of(system, who)?;
    let mut watched = place.watch(topic)?;
    let mut until = Until::new(|| place.is_running(), *seconds);
    let (mut left, mut wanted) = (messages.unwrap_or(u64::MAX), true);
    while wanted && left > 0 && !until.is_over() && round(&watched.flow) {
        std::thread::sleep(LOOK);
        watched.look(&mut |layout, bytes, said| {
            left -= 1;
            wanted = take(layout, bytes, said);
            wanted && left > 0
        })?;
    }
    if until.system_ended() {
        supervisor::announce(place.ended(system));
    }
    Ok(watched.flow.report())
}
