//! Full-screen view of `plumb station`.

use std::{
    collections::BTreeMap,
    error::Error,
    time::{Duration, Instant},
};

use dashboard::{Attitude, DataState, Figures, Key, Panel, Row, RowStyle, Screen, Snapshot, Trends, trend};
use messages::{AttitudeOutput, Message};
use observe::hops::LatencyUs;

use remote::fleet::{FleetMonitor, Vehicle, Vehicles};
use wire::delivery::DeliveryTracker;

use crate::topics::StopCondition;

/// Interval between two frames.
const FRAME_INTERVAL: Duration = Duration::from_millis(100);
/// Interval between two updates of rate and latency.
const COUNT_INTERVAL: Duration = Duration::from_secs(1);
const KEYS: &str = "q: quit   up/down: select a vehicle";

/// State of the view: statistics of each vehicle, and the selected vehicle.
#[derive(Default)]
struct View {
    selected: Option<String>,
    per_vehicle: BTreeMap<String, VehicleStats>,
}

/// Statistics of a vehicle.
#[derive(Default)]
struct VehicleStats {
    trends: Trends,
    rate_hz: Option<f64>,
    latency: Option<LatencyUs>,
    /// Time of the last count and the number of attitudes received until then.
    last_count: Option<(Instant, u64)>,
}

/// Draws the vehicles until the user quits or the time limit is reached.
pub(super) fn show(
    monitor: &mut FleetMonitor,
    stop: &mut StopCondition<'_>,
    vehicle: Option<&str>,
) -> Result<(), Box<dyn Error>> {
    let mut view = View { selected: vehicle.map(str::to_owned), ..View::default() };
    let mut screen = Screen::open()?;
    let mut drawn_at = Instant::now();
    let mut stepped_at = Instant::now();
    while !stop.is_met() {
        match screen.poll_key()? {
            Some(Key::Quit) => break,
            Some(Key::Previous) => view.select(&monitor.vehicles, |at| at.saturating_sub(1)),
            Some(Key::Next) => view.select(&monitor.vehicles, |at| at + 1),
            None => {}
        }
        monitor.poll()?;
        if stepped_at.elapsed() >= trend::SAMPLE_INTERVAL {
            stepped_at = Instant::now();
            view.step(&mut monitor.vehicles);
        }
        if drawn_at.elapsed() >= FRAME_INTERVAL {
            drawn_at = Instant::now();
            screen.draw(&view.display(&monitor.vehicles))?;
        }
    }
    Ok(())
}

impl View {
    /// Selects another vehicle. `other` converts the index of the selected vehicle to the new
    /// index.
    fn select(&mut self, vehicles: &Vehicles, other: impl Fn(usize) -> usize) {
        let at =
            self.selected.as_ref().and_then(|name| vehicles.keys().position(|one| one == name)).unwrap_or_default();
        let last = vehicles.len().saturating_sub(1);
        self.selected = vehicles.keys().nth(other(at).min(last)).cloned().or(self.selected.take());
    }

    /// Updates the statistics and trends of each vehicle.
    fn step(&mut self, vehicles: &mut Vehicles) {
        self.per_vehicle.retain(|name, _| vehicles.contains_key(name));
        for (name, vehicle) in vehicles {
            let stats = self.per_vehicle.entry(name.clone()).or_default();
            stats.count(vehicle);
            let (figures, attitude) = (stats.figures(vehicle), attitude(vehicle));
            // If a vehicle is not live, only the number of lost messages is known. The other trends
            // show a gap.
            let is_live = state(vehicle) == DataState::Live;
            let figures = if is_live { figures } else { Figures { lost: figures.lost, ..Figures::default() } };
            stats.trends.push(&figures, attitude.as_ref().filter(|_| is_live));
        }
    }

    fn display(&self, vehicles: &Vehicles) -> Snapshot {
        let selected = self.selected.as_ref().or(vehicles.keys().next());
        let fleet = fleet(vehicles, selected);
        let Some((name, vehicle)) = selected.and_then(|name| vehicles.get_key_value(name)) else {
            let name = self.selected.clone().unwrap_or_else(|| "no vehicle yet".into());
            return Snapshot { name, panels: vec![fleet], key_help: KEYS, ..Snapshot::default() };
        };
        let stats = self.per_vehicle.get(name);
        Snapshot {
            name: name.clone(),
            state: state(vehicle),
            figures: stats.map(|it| it.figures(vehicle)).unwrap_or_default(),
            attitude: attitude(vehicle),
            trends: stats.map(|it| it.trends.clone()).unwrap_or_default(),
            panels: vec![fleet, topics(name, vehicle)],
            key_help: KEYS,
        }
    }
}

impl VehicleStats {
    fn count(&mut self, vehicle: &mut Vehicle) {
        let samples = vehicle.trackers.get(AttitudeOutput::TOPIC.name).map_or(0, |tracker| tracker.samples);
        let Some((since, before)) = self.last_count else {
            self.last_count = Some((Instant::now(), samples));
            return;
        };
        if since.elapsed() >= COUNT_INTERVAL {
            self.rate_hz = Some(samples.saturating_sub(before) as f64 / since.elapsed().as_secs_f64());
            self.latency = vehicle.latencies.take().or(self.latency);
            self.last_count = Some((Instant::now(), samples));
        }
    }

    fn figures(&self, vehicle: &Vehicle) -> Figures {
        Figures {
            tick: vehicle.attitude.map(|attitude| attitude.header.tick),
            rate_hz: self.rate_hz,
            latency_us: self.latency.map(|latency| [latency.p50, latency.p99]),
            lost: Some(vehicle.lost()),
        }
    }
}

fn attitude(vehicle: &Vehicle) -> Option<Attitude> {
    vehicle.attitude.as_ref().map(|output| Attitude::from_output(output, vehicle.frame))
}

fn state(vehicle: &Vehicle) -> DataState {
    match vehicle.attitude_at {
        Some(_) if !vehicle.is_alive => DataState::Ended("its gateway is unreachable".into()),
        at => DataState::from_age(at.map(|at| at.elapsed())),
    }
}

/// Returns the panel with a line for each vehicle.
fn fleet(vehicles: &Vehicles, selected: Option<&String>) -> Panel {
    let head =
        format!("{:<17}{:>8}{:>8}{:>8}{:>9}{:>7}  state", "vehicle", "roll", "pitch", "course", "messages", "lost");
    let line = |(name, vehicle): (&String, &Vehicle)| {
        let mark = match state(vehicle) {
            _ if selected == Some(name) => RowStyle::Selected,
            DataState::Live | DataState::Connecting if vehicle.lost() == 0 => RowStyle::Normal,
            _ => RowStyle::Alert,
        };
        let angles = attitude(vehicle).map_or_else(
            || ["–", "–", "–"].map(str::to_owned),
            |it| {
                let [roll, pitch, _] = it.roll_pitch_yaw_deg.map(|degrees| format!("{degrees:+.1}°"));
                [roll, pitch, format!("{:.1}°", it.course_deg)]
            },
        );
        let [roll, pitch, course] = angles;
        let (messages, lost, state) = (vehicle.messages(), vehicle.lost(), state(vehicle).label());
        Row::new(mark, format!("{name:<17}{roll:>8}{pitch:>8}{course:>8}{messages:>9}{lost:>7}  {state}"))
    };
    let rows: Vec<_> = if vehicles.is_empty() {
        vec![Row::new(
            RowStyle::Normal,
            "no vehicle yet: a vehicle needs [gateway] in its launch file and an endpoint of --connect",
        )]
    } else {
        [Row::new(RowStyle::Header, head)].into_iter().chain(vehicles.iter().map(line)).collect()
    };
    Panel { title: "vehicles".into(), rows }
}

/// Returns the panel with a line for each topic of a vehicle.
fn topics(name: &str, vehicle: &Vehicle) -> Panel {
    let head = Row::new(RowStyle::Header, format!("{:<11}{}", "topic", DeliveryTracker::HEADER));
    let line = |(topic, tracker): (&String, &DeliveryTracker)| {
        let mark = if tracker.lost_messages == 0 { RowStyle::Normal } else { RowStyle::Alert };
        Row::new(mark, format!("{topic:<11}{tracker}"))
    };
    let services: Vec<_> = vehicle.services.iter().map(ToString::to_string).collect();
    let title = format!("topics of {name}; services: {}", services.join(" "));
    Panel { title, rows: [head].into_iter().chain(vehicle.trackers.iter().map(line)).collect() }
}
