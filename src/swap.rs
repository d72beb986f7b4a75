//! `plumb swap`, `plumb shadow` and `plumb ps`: requests to a running system.

use std::{
    ops::ControlFlow,
    process::ExitCode,
    time::{Duration, Instant},
};

use bus::BusError;
use clap::Args;
use control::{ControlError, ControlRequest, ServiceStatus, SwapReport, SwapRequest, send_request};
use graph::Topic;
use launch::{Service, Slot, StageConfig};
use mapping::names::UnknownName;
use messages::Difference;
use serde::Serialize;
use supervisor::LastRun;

use crate::{
    duration::duration,
    failure::{Failure, OrFail as _, Outcome},
    remote,
    stdout::{print, print_item},
    system::SystemArgs,
    topics::{LateTopic, StopCondition, observer},
};

/// Interval between two printed differences of a shadow.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);
/// Timeout for the system to confirm that a shadow was cancelled.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(5);

/// Arguments of `plumb swap`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb swap fuser vqf
  plumb swap fuser madgwick-improved --set beta_1_s=0.5
  plumb swap fuser vqf --remote alpha --connect quic/base:7447 --keys keys/ann

Exit codes: 0 committed, 1 rejected or aborted (the old stage stays), 2 wrong
usage.")]
pub(crate) struct Swap {
    /// Slot: gyro, accel, fuser or course
    slot: String,
    /// Stage for the slot, see `plumb stage list`
    stage: String,
    /// Parameter of the stage, repeatable [default: see `plumb stage list`]
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = parse_setting)]
    set: Vec<(String, f64)>,
    #[command(flatten)]
    system: SystemArgs,
}

/// Arguments of `plumb shadow`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb shadow fuser aided        # until Ctrl-C or plumb swap fuser aided
  plumb shadow fuser wz-closed --set time_constant_s=2 --for 1m --json")]
pub(crate) struct Shadow {
    #[command(flatten)]
    swap: Swap,
    /// Duration [default: until Ctrl-C or a swap to the same stage]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
}

/// Swaps the stage of a slot.
pub(crate) fn swap(swap: Swap) -> Outcome {
    let request = swap.request(false);
    let report = match swap.system.remote() {
        Some((vehicle, endpoint)) => remote::swap(&endpoint.open()?, &endpoint, vehicle, &swap.slot, request.stage)?,
        None => send_request(&swap.system.name()?, &ControlRequest::Swap(request))?,
    };
    Ok(print_report(&report, swap.system.json()))
}

/// Runs a stage in shadow and prints its difference from the active stage.
pub(crate) fn shadow(shadow: Shadow) -> Outcome {
    let Shadow { swap, duration } = shadow;
    if swap.system.remote().is_some() {
        return Err(Failure::new(
            "--remote is not supported for a shadow; run `plumb shadow` on the vehicle, or use `plumb swap --remote`",
            2,
        ));
    }
    let json = swap.system.json();
    let name = swap.system.name()?;
    let unknown = || UnknownName::new("slot", &swap.slot, Slot::ALL.map(Slot::name));
    let service = Service::from_name(&swap.slot).ok_or_else(unknown)?;
    let mut stop = StopCondition::new(|| true, duration);
    let request = ControlRequest::Swap(swap.request(true));
    let reply = std::thread::spawn({
        let name = name.clone();
        move || send_request::<SwapReport>(&name, &request)
    });
    let printed = print_differences(&name, service, json, &mut || stop.is_met() || reply.is_finished())?;
    let finished_by_itself = reply.is_finished();
    if !finished_by_itself {
        send_request::<()>(&name, &ControlRequest::Cancel { slot: service.name().into() })?;
    }
    let requested_at = Instant::now();
    while !reply.is_finished() {
        if requested_at.elapsed() > CANCEL_TIMEOUT {
            let message = "the system has not confirmed the end of the shadow; check it with `plumb doctor`";
            return Err(Failure::new(message, 1));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let panicked = |_| Failure::new("the request to the system failed: its thread panicked", 1);
    let report = reply.join().map_err(panicked)??;
    Ok(match finished_by_itself {
        true => print_report(&report, json),
        false => printed.break_value().unwrap_or(ExitCode::SUCCESS),
    })
}

/// Returns the text of an error. If the system is not running because its last run failed or was
/// killed, the text includes how it ended.
fn with_last_run(error: &ControlError) -> String {
    let name = if let ControlError::NotRunning { name, .. } = error { Some(name) } else { None };
    match name.and_then(|name| LastRun::read(name)) {
        Some(run) => format!("{error}; {run}"),
        None => error.to_string(),
    }
}

/// Status of each service, for `--json`.
#[derive(Serialize)]
struct Services {
    services: Vec<ServiceStatus>,
}

/// Prints the status of each service.
pub(crate) fn ps(system: SystemArgs) -> Outcome {
    let services = match system.remote() {
        Some((vehicle, endpoint)) => remote::services(&endpoint.open()?, vehicle)?,
        None => {
            let statuses = send_request::<Vec<ServiceStatus>>(&system.name()?, &ControlRequest::Status);
            statuses.map_err(|error| with_last_run(&error)).or_fail(1)?
        }
    };
    if system.json() {
        return Ok(print(&serde_json::to_string(&Services { services }).unwrap_or_default()));
    }
    let line = |one: &ServiceStatus| {
        let ServiceStatus { service, stage, state, pid, restarts, epoch, ticks, lost, address, .. } = one;
        let pid = pid.map_or("-".into(), |pid| pid.to_string());
        // Only services without a stage have an address, so both are printed in the same column.
        let address = address.as_ref().map(ToString::to_string);
        let stage = stage.as_ref().map(ToString::to_string).or(address).unwrap_or_else(|| "-".into());
        format!("{service:<8}{stage:<22} {state:<10}{pid:>8}{restarts:>9}{epoch:>6}{ticks:>10}{lost:>6}")
    };
    let head = format!(
        "{:<8}{:<22} {:<10}{:>8}{:>9}{:>6}{:>10}{:>6}",
        "service", "stage or address", "state", "pid", "restarts", "epoch", "ticks", "lost"
    );
    Ok(print(&[vec![head], services.iter().map(line).collect()].concat().join("\n")))
}

/// Prints the differences of the slot's candidate until `stop` returns `true` or the output is
/// closed.
fn print_differences(
    name: &str,
    service: Service,
    json: bool,
    stop: &mut dyn FnMut() -> bool,
) -> Result<ControlFlow<ExitCode>, BusError> {
    let observer = observer(name, "shadow")?;
    // The topic does not exist until the first candidate starts.
    let (mut differences, mut outcome) = (LateTopic::new(Topic::Difference), ControlFlow::Continue(()));
    let mut shown_at = Instant::now();
    while outcome.is_continue() && !stop() {
        std::thread::sleep(Duration::from_millis(20));
        let mut newest = None;
        if let Some(tap) = differences.tap(&observer)? {
            tap.drain(&mut |bytes| {
                let difference = bytemuck::try_pod_read_unaligned(bytes).ok();
                newest = difference.filter(|it: &Difference| it.service == service as u32).or(newest);
            })?;
        }
        if let Some(difference) = newest.filter(|_| shown_at.elapsed() > SHOW_INTERVAL) {
            shown_at = Instant::now();
            outcome = print_item(&difference_line(&difference, json));
        }
    }
    Ok(outcome)
}

fn difference_line(difference: &Difference, json: bool) -> String {
    let deg = |rad: [f64; 3]| rad.map(f64::to_degrees);
    let Difference { tick, ticks, now_rad, mean_rad, rms_rad, max_rad, .. } = *difference;
    let [now, mean, rms, max] = [now_rad, mean_rad, rms_rad, max_rad].map(deg);
    if json {
        let of = |[angle, inclination, heading]: [f64; 3]| serde_json::json!({ "angle": angle, "inclination": inclination, "heading": heading });
        return serde_json::json!({
            "tick": tick, "ticks": ticks,
            "now_deg": of(now), "mean_deg": of(mean), "rms_deg": of(rms), "max_deg": of(max),
        })
        .to_string();
    }
    format!(
        "tick {tick}: angle {:.3}° now, {:.3}° mean, {:.3}° RMS, {:.3}° max; inclination {:.3}° RMS, heading {:.3}° RMS",
        now[0], mean[0], rms[0], max[0], rms[1], rms[2]
    )
}

fn print_report(report: &SwapReport, json: bool) -> ExitCode {
    let committed = report.outcome == control::SwapOutcome::Committed;
    let printed = if json {
        print(&serde_json::to_string(report).unwrap_or_default())
    } else if committed {
        print(report)
    } else {
        supervisor::announce(format_args!("{report}"));
        ExitCode::SUCCESS
    };
    if committed { printed } else { ExitCode::FAILURE }
}

impl Swap {
    fn request(&self, shadow: bool) -> SwapRequest {
        let stage = StageConfig { stage: self.stage.clone(), set: self.set.iter().cloned().collect() };
        let timeout_ms = (!shadow).then_some(SwapRequest::DEFAULT_TIMEOUT_MS);
        SwapRequest { slot: self.slot.clone(), stage, shadow, expected_epoch: None, timeout_ms }
    }
}

fn parse_setting(text: &str) -> Result<(String, f64), String> {
    let split = text.split_once('=');
    let read = split.and_then(|(key, value)| Some((key.trim().to_owned(), value.trim().parse::<f64>().ok()?)));
    read.filter(|(_, value)| value.is_finite())
        .ok_or_else(|| "expected KEY=VALUE with a finite number, as in beta_1_s=0.5".into())
}
