//! `plumb station`: every vehicle there is to see, and whether all that it sends arrives.

mod csv;

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    path::PathBuf,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use attitude::frames::Frame;
use clap::Args;
use graph::Topic;
use link::{Arrival, Link};
use messages::{AttitudeOutput, Message};
use serde_json::{Value, json};
use wire::{
    Payload, Refusal, Refusals,
    command::ControlMessage,
    keys,
    v1::{Envelope, GatewayReport},
};

use crate::{
    delivery_tracker::DeliveryTracker,
    fail,
    out::{Screen, print},
    remote::Way,
};
use csv::Tables;

/// Between two tables on the screen.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);
/// Longest wait for a message.
const TURN: Duration = Duration::from_millis(20);
/// Vehicles that are kept in mind.
const VEHICLES_MAX: usize = 256;

/// The command line of `plumb station`.
#[derive(Args)]
pub(crate) struct Station {
    #[command(flatten)]
    way: Way,
    /// The vehicle that is shown in detail [default: the first].
    #[arg(long)]
    vehicle: Option<String>,
    /// How long [default: until Ctrl-C].
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Write a table DIR/VEHICLE/TOPIC.csv of each topic.
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Print JSON at the end, on the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// What is known of a vehicle.
#[derive(Default)]
struct Vehicle {
    services: BTreeSet<String>,
    lives: bool,
    tracks: BTreeMap<String, DeliveryTracker>,
    attitude: Option<AttitudeOutput>,
    /// In which it is.
    frame: Frame,
    refusals: Refusals,
}

/// The vehicles in sight by their names.
type Vehicles = BTreeMap<String, Vehicle>;

/// Looks at vehicles until it is to end.
pub(crate) fn run(station: &Station) -> ExitCode {
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        if let Err(cause) = signal_hook::flag::register(signal, ends.clone()) {
            return fail(&format_args!("catching signals: {cause}"), 1);
        }
    }
    let link = match station.way.open() {
        Ok(link) => link,
        Err(error) => return fail(&error, error.exit_code()),
    };
    match watch(station, &link, &ends) {
        Ok((vehicles, _)) if station.json => print(&report(&vehicles)),
        Ok((_, shown)) => shown.break_value().unwrap_or(ExitCode::SUCCESS),
        Err(error) => fail(&error, 1),
    }
}

fn watch(
    station: &Station,
    link: &Link,
    ends: &AtomicBool,
) -> Result<(Vehicles, ControlFlow<ExitCode>), Box<dyn std::error::Error>> {
    let messages = link.stream(&keys::key("*", "*"))?;
    let signs = link.signs(&keys::key("*", &format!("{}/**", keys::LIVE)))?;
    let mut tables = station.csv.as_deref().map(Tables::in_folder);
    let mut vehicles = Vehicles::new();
    let (screen, mut shown) = (Screen::new(true), ControlFlow::Continue(()));
    let (since, mut shown_at) = (Instant::now(), Instant::now());
    let over = || station.seconds.is_some_and(|limit_s| since.elapsed().as_secs_f64() > limit_s);
    while shown.is_continue() && !ends.load(Ordering::SeqCst) && !over() {
        while let Some(sign) = signs.next(Duration::ZERO) {
            see(&mut vehicles, &sign);
        }
        if let Some(message) = messages.next(TURN) {
            take(&mut vehicles, &message, tables.as_mut())?;
        }
        if shown_at.elapsed() > SHOW_INTERVAL && !station.json {
            shown_at = Instant::now();
            shown = screen.show(&|_| table(&vehicles, station.vehicle.as_deref()));
        }
    }
    tables.map_or(Ok(()), Tables::finish)?;
    link.close();
    Ok((vehicles, shown))
}

/// A vehicle by its name, as long as there are not too many.
fn known<'v>(vehicles: &'v mut Vehicles, name: &str) -> Option<&'v mut Vehicle> {
    let has_room = vehicles.len() < VEHICLES_MAX;
    (has_room || vehicles.contains_key(name)).then(|| vehicles.entry(name.into()).or_default())
}

fn see(vehicles: &mut Vehicles, sign: &Arrival) {
    let Some((name, rest)) = keys::parts(&sign.key) else { return };
    let Some(vehicle) = known(vehicles, name) else { return };
    match rest.strip_prefix(keys::LIVE).map(|service| service.trim_start_matches('/')) {
        Some("") => vehicle.lives = sign.is_there,
        Some(service) if sign.is_there => drop(vehicle.services.insert(service.into())),
        Some(service) => drop(vehicle.services.remove(service)),
        None => {}
    }
}

fn take(vehicles: &mut Vehicles, message: &Arrival, tables: Option<&mut Tables>) -> Result<(), csv::CsvError> {
    let Some((name, topic)) = keys::parts(&message.key) else { return Ok(()) };
    let Some(vehicle) = known(vehicles, name) else { return Ok(()) };
    if topic == keys::GATEWAY {
        if let Err(refusal) = vehicle.report(&message.bytes) {
            vehicle.refusals.count(&refusal);
        }
        return Ok(());
    }
    let Some(topic) = Topic::named(topic) else { return Ok(()) };
    messages::dispatch!(topic, M => vehicle.take::<M>(name, &message.bytes, tables))
}

impl Vehicle {
    /// Takes messages of a topic to the counts and into a table.
    fn take<M: Payload>(&mut self, name: &str, bytes: &[u8], tables: Option<&mut Tables>) -> Result<(), csv::CsvError> {
        let topic = M::TOPIC.name;
        match (self.samples::<M>(topic, bytes), tables) {
            (Ok(samples), Some(tables)) => tables.write(name, topic, &samples),
            (Ok(_), None) => Ok(()),
            (Err(refusal), _) => {
                self.refusals.count(&refusal);
                Ok(())
            }
        }
    }

    fn samples<M: Payload>(&mut self, topic: &str, bytes: &[u8]) -> Result<Vec<M>, Refusal> {
        let (envelope, samples) = wire::open::<M>(bytes)?;
        self.track(topic, &envelope, samples.len());
        if topic == AttitudeOutput::TOPIC.name
            && let Some(newest) = samples.last()
        {
            self.attitude = AttitudeOutput::decoded(&newest.encoded()).ok();
            self.frame = envelope.frame_said().map(|(frame, _)| frame).unwrap_or_default();
        }
        Ok(samples)
    }

    fn report(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        let report = GatewayReport::decoded(bytes)?;
        self.track(keys::GATEWAY, &report.envelope.unwrap_or_default(), 1);
        Ok(())
    }

    fn track(&mut self, topic: &str, envelope: &Envelope, samples: usize) {
        self.tracks.entry(topic.into()).or_default().take(envelope, samples as u64);
    }

    fn lost(&self) -> u64 {
        self.tracks.values().map(|track| track.lost_messages).sum()
    }
}

fn table(vehicles: &Vehicles, detail: Option<&str>) -> String {
    if vehicles.is_empty() {
        return "no vehicle yet".into();
    }
    let mut lines = vec![format!("{:<17}{:<6}{:>9}{:>8}  {}", "vehicle", "lives", "messages", "lost", "services")];
    for (name, vehicle) in vehicles {
        let messages: u64 = vehicle.tracks.values().map(|track| track.messages).sum();
        let lives = if vehicle.lives { "yes" } else { "no" };
        let services: Vec<_> = vehicle.services.iter().map(String::as_str).collect();
        lines.push(format!("{name:<17}{lives:<6}{messages:>9}{:>8}  {}", vehicle.lost(), services.join(" ")));
    }
    let shown =
        detail.or(vehicles.keys().next().map(String::as_str)).and_then(|name| Some((name, vehicles.get(name)?)));
    if let Some((name, vehicle)) = shown {
        lines.push(format!(
            "{name}: {}",
            vehicle.attitude.as_ref().map_or("no attitude yet".into(), |output| attitude(output, vehicle.frame))
        ));
        lines.push(format!("  {:<11}{}", "topic", DeliveryTracker::HEAD));
        for (topic, track) in &vehicle.tracks {
            lines.push(format!("  {topic:<11}{track}"));
        }
    }
    lines.join("\n")
}

fn attitude(output: &AttitudeOutput, frame: Frame) -> String {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, course_rad, course_reference, .. } = *output;
    let [yaw, pitch, roll, course] = [yaw_rad, pitch_rad, roll_rad, course_rad].map(f64::to_degrees);
    let reference = course_reference.name();
    format!(
        "yaw {yaw:+7.2}°  pitch {pitch:+6.2}°  roll {roll:+7.2}°  course {course:5.1}° ({reference})  {}",
        frame.name()
    )
}

fn report(vehicles: &Vehicles) -> Value {
    let vehicle = |(name, vehicle): (&String, &Vehicle)| {
        let tracks: Vec<_> = vehicle.tracks.iter().map(|(topic, track)| track.json(topic)).collect();
        let attitude = vehicle.attitude.map(|output| {
            json!({
                "tick": output.header.tick, "t_s": output.header.t_end_ns as f64 * 1e-9, "quaternion": output.quaternion,
                "frame": vehicle.frame.name(),
                "course_deg": output.course_rad.to_degrees(), "course_reference": output.course_reference.name(),
            })
        });
        json!({
            "vehicle": name, "lives": vehicle.lives, "services": vehicle.services, "attitude": attitude,
            "lost_messages": vehicle.lost(), "refused": vehicle.refusals.total(), "topics": tracks,
        })
    };
    json!({ "vehicles": vehicles.iter().map(vehicle).collect::<Vec<_>>() })
}
