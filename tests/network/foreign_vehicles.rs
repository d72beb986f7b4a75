//! Vehicles on the network that are not trusted: their number is limited, and those that have left
//! make room for others.
use std::net::TcpListener;

use crate::common::wait_for;
use link::{Endpoints, Link, Liveliness};
use remote::fleet::FleetMonitor;
use wire::keys;

/// Number of vehicles that a station tracks.
const MAX_VEHICLES: usize = 256;

/// Opens a session that declares tokens, and a monitor that is connected to it.
fn open_pair() -> (Link, Link, FleetMonitor) {
    let endpoint = format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap());
    let fleet = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
    let station = Link::open(&Endpoints::with_connect(&[endpoint])).unwrap();
    wait_for("the connection", || station.peer_count() > 0);
    let monitor = FleetMonitor::open(&station, &["*"], None).unwrap();
    (fleet, station, monitor)
}

fn vehicle_token(fleet: &Link, name: &str) -> Liveliness {
    fleet.declare_liveliness(&keys::key(name, keys::LIVELINESS)).unwrap()
}

/// Declares a service of the vehicle `first` and waits for its token. Tokens arrive in the order in
/// which they are declared, so all earlier changes have then been processed.
fn wait_for_changes(fleet: &Link, monitor: &mut FleetMonitor, service: &str) {
    let _token = fleet.declare_liveliness(&keys::service_liveliness("first", service)).unwrap();
    wait_for("all changes of liveliness", || {
        monitor.poll().unwrap();
        monitor.vehicles["first"].services.iter().any(|known| *known == *service)
    });
}

#[test]
fn vehicles_that_have_left_make_room_for_new_ones() {
    let (fleet, _station, mut monitor) = open_pair();
    let _first = vehicle_token(&fleet, "first");
    wait_for("the first vehicle", || {
        monitor.poll().unwrap();
        monitor.vehicles.contains_key("first")
    });
    let mut others: Vec<_> = (0..300).map(|number| vehicle_token(&fleet, &format!("x{number}"))).collect();
    wait_for_changes(&fleet, &mut monitor, "full");
    assert_eq!(monitor.vehicles.len(), MAX_VEHICLES);
    assert!(monitor.vehicles.values().all(|vehicle| vehicle.is_alive));

    // Two tracked vehicles leave, in this order. They remain listed until another one needs room.
    for _ in 0..2 {
        drop(others.remove(0));
    }
    wait_for_changes(&fleet, &mut monitor, "left");
    assert!(["x0", "x1"].iter().all(|name| !monitor.vehicles[*name].is_alive));
    let _new = vehicle_token(&fleet, "new");
    wait_for_changes(&fleet, &mut monitor, "replaced");
    let is_known = |name: &str| monitor.vehicles.contains_key(name);
    assert_eq!(["x0", "x1", "x2", "new"].map(is_known), [false, true, true, true]);
    assert_eq!(monitor.vehicles.len(), MAX_VEHICLES);
}
