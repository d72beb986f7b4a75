//! What each role may do, and may not, at a router with the list that `plumb keys` writes.
use super::site::{Heard, Site, Vehicle, ask, ask_alive, until};
use zenoh::Wait;

const ATTITUDE: &str = "plumbline/v1/alpha/attitude";
const SWAP: &str = "plumbline/v1/alpha/command/swap";

#[test]
fn a_viewer_reads_telemetry_last_values_schemas_and_who_is_alive() {
    for site in Site::both(&["vehicle.alpha", "viewer.wall"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let viewer = site.session("viewer.wall");
        for key in [ATTITUDE, "plumbline/v1/*/attitude", "plumbline/v1/**"] {
            let heard = Heard::of(&viewer, key);
            until(key, || {
                alpha.publish();
                heard.has(ATTITUDE)
            });
        }
        for (asked, answer) in [
            (ATTITUDE, ATTITUDE),
            ("plumbline/v1/*/attitude", ATTITUDE),
            ("plumbline/v1/alpha/*", ATTITUDE),
            ("plumbline/v1/alpha/schema", "plumbline/v1/alpha/schema"),
        ] {
            until(asked, || ask(&viewer, asked).iter().any(|key| key == answer));
        }
        let live = "plumbline/v1/alpha/@live/fuser";
        until("who is alive", || ask_alive(&viewer, "plumbline/v1/*/@live/**").iter().any(|key| key == live));
        let alive = Heard::alive(&viewer, "plumbline/v1/*/@live/*");
        until("a sign of life", || alive.has(live));
    }
}

#[test]
fn a_viewer_cannot_command_however_the_query_is_worded_and_an_operator_can() {
    for site in Site::both(&["vehicle.alpha", "viewer.wall", "operator.ann"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let (viewer, operator) = (site.session("viewer.wall"), site.session("operator.ann"));
        // Both are heard: what follows is not for want of a connection.
        for session in [&viewer, &operator] {
            until("an answer", || !ask(session, ATTITUDE).is_empty());
        }
        let meeting_the_command = [
            SWAP,
            "plumbline/v1/*/command/swap",
            "plumbline/v1/alpha/command/*",
            "plumbline/v1/alpha/**",
            "plumbline/**",
            "**",
        ];
        for key in meeting_the_command {
            assert_eq!(ask(&viewer, key), Vec::<String>::new(), "{key}");
        }
        assert_eq!(alpha.commands.all(), Vec::<String>::new());
        assert_eq!(ask(&operator, SWAP), [SWAP]);
        assert_eq!(alpha.commands.all(), [SWAP]);
    }
}

#[test]
fn an_operator_commands_one_vehicle_at_a_time() {
    for site in Site::both(&["vehicle.alpha", "vehicle.beta", "operator.ann"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let beta = Vehicle::new(site.session("vehicle.beta"), "beta");
        let operator = site.session("operator.ann");
        let beta_swap = "plumbline/v1/beta/command/swap";
        until("both", || ask(&operator, "plumbline/v1/*/attitude").len() == 2);
        for key in ["plumbline/v1/*/command/swap", "plumbline/v1/**"] {
            assert_eq!(ask(&operator, key), Vec::<String>::new(), "{key}");
        }
        assert_eq!(ask(&operator, beta_swap), [beta_swap]);
        assert_eq!((alpha.commands.all(), beta.commands.all()), (vec![], vec![beta_swap.to_owned()]));
    }
}

#[test]
fn a_vehicle_publishes_below_its_own_name_only() {
    for site in Site::both(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let _router = site.router();
        let heard = Heard::of(&site.session("viewer.wall"), "plumbline/v1/**");
        let beta = site.session("vehicle.beta");
        // In this order on one connection: when its own has come, the others will not.
        until("beta's own", || {
            for key in [ATTITUDE, "plumbline/v1/*/attitude", "plumbline/v1/beta/attitude"] {
                beta.put(key, "forged").wait().unwrap();
            }
            heard.has("plumbline/v1/beta/attitude")
        });
        assert!(heard.all().iter().all(|key| key == "plumbline/v1/beta/attitude"), "{:?}", heard.all());
        let alpha = site.session("vehicle.alpha");
        until("the same from alpha", || {
            alpha.put(ATTITUDE, "true").wait().unwrap();
            heard.has(ATTITUDE)
        });
    }
}

#[test]
fn a_vehicle_hears_nothing_of_another() {
    for site in Site::both(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let _router = site.router();
        let beta = site.session("vehicle.beta");
        let overheard = Heard::of(&beta, "plumbline/v1/**");
        let heard = Heard::of(&site.session("viewer.wall"), "plumbline/v1/**");
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        until("ten attitudes", || {
            alpha.publish();
            heard.all().len() > 10
        });
        assert_eq!(ask(&beta, ATTITUDE), Vec::<String>::new());
        assert_eq!(ask(&beta, SWAP), Vec::<String>::new());
        assert_eq!((overheard.all(), alpha.commands.all()), (vec![], vec![]));
    }
}

#[test]
fn a_vehicle_neither_answers_nor_lives_nor_takes_commands_for_another() {
    for site in Site::both(&["vehicle.alpha", "vehicle.beta", "operator.ann"]) {
        let _router = site.router();
        let operator = site.session("operator.ann");
        let alive = Heard::alive(&operator, "plumbline/v1/*/@live/*");
        // All that alpha does, with the certificate of beta.
        let beta = site.session("vehicle.beta");
        let forged = Vehicle::new(beta.clone(), "alpha");
        let caught = Heard::default();
        let catch = caught.clone();
        let everywhere = beta.declare_queryable("plumbline/v1/*/command/swap");
        everywhere.callback(move |query| catch.add(query.key_expr().as_str())).background().wait().unwrap();
        let _own = Vehicle::new(beta, "beta");
        until("beta's own life", || alive.has("plumbline/v1/beta/@live/fuser"));
        until("beta's own answer", || !ask(&operator, "plumbline/v1/beta/attitude").is_empty());
        assert_eq!(ask(&operator, ATTITUDE), Vec::<String>::new());
        assert_eq!(ask(&operator, SWAP), Vec::<String>::new());
        assert!(!alive.all().iter().any(|key| key.contains("alpha")), "{:?}", alive.all());
        assert_eq!((forged.commands.all(), caught.all()), (vec![], vec![]));

        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        until("alpha's own life", || alive.has("plumbline/v1/alpha/@live/fuser"));
        until("alpha's own answer", || ask(&operator, SWAP) == [SWAP]);
        assert!(!alpha.commands.all().is_empty() && forged.commands.all().is_empty());
    }
}

#[test]
fn the_ground_publishes_nothing() {
    for site in Site::both(&["vehicle.alpha", "viewer.wall", "viewer.desk", "operator.ann"]) {
        let _router = site.router();
        let heard = Heard::of(&site.session("viewer.desk"), "plumbline/v1/**");
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let forged = "plumbline/v1/alpha/course";
        for party in ["viewer.wall", "operator.ann"] {
            let ground = site.session(party);
            // The answer comes after what was put before the question, and the vehicle's own after both.
            until("an answer", || {
                ground.put(forged, "forged").wait().unwrap();
                !ask(&ground, ATTITUDE).is_empty()
            });
        }
        until("alpha", || {
            alpha.publish();
            heard.has(ATTITUDE)
        });
        assert!(!heard.has(forged));
        until("the same from alpha", || {
            alpha.session.put(forged, "true").wait().unwrap();
            heard.has(forged)
        });
    }
}

#[test]
fn a_revoked_party_may_do_nothing_once_the_router_has_the_new_list() {
    for site in Site::both(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let stolen = site.copy_of("vehicle.beta");
        let beta_attitude = "plumbline/v1/beta/attitude";
        let hears_beta = |revoked: bool| {
            let _router = site.router();
            let heard = Heard::of(&site.session("viewer.wall"), "plumbline/v1/**");
            let (alpha, beta) = (site.session("vehicle.alpha"), site.open(stolen.path()).unwrap());
            until("alpha", || {
                beta.put(beta_attitude, "level").wait().unwrap();
                alpha.put(ATTITUDE, "level").wait().unwrap();
                heard.all().iter().filter(|key| *key == ATTITUDE).count() > 10 && (revoked || heard.has(beta_attitude))
            });
            heard.has(beta_attitude)
        };
        assert!(hears_beta(false));
        site.revoke("vehicle.beta");
        assert!(!hears_beta(true));
    }
}

#[test]
fn a_vehicle_that_starts_before_its_router_is_heard_when_it_comes() {
    for site in Site::both(&["vehicle.alpha", "viewer.wall"]) {
        let config = site.configuration(&site.path("vehicle.alpha"));
        let early = std::thread::spawn(move || zenoh::open(config).wait().unwrap());
        std::thread::sleep(std::time::Duration::from_millis(500));
        assert!(!early.is_finished());
        let _router = site.router();
        let alpha = early.join().unwrap();
        let heard = Heard::of(&site.session("viewer.wall"), "plumbline/v1/**");
        until("the vehicle", || {
            alpha.put(ATTITUDE, "level").wait().unwrap();
            heard.has(ATTITUDE)
        });
    }
}
