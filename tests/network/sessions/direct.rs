//! A vehicle that listens itself, without a router, as the gateway does: the same list holds.
use super::site::{Heard, Site, Vehicle, ask, until};
use zenoh::{Session, Wait};

/// A session that listens with the certificate of alpha.
fn alpha(site: &Site) -> Session {
    site.listening("vehicle.alpha")
}

fn site() -> Site {
    let site = Site::new(&["viewer.wall", "vehicle.beta"]);
    site.keys.issue(&"vehicle.alpha".parse().unwrap(), &["127.0.0.1".parse().unwrap()], &[], 30, false).unwrap();
    // Whoever comes later is on the list, too.
    site.issue("operator.ann");
    site
}

#[test]
fn a_vehicle_that_listens_itself_is_read_by_viewers_and_commanded_by_operators() {
    let site = site();
    let alpha = Vehicle::new(alpha(&site), "alpha");
    let (viewer, operator) = (site.session("viewer.wall"), site.session("operator.ann"));
    let attitude = "plumbline/v1/alpha/attitude";
    let heard = Heard::of(&viewer, "plumbline/v1/**");
    until("the attitude", || {
        alpha.publish();
        heard.has(attitude)
    });
    for session in [&viewer, &operator] {
        until("an answer", || !ask(session, attitude).is_empty());
    }
    let swap = "plumbline/v1/alpha/command/swap";
    for key in [swap, "plumbline/v1/*/command/swap", "plumbline/v1/alpha/**", "**"] {
        assert_eq!(ask(&viewer, key), Vec::<String>::new(), "{key}");
    }
    assert_eq!(alpha.commands.all(), Vec::<String>::new());
    assert_eq!(ask(&operator, swap), [swap]);
    assert_eq!(alpha.commands.all(), [swap]);
}

#[test]
fn a_vehicle_that_listens_itself_is_believed_to_be_the_router_only_where_its_certificate_says() {
    let site = site();
    let _alpha = alpha(&site);
    assert!(site.open(&site.path("viewer.wall")).is_ok());
    drop(_alpha);
    site.keys.issue(&"vehicle.alpha".parse().unwrap(), &["192.0.2.1".parse().unwrap()], &[], 30, true).unwrap();
    let _alpha = alpha(&site);
    assert!(site.open(&site.path("viewer.wall")).is_err());
}

#[test]
fn another_vehicle_at_its_door_cannot_speak_in_its_name() {
    let site = site();
    let alpha = alpha(&site);
    let heard = Heard::of(&alpha, "plumbline/v1/**");
    let beta = site.session("vehicle.beta");
    until("beta's own", || {
        for key in ["plumbline/v1/alpha/attitude", "plumbline/v1/beta/attitude"] {
            beta.put(key, "forged").wait().unwrap();
        }
        heard.has("plumbline/v1/beta/attitude")
    });
    assert!(!heard.has("plumbline/v1/alpha/attitude"));
}
