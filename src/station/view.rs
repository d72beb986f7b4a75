//! The view of the whole terminal.

use std::{
    collections::BTreeMap,
    error::Error,
    time::{Duration, Instant},
};

use dashboard::{Attitude, Facts, Key, Mark, Panel, Picture, Row, Screen, State, Trends, trend};
use messages::{AttitudeOutput, Message};
use observe::hops::LatencyUs;

use super::{
    Sight,
    fleet::{Vehicle, Vehicles},
};
use wire::delivery::DeliveryTracker;

/// Between two pictures.
const PICTURE_INTERVAL: Duration = Duration::from_millis(100);
/// Between two counts of what has come.
const COUNT_INTERVAL: Duration = Duration::from_secs(1);
const KEYS: &str = "q ends; up and down choose a vehicle; --lines prints lines";

/// What is followed of each vehicle, and which one is chosen.
#[derive(Default)]
struct View {
    chosen: Option<String>,
    each: BTreeMap<String, Followed>,
}

/// What is followed of a vehicle.
#[derive(Default)]
struct Followed {
    trends: Trends,
    rate_hz: Option<f64>,
    latency: Option<LatencyUs>,
    /// Attitudes that had come at the last count.
    counted: Option<(Instant, u64)>,
}

/// Draws the vehicles until somebody ends it.
pub(super) fn show(sight: &mut Sight, vehicle: Option<&str>) -> Result<(), Box<dyn Error>> {
    let mut view = View { chosen: vehicle.map(str::to_owned), ..View::default() };
    let mut screen = Screen::open()?;
    let mut drawn_at = Instant::now();
    let mut stepped_at = Instant::now();
    while !sight.is_over() {
        match screen.key()? {
            Some(Key::End) => break,
            Some(Key::Before) => view.choose(&sight.vehicles, |at| at.saturating_sub(1)),
            Some(Key::After) => view.choose(&sight.vehicles, |at| at + 1),
            None => {}
        }
        sight.look()?;
        if stepped_at.elapsed() >= trend::STEP {
            stepped_at = Instant::now();
            view.step(&mut sight.vehicles);
        }
        if drawn_at.elapsed() >= PICTURE_INTERVAL {
            drawn_at = Instant::now();
            screen.draw(&view.picture(&sight.vehicles))?;
        }
    }
    Ok(())
}

impl View {
    /// Another vehicle, by its place among all.
    fn choose(&mut self, vehicles: &Vehicles, other: impl Fn(usize) -> usize) {
        let at = self.chosen.as_ref().and_then(|name| vehicles.keys().position(|one| one == name)).unwrap_or_default();
        let last = vehicles.len().saturating_sub(1);
        self.chosen = vehicles.keys().nth(other(at).min(last)).cloned().or(self.chosen.take());
    }

    /// Counts and measures what came of each vehicle.
    fn step(&mut self, vehicles: &mut Vehicles) {
        for (name, vehicle) in vehicles {
            let followed = self.each.entry(name.clone()).or_default();
            followed.count(vehicle);
            let (facts, attitude) = (followed.facts(vehicle), attitude(vehicle));
            // What stands still has no trend: a gap says so.
            let is_live = state(vehicle) == State::Live;
            let facts = if is_live { facts } else { Facts { lost: facts.lost, ..Facts::default() } };
            followed.trends.step(&facts, attitude.as_ref().filter(|_| is_live));
        }
    }

    fn picture(&self, vehicles: &Vehicles) -> Picture {
        let chosen = self.chosen.as_ref().or(vehicles.keys().next());
        let fleet = fleet(vehicles, chosen);
        let Some((name, vehicle)) = chosen.and_then(|name| vehicles.get_key_value(name)) else {
            let name = self.chosen.clone().unwrap_or_else(|| "no vehicle yet".into());
            return Picture { name, panels: vec![fleet], keys: KEYS, ..Picture::default() };
        };
        let followed = self.each.get(name);
        Picture {
            name: name.clone(),
            state: state(vehicle),
            facts: followed.map(|it| it.facts(vehicle)).unwrap_or_default(),
            attitude: attitude(vehicle),
            trends: followed.map(|it| it.trends.clone()).unwrap_or_default(),
            panels: vec![fleet, topics(name, vehicle)],
            keys: KEYS,
        }
    }
}

impl Followed {
    fn count(&mut self, vehicle: &mut Vehicle) {
        let samples = vehicle.tracks.get(AttitudeOutput::TOPIC.name).map_or(0, |track| track.samples);
        let Some((since, before)) = self.counted else {
            self.counted = Some((Instant::now(), samples));
            return;
        };
        if since.elapsed() >= COUNT_INTERVAL {
            self.rate_hz = Some(samples.saturating_sub(before) as f64 / since.elapsed().as_secs_f64());
            self.latency = vehicle.latencies.take().or(self.latency);
            self.counted = Some((Instant::now(), samples));
        }
    }

    fn facts(&self, vehicle: &Vehicle) -> Facts {
        Facts {
            tick: vehicle.attitude.map(|attitude| attitude.header.tick),
            rate_hz: self.rate_hz,
            latency_us: self.latency.map(|latency| [latency.p50, latency.p99]),
            lost: Some(vehicle.lost()),
        }
    }
}

fn attitude(vehicle: &Vehicle) -> Option<Attitude> {
    vehicle.attitude.as_ref().map(|output| Attitude::of(output, vehicle.frame))
}

fn state(vehicle: &Vehicle) -> State {
    match vehicle.attitude_at {
        Some(_) if !vehicle.lives => State::Ended("its gateway is out of reach".into()),
        at => State::of_age(at.map(|at| at.elapsed())),
    }
}

/// A line for each vehicle.
fn fleet(vehicles: &Vehicles, chosen: Option<&String>) -> Panel {
    let head =
        format!("{:<17}{:>8}{:>8}{:>8}{:>9}{:>7}  state", "vehicle", "roll", "pitch", "course", "messages", "lost");
    let line = |(name, vehicle): (&String, &Vehicle)| {
        let mark = match state(vehicle) {
            _ if chosen == Some(name) => Mark::Chosen,
            State::Live | State::Connecting if vehicle.lost() == 0 => Mark::Usual,
            _ => Mark::Bad,
        };
        let angles = attitude(vehicle).map_or_else(
            || ["–", "–", "–"].map(str::to_owned),
            |it| {
                let [roll, pitch, _] = it.roll_pitch_yaw_deg.map(|degrees| format!("{degrees:+.1}°"));
                [roll, pitch, format!("{:.1}°", it.course_deg)]
            },
        );
        let [roll, pitch, course] = angles;
        let (messages, lost, state) = (vehicle.messages(), vehicle.lost(), state(vehicle).word());
        Row::new(mark, format!("{name:<17}{roll:>8}{pitch:>8}{course:>8}{messages:>9}{lost:>7}  {state}"))
    };
    let rows: Vec<_> = if vehicles.is_empty() {
        vec![Row::new(
            Mark::Usual,
            "no vehicle yet: one with [gateway] in its launch file, at an endpoint of --connect",
        )]
    } else {
        [Row::new(Mark::Head, head)].into_iter().chain(vehicles.iter().map(line)).collect()
    };
    Panel { title: "vehicles".into(), rows }
}

/// A line for each topic of a vehicle.
fn topics(name: &str, vehicle: &Vehicle) -> Panel {
    let head = Row::new(Mark::Head, format!("{:<11}{}", "topic", DeliveryTracker::HEADER));
    let line = |(topic, track): (&String, &DeliveryTracker)| {
        let mark = if track.lost_messages == 0 { Mark::Usual } else { Mark::Bad };
        Row::new(mark, format!("{topic:<11}{track}"))
    };
    let services: Vec<_> = vehicle.services.iter().map(String::as_str).collect();
    let title = format!("what arrives of {name}; its services: {}", services.join(" "));
    Panel { title, rows: [head].into_iter().chain(vehicle.tracks.iter().map(line)).collect() }
}
