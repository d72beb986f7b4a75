//! Remote vehicles for the cockpit: a summary of each vehicle, and views of the selected ones.

use std::{
    collections::BTreeMap,
    convert::Infallible,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use cockpit::{
    hub::Hub,
    source::CommandTarget,
    vehicles::{VehicleDirectory, VehicleView, ViewUse},
};
use graph::Topic;
use link::Link;
use runtime::frames::attitude_from_frame;
use wire::{
    Payload as _,
    command::ControlMessage as _,
    keys,
    v1::{Services, VehicleLine},
};

use crate::{
    endpoint::RemoteEndpoint,
    error::RemoteError,
    fleet::{FleetMonitor, Vehicle},
    vehicle_source::{RemoteCommandTarget, RemoteSource, VehicleLines},
};

/// Interval between two updates of the summaries.
const LINES_INTERVAL: Duration = Duration::from_secs(1);
/// Interval between two service queries to all vehicles.
const SERVICES_INTERVAL: Duration = Duration::from_secs(3);
/// Timeout of a service query.
const SERVICES_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum number of vehicles with an open view, for each kind of use ([`ViewUse`]).
const MAX_VIEWS: usize = 8;
/// Time after which an unused view for metrics is closed. Prometheus typically polls once a minute.
const UNUSED_METRICS_TIMEOUT: Duration = Duration::from_secs(90);
/// Time after which a view without viewers is closed. The time is longer than a page needs to
/// reconnect.
const UNUSED_TIMEOUT: Duration = Duration::from_secs(10);

/// Vehicles that are reachable over a link.
pub struct RemoteDirectory {
    link: Link,
    endpoint: RemoteEndpoint,
    /// Vehicle shown if none is named.
    default_vehicle: Option<String>,
    lines: VehicleLines,
    views: Arc<Mutex<OpenViews>>,
}

/// Open views, each identified by its use and the name of the vehicle. Views for different uses are
/// independent of each other.
type OpenViews = BTreeMap<(ViewUse, String), OpenView>;

/// Open view of a vehicle.
struct OpenView {
    view: VehicleView,
    /// Time of the last use.
    used_at: Instant,
}

impl RemoteDirectory {
    /// Starts monitoring all vehicles that are reachable over `link`, which was opened at
    /// `endpoint`.
    ///
    /// # Errors
    ///
    /// Fails if the link is closed.
    pub fn start(link: Link, endpoint: RemoteEndpoint, default_vehicle: Option<&str>) -> Result<Self, RemoteError> {
        let lines = VehicleLines::default();
        let monitor = FleetMonitor::open(&link, &[Topic::Attitude.name(), keys::GATEWAY], None)?;
        let (shared_lines, query_link) = (lines.clone(), link.clone());
        let services = Arc::new(Mutex::new(BTreeMap::new()));
        let reports = services.clone();
        thread::spawn(move || poll_services(&query_link, &reports));
        thread::spawn(move || update_lines(monitor, &services, &shared_lines));
        let default_vehicle = default_vehicle.map(str::to_owned);
        Ok(Self { link, endpoint, default_vehicle, lines, views: Arc::default() })
    }

    /// Opens the view of a vehicle, or an empty view if no vehicle is named.
    fn open_view(&self, name: Option<&str>, view_use: ViewUse) -> VehicleView {
        let hub = Arc::new(Hub::default());
        let target: Arc<dyn CommandTarget> = Arc::new(RemoteCommandTarget {
            name: name.map(str::to_owned),
            link: self.link.clone(),
            endpoint: self.endpoint.clone(),
            lines: self.lines.clone(),
        });
        let system = name.unwrap_or_default().to_owned();
        let view = VehicleView { system, hub: hub.clone(), target: Some(target.clone()) };
        let mut source = RemoteSource::new(name, self.link.clone());
        let (views, key) = (self.views.clone(), (view_use, name.unwrap_or_default().to_owned()));
        thread::spawn(move || {
            let shown = hub.clone();
            let Ok(()) = cockpit::publish_source(&mut source, target, &shown, &mut |_| {
                Ok::<_, Infallible>(is_in_use(&views, &key, &hub))
            });
        });
        view
    }
}

/// Returns `true` if the view has viewers or was used recently. Otherwise closes the view.
fn is_in_use(views: &Mutex<OpenViews>, key: &(ViewUse, String), hub: &Hub) -> bool {
    let mut views = views.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(open_view) = views.get_mut(key) else { return true };
    if hub.has_viewers() {
        open_view.used_at = Instant::now();
    }
    let unused_timeout = if key.0 == ViewUse::Metrics { UNUSED_METRICS_TIMEOUT } else { UNUSED_TIMEOUT };
    let in_use = open_view.used_at.elapsed() < unused_timeout;
    if !in_use {
        views.remove(key);
    }
    in_use
}

/// Returns an error if the maximum number of views for this use is already open.
fn check_limit(views: &OpenViews, view_use: ViewUse) -> Result<(), String> {
    if views.keys().filter(|(held_by, _)| *held_by == view_use).count() < MAX_VIEWS {
        return Ok(());
    }
    Err(match view_use {
        ViewUse::Metrics => format!("the metrics of {MAX_VIEWS} vehicles are already read; try again after 90 s"),
        ViewUse::Anonymous | ViewUse::Authorized => format!("{MAX_VIEWS} vehicles are already open; close a page"),
    })
}

impl VehicleDirectory for RemoteDirectory {
    fn view(&self, vehicle: Option<&str>, view_use: ViewUse) -> Result<VehicleView, String> {
        let name = vehicle.or(self.default_vehicle.as_deref());
        if let Some(name) = name.filter(|name| !keys::is_vehicle_name(name)) {
            return Err(format!("invalid vehicle name {name:?}"));
        }
        let key = (view_use, name.unwrap_or_default().to_owned());
        let mut views = self.views.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open_view) = views.get_mut(&key) {
            open_view.used_at = Instant::now();
            return Ok(open_view.view.clone());
        }
        // Unknown vehicle names must not occupy a view.
        let is_known = |name: &str| {
            self.lines.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|line| line.vehicle == name)
        };
        if let Some(name) = vehicle.filter(|name| self.default_vehicle.as_deref() != Some(*name) && !is_known(name)) {
            return Err(format!("unknown vehicle {name:?}"));
        }
        check_limit(&views, view_use)?;
        let view = self.open_view(name, view_use);
        views.insert(key, OpenView { view: view.clone(), used_at: Instant::now() });
        Ok(view)
    }
}

/// Newest service report of each vehicle.
type ServiceReports = Mutex<BTreeMap<String, Services>>;

/// Keeps querying the services of all vehicles. Returns once the reports are no longer in use.
fn poll_services(link: &Link, reports: &Arc<ServiceReports>) {
    while Arc::strong_count(reports) > 1 {
        let started = Instant::now();
        // A vehicle that does not reply has no stage in its summary.
        let replies = link.query(&keys::key("*", keys::SERVICES), Vec::new(), SERVICES_TIMEOUT).unwrap_or_default();
        let replies = replies.iter().filter_map(|(key, bytes)| {
            let (name, _) = keys::parse(key)?;
            Some((name.to_owned(), Services::from_bytes(bytes).ok()?))
        });
        *reports.lock().unwrap_or_else(PoisonError::into_inner) = replies.collect();
        thread::sleep(SERVICES_INTERVAL.saturating_sub(started.elapsed()));
    }
}

/// Keeps updating the summaries of all vehicles. Returns once the summaries are no longer in use.
fn update_lines(mut monitor: FleetMonitor, services: &ServiceReports, shared_lines: &VehicleLines) {
    let mut before = Instant::now();
    while Arc::strong_count(shared_lines) > 1 {
        // Polling fails only if a table cannot be written, and no tables are written here.
        let _ = monitor.poll();
        if before.elapsed() >= LINES_INTERVAL {
            before = Instant::now();
            let reports = services.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let lines = monitor.vehicles.iter().map(|(name, vehicle)| line(name, vehicle, reports.get(name)));
            *shared_lines.lock().unwrap_or_else(PoisonError::into_inner) = lines.collect();
        }
    }
}

fn line(name: &str, vehicle: &Vehicle, services: Option<&Services>) -> VehicleLine {
    let status = |slot: &str| services.and_then(|all| all.services.iter().find(|one| one.service == slot));
    VehicleLine {
        vehicle: name.into(),
        alive: vehicle.is_alive,
        age_s: vehicle.attitude_at.map(|at| at.elapsed().as_secs_f64()),
        attitude: vehicle.attitude.map(|attitude| attitude_from_frame(vehicle.frame, attitude).to_proto()),
        lost_messages: vehicle.lost(),
        lost_ticks: status("course").map(|status| status.lost),
        stage: status("fuser").map(|status| status.stage.clone()).unwrap_or_default(),
        services: vehicle.services.iter().map(|service| service.raw().to_owned()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(views: &mut OpenViews, view_use: ViewUse, name: &str, unused: Duration) -> Arc<Hub> {
        let hub = Arc::<Hub>::default();
        let view = VehicleView { system: name.into(), hub: hub.clone(), target: None };
        let used_at = Instant::now().checked_sub(unused).unwrap();
        views.insert((view_use, name.into()), OpenView { view, used_at });
        hub
    }

    #[test]
    fn metrics_take_no_place_of_viewers() {
        let mut views = OpenViews::new();
        for number in 0..MAX_VIEWS {
            open(&mut views, ViewUse::Metrics, &format!("x{number}"), Duration::ZERO);
        }
        assert!(check_limit(&views, ViewUse::Metrics).unwrap_err().contains("90 s"));
        assert_eq!(check_limit(&views, ViewUse::Anonymous), Ok(()));
        for number in 0..MAX_VIEWS {
            open(&mut views, ViewUse::Anonymous, &format!("x{number}"), Duration::ZERO);
        }
        assert!(check_limit(&views, ViewUse::Anonymous).is_err());
        assert_eq!(check_limit(&views, ViewUse::Authorized), Ok(()), "a token has places of its own");
    }

    #[test]
    fn metrics_do_not_keep_view_of_viewers() {
        let mut views = OpenViews::new();
        let unused = UNUSED_TIMEOUT * 2;
        let viewed = open(&mut views, ViewUse::Anonymous, "boat", unused);
        let read = open(&mut views, ViewUse::Metrics, "boat", unused);
        let views = Mutex::new(views);
        assert!(!is_in_use(&views, &(ViewUse::Anonymous, "boat".into()), &viewed));
        assert!(is_in_use(&views, &(ViewUse::Metrics, "boat".into()), &read));
        assert_eq!(views.into_inner().unwrap().len(), 1);
    }
}
