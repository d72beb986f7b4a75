//! `plumb swap`, `plumb shadow`, `plumb ps`: what a running system is asked.

use std::{
    ops::ControlFlow,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{BusError, Tap};
use clap::Args;
use control::{ControlRequest, ServiceStatus, SwapReport, SwapRequest, send_request};
use graph::Topic;
use launch::{Service, StageConfig};
use messages::Difference;

use crate::{
    fail,
    out::{self, print},
    remote,
    seeing::observer,
    system::System,
};

/// How often the difference of a shadow is shown.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);
/// How long a shadow takes at most to end once that was asked for.
const END_LIMIT: Duration = Duration::from_secs(5);

/// What is to fill a slot.
#[derive(Args)]
pub(crate) struct Swap {
    /// The slot: gyro, accel, fuser or course.
    slot: String,
    /// The stage, as `plumb stage list` names it.
    stage: String,
    /// A parameter of the stage; may be given several times.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = setting)]
    set: Vec<(String, f64)>,
    #[command(flatten)]
    system: System,
}

/// `plumb shadow`.
#[derive(Args)]
pub(crate) struct Shadow {
    #[command(flatten)]
    swap: Swap,
    /// How long [default: until Ctrl-C, or until a swap to the same stage].
    #[arg(long = "for", value_name = "SECONDS")]
    duration_s: Option<f64>,
}

/// Swaps what fills a slot.
pub(crate) fn swap(swap: Swap) -> ExitCode {
    let json = swap.system.json();
    if let Some((vehicle, way)) = swap.system.remote() {
        return match remote::swap(vehicle, way, &swap.slot, swap.wish(false).stage) {
            Ok(report) => show(&report, json),
            Err(error) => fail(&error, error.exit_code()),
        };
    }
    match send_request::<SwapReport>(&swap.system.name(), &ControlRequest::Swap(swap.wish(false))) {
        Ok(report) => show(&report, json),
        Err(error) => fail(&error, 1),
    }
}

/// Runs a stage beside the one that fills a slot and tells how far they are apart.
pub(crate) fn shadow(shadow: Shadow) -> ExitCode {
    let Shadow { swap, duration_s } = shadow;
    if swap.system.remote().is_some() {
        return fail(
            &"a shadow is asked for on board: leave --remote out; `plumb swap --remote` swaps from elsewhere",
            2,
        );
    }
    let (name, json) = (swap.system.name(), swap.system.json());
    let Some(service) = Service::from_name(&swap.slot) else {
        return fail(&format_args!("there is no slot `{}`; there are gyro, accel, fuser and course", swap.slot), 2);
    };
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        if let Err(cause) = signal_hook::flag::register(signal, ends.clone()) {
            return fail(&format_args!("catching signals: {cause}"), 1);
        }
    }
    let question = ControlRequest::Swap(swap.wish(true));
    let answer = std::thread::spawn({
        let name = name.clone();
        move || send_request::<SwapReport>(&name, &question)
    });
    let watched = watch(&name, service, json, &|since: Instant| {
        ends.load(Ordering::SeqCst)
            || answer.is_finished()
            || duration_s.is_some_and(|limit_s| since.elapsed().as_secs_f64() > limit_s)
    });
    let shown = match watched {
        Ok(shown) => shown,
        Err(error) => return fail(&error, 1),
    };
    let by_itself = answer.is_finished();
    if !by_itself && let Err(error) = send_request::<()>(&name, &ControlRequest::Cancel { slot: service.name().into() }) {
        return fail(&error, 1);
    }
    let asked = Instant::now();
    while !answer.is_finished() {
        if asked.elapsed() > END_LIMIT {
            return fail(
                &"ending the shadow: the system has not said that it ended; `plumb doctor` tells how it is",
                1,
            );
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    match answer.join() {
        Ok(Ok(report)) if by_itself => show(&report, json),
        Ok(Ok(_)) => shown.break_value().unwrap_or(ExitCode::SUCCESS),
        Ok(Err(error)) => fail(&error, 1),
        Err(_) => fail(&"asking the system: the question failed", 1),
    }
}

/// How the services of a running system are.
pub(crate) fn ps(system: System) -> ExitCode {
    let asked = match system.remote() {
        Some((vehicle, way)) => remote::ps(vehicle, way).map_err(|error| (error.to_string(), error.exit_code())),
        None => send_request::<Vec<ServiceStatus>>(&system.name(), &ControlRequest::Status).map_err(|error| (error.to_string(), 1)),
    };
    match asked {
        Ok(services) if system.json() => print(&serde_json::to_string(&services).unwrap_or_default()),
        Ok(services) => {
            let line = |one: &ServiceStatus| {
                let ServiceStatus { service, stage, state, pid, restarts, epoch, ticks, lost, address: at, .. } = one;
                let pid = pid.map_or("-".into(), |pid| pid.to_string());
                let at = at.as_ref().map_or(String::new(), |at| format!("  {at}"));
                let stage = stage.as_deref().unwrap_or("-");
                format!("{service:<8}{stage:<24}{state:<10}{pid:>8}{restarts:>9}{epoch:>6}{ticks:>12}{lost:>6}{at}")
            };
            let head = format!(
                "{:<8}{:<24}{:<10}{:>8}{:>9}{:>6}{:>12}{:>6}",
                "service", "stage", "state", "pid", "restarts", "epoch", "ticks", "lost"
            );
            print(&[vec![head], services.iter().map(line).collect()].concat().join("\n"))
        }
        Err((error, code)) => fail(&error, code),
    }
}

/// Shows the difference of the slot's candidate until `ends`, or nobody reads on.
fn watch(
    name: &str,
    service: Service,
    json: bool,
    ends: &dyn Fn(Instant) -> bool,
) -> Result<ControlFlow<ExitCode>, BusError> {
    let observer = observer(name, "shadow")?;
    let (mut differences, mut shown) = (None, ControlFlow::Continue(()));
    let (since, mut shown_at) = (Instant::now(), Instant::now());
    while shown.is_continue() && !ends(since) {
        std::thread::sleep(Duration::from_millis(20));
        let mut newest = None;
        match &differences {
            Some(tap) => drop(Tap::drain(tap, &mut |bytes| {
                let difference = bytemuck::try_pod_read_unaligned(bytes).ok();
                newest = difference.filter(|it: &Difference| it.service == service as u32).or(newest);
            })?),
            // The topic comes with the first candidate.
            None => match observer.tap(Topic::Difference) {
                Ok(tap) => differences = Some(tap),
                Err(BusError::TopicNotOpen { .. }) => {}
                Err(error) => return Err(error),
            },
        }
        if let Some(difference) = newest.filter(|_| shown_at.elapsed() > SHOW_INTERVAL) {
            shown_at = Instant::now();
            shown = out::show(&line(&difference, json));
        }
    }
    Ok(shown)
}

fn line(difference: &Difference, json: bool) -> String {
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

fn show(report: &SwapReport, json: bool) -> ExitCode {
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
    fn wish(&self, shadow: bool) -> SwapRequest {
        let stage = StageConfig { stage: self.stage.clone(), set: self.set.iter().cloned().collect() };
        let limit_ms = (!shadow).then_some(SwapRequest::DEFAULT_TIMEOUT_MS);
        SwapRequest { slot: self.slot.clone(), stage, shadow, expected_epoch: None, timeout_ms: limit_ms }
    }
}

fn setting(text: &str) -> Result<(String, f64), String> {
    let parted = text.split_once('=');
    let read = parted.and_then(|(key, value)| Some((key.trim().to_owned(), value.trim().parse::<f64>().ok()?)));
    read.filter(|(_, value)| value.is_finite()).ok_or_else(|| "expected KEY=VALUE with a finite number".into())
}
