//! Tests of a vehicle that itself listens for clients, like a gateway that uses no router. The same
//! access list applies as with a router.
use super::site::{Received, Site, Vehicle, query_keys, wait_for};
use zenoh::{Session, Wait};

/// Opens a listening session with the certificate of alpha.
fn alpha(site: &Site) -> Session {
    site.listening("vehicle.alpha")
}

fn site() -> Site {
    let site = Site::new(&["viewer.wall", "vehicle.beta"]);
    site.keys.issue(&"vehicle.alpha".parse().unwrap(), &["127.0.0.1".parse().unwrap()], &[], 30, false).unwrap();
    // This party receives its keys after the vehicle. It must nevertheless be on the vehicle's
    // access list.
    site.issue("operator.ann");
    site
}

#[test]
fn listening_vehicle_serves_viewers_and_operators() {
    let site = site();
    let alpha = Vehicle::new(alpha(&site), "alpha");
    let (viewer, operator) = (site.session("viewer.wall"), site.session("operator.ann"));
    let attitude = "plumbline/v1/alpha/attitude";
    let received = Received::subscribe(&viewer, "plumbline/v1/**");
    wait_for("the attitude", || {
        alpha.publish();
        received.contains(attitude)
    });
    for session in [&viewer, &operator] {
        wait_for("a reply", || !query_keys(session, attitude).is_empty());
    }
    let swap = "plumbline/v1/alpha/command/swap";
    for key in [swap, "plumbline/v1/*/command/swap", "plumbline/v1/alpha/**", "**"] {
        assert_eq!(query_keys(&viewer, key), Vec::<String>::new(), "{key}");
    }
    assert_eq!(alpha.commands.keys(), Vec::<String>::new());
    assert_eq!(query_keys(&operator, swap), [swap]);
    assert_eq!(alpha.commands.keys(), [swap]);
}

#[test]
fn listening_vehicle_is_accepted_only_at_certified_hosts() {
    let site = site();
    let _alpha = alpha(&site);
    assert!(site.open(&site.path("viewer.wall")).is_ok());
    drop(_alpha);
    site.keys.issue(&"vehicle.alpha".parse().unwrap(), &["192.0.2.1".parse().unwrap()], &[], 30, true).unwrap();
    let _alpha = alpha(&site);
    assert!(site.open(&site.path("viewer.wall")).is_err());
}

#[test]
fn other_vehicle_cannot_publish_for_listening_vehicle() {
    let site = site();
    let alpha = alpha(&site);
    let received = Received::subscribe(&alpha, "plumbline/v1/**");
    let beta = site.session("vehicle.beta");
    wait_for("beta's own message", || {
        for key in ["plumbline/v1/alpha/attitude", "plumbline/v1/beta/attitude"] {
            beta.put(key, "forged").wait().unwrap();
        }
        received.contains("plumbline/v1/beta/attitude")
    });
    assert!(!received.contains("plumbline/v1/alpha/attitude"));
}
