//! `plumb swap`, `plumb shadow`, `plumb ps`: what a running system is asked.

use std::{
    ops::ControlFlow,
    path::Path,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{BusError, Tap};
use clap::Args;
use launch::{Launch, Service, Stage};
use messages::{Difference, Message};
use supervisor::{Ask, Standing, SwapReport, Wish, ask};

use crate::{
    fail,
    out::{self, print},
    remote::{self, Way},
    seeing::observer,
};

/// How often the difference of a shadow is shown.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);
/// How long a shadow takes at most to end once that was asked for.
const END_LIMIT: Duration = Duration::from_secs(5);

/// Which system on this machine is asked.
#[derive(Args)]
pub(crate) struct OnBoard {
    /// The system's name [default: that of ./launch.toml, else plumbline].
    #[arg(long = "system", value_name = "NAME")]
    name: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Which system is asked, on this machine or elsewhere.
#[derive(Args)]
pub(crate) struct System {
    #[command(flatten)]
    on_board: OnBoard,
    /// A vehicle elsewhere in its place, over the network.
    #[arg(long, value_name = "VEHICLE", conflicts_with = "name")]
    remote: Option<String>,
    #[command(flatten)]
    way: Way,
}

/// What is to fill a slot.
#[derive(Args)]
pub(crate) struct Exchange {
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
    exchange: Exchange,
    /// How long [default: until Ctrl-C, or until a swap to the same stage].
    #[arg(long = "for", value_name = "SECONDS")]
    duration_s: Option<f64>,
}

/// Exchanges what fills a slot.
pub(crate) fn swap(exchange: Exchange) -> ExitCode {
    let json = exchange.system.json();
    if let Some(vehicle) = &exchange.system.remote {
        return match remote::swap(vehicle, &exchange.system.way, &exchange.slot, exchange.wish(false).stage) {
            Ok(report) => show(&report, json),
            Err(error) => fail(&error, error.exit_code()),
        };
    }
    match ask::<SwapReport>(&exchange.system.name(), &Ask::Swap(exchange.wish(false))) {
        Ok(report) => show(&report, json),
        Err(error) => fail(&error, 1),
    }
}

/// Runs a stage beside the one that fills a slot and tells how far they are apart.
pub(crate) fn shadow(shadow: Shadow) -> ExitCode {
    let Shadow { exchange, duration_s } = shadow;
    if exchange.system.remote.is_some() {
        return fail(
            &"a shadow is asked for on board: leave --remote out; `plumb swap --remote` exchanges from elsewhere",
            2,
        );
    }
    let (name, json) = (exchange.system.name(), exchange.system.json());
    let Some(service) = Service::named(&exchange.slot) else {
        return fail(&format_args!("there is no slot `{}`; there are gyro, accel, fuser and course", exchange.slot), 2);
    };
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        if let Err(cause) = signal_hook::flag::register(signal, ends.clone()) {
            return fail(&format_args!("catching signals: {cause}"), 1);
        }
    }
    let question = Ask::Swap(exchange.wish(true));
    let answer = std::thread::spawn({
        let name = name.clone();
        move || ask::<SwapReport>(&name, &question)
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
    if !by_itself && let Err(error) = ask::<()>(&name, &Ask::Cancel { slot: service.name().into() }) {
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
    let asked = match &system.remote {
        Some(vehicle) => remote::ps(vehicle, &system.way).map_err(|error| (error.to_string(), error.exit_code())),
        None => ask::<Vec<Standing>>(&system.name(), &Ask::Ps).map_err(|error| (error.to_string(), 1)),
    };
    match asked {
        Ok(services) if system.json() => print(&serde_json::to_string(&services).unwrap_or_default()),
        Ok(services) => {
            let line = |one: &Standing| {
                let Standing { service, stage, state, pid, restarts, epoch, ticks, lost, at, .. } = one;
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
            None => match observer.tap(Difference::TOPIC) {
                Ok(tap) => differences = Some(tap),
                Err(BusError::Unopened { .. }) => {}
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
    let committed = report.outcome == supervisor::Outcome::Committed;
    let printed = if json {
        print(&serde_json::to_string(report).unwrap_or_default())
    } else if committed {
        print(report)
    } else {
        supervisor::tell(format_args!("{report}"));
        ExitCode::SUCCESS
    };
    if committed { printed } else { ExitCode::FAILURE }
}

impl Exchange {
    fn wish(&self, shadow: bool) -> Wish {
        let stage = Stage { stage: self.stage.clone(), set: self.set.iter().cloned().collect() };
        let limit_ms = (!shadow).then_some(Wish::LIMIT_MS);
        Wish { slot: self.slot.clone(), stage, shadow, expected_epoch: None, limit_ms }
    }
}

impl System {
    pub(crate) fn json(&self) -> bool {
        self.on_board.json
    }

    pub(crate) fn name(&self) -> String {
        self.on_board.name()
    }

    /// The vehicle elsewhere, and the way to it.
    pub(crate) fn remote(&self) -> Option<(&str, &Way)> {
        Some((self.remote.as_deref()?, &self.way))
    }
}

impl OnBoard {
    /// It was named on the command line.
    pub(crate) fn is_named(&self) -> bool {
        self.name.is_some()
    }

    pub(crate) fn name(&self) -> String {
        let of_file = || Some(Launch::read(Path::new("launch.toml")).ok()?.name);
        self.name.clone().or_else(of_file).unwrap_or_else(|| Launch::default().name)
    }
}

fn setting(text: &str) -> Result<(String, f64), String> {
    let parted = text.split_once('=');
    let read = parted.and_then(|(key, value)| Some((key.trim().to_owned(), value.trim().parse::<f64>().ok()?)));
    read.filter(|(_, value)| value.is_finite()).ok_or_else(|| "expected KEY=VALUE with a finite number".into())
}
