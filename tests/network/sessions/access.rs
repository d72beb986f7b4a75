//! Permissions of each role at a router that uses the access list written by `plumb keys`.
use super::site::{Received, Site, Vehicle, query_keys, query_live_tokens, wait_for};
use zenoh::Wait;

const ATTITUDE: &str = "plumbline/v1/alpha/attitude";
const SWAP: &str = "plumbline/v1/alpha/command/swap";

#[test]
fn viewer_reads_telemetry_schema_and_liveliness() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "viewer.wall"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let viewer = site.session("viewer.wall");
        for key in [ATTITUDE, "plumbline/v1/*/attitude", "plumbline/v1/**"] {
            let received = Received::subscribe(&viewer, key);
            wait_for(key, || {
                alpha.publish();
                received.contains(ATTITUDE)
            });
        }
        for (queried, replied) in [
            (ATTITUDE, ATTITUDE),
            ("plumbline/v1/*/attitude", ATTITUDE),
            ("plumbline/v1/alpha/*", ATTITUDE),
            ("plumbline/v1/alpha/schema", "plumbline/v1/alpha/schema"),
        ] {
            wait_for(queried, || query_keys(&viewer, queried).iter().any(|key| key == replied));
        }
        let live = "plumbline/v1/alpha/@live/fuser";
        wait_for("a liveliness token", || {
            query_live_tokens(&viewer, "plumbline/v1/*/@live/**").iter().any(|key| key == live)
        });
        let alive = Received::subscribe_liveliness(&viewer, "plumbline/v1/*/@live/*");
        wait_for("a liveliness message", || alive.contains(live));
    }
}

#[test]
fn viewer_cannot_command_through_any_key_expression() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "viewer.wall", "operator.ann"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let (viewer, operator) = (site.session("viewer.wall"), site.session("operator.ann"));
        // Both sessions are connected, so a missing reply below is due to the access list.
        for session in [&viewer, &operator] {
            wait_for("a reply", || !query_keys(session, ATTITUDE).is_empty());
        }
        let matching_keys = [
            SWAP,
            "plumbline/v1/*/command/swap",
            "plumbline/v1/alpha/command/*",
            "plumbline/v1/alpha/**",
            "plumbline/**",
            "**",
        ];
        for key in matching_keys {
            assert_eq!(query_keys(&viewer, key), Vec::<String>::new(), "{key}");
        }
        assert_eq!(alpha.commands.keys(), Vec::<String>::new());
        assert_eq!(query_keys(&operator, SWAP), [SWAP]);
        assert_eq!(alpha.commands.keys(), [SWAP]);
    }
}

#[test]
fn operator_commands_one_vehicle_per_query() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "vehicle.beta", "operator.ann"]) {
        let _router = site.router();
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let beta = Vehicle::new(site.session("vehicle.beta"), "beta");
        let operator = site.session("operator.ann");
        let beta_swap = "plumbline/v1/beta/command/swap";
        wait_for("replies of both vehicles", || query_keys(&operator, "plumbline/v1/*/attitude").len() == 2);
        for key in ["plumbline/v1/*/command/swap", "plumbline/v1/**"] {
            assert_eq!(query_keys(&operator, key), Vec::<String>::new(), "{key}");
        }
        assert_eq!(query_keys(&operator, beta_swap), [beta_swap]);
        assert_eq!((alpha.commands.keys(), beta.commands.keys()), (vec![], vec![beta_swap.to_owned()]));
    }
}

#[test]
fn vehicle_publishes_only_below_its_own_name() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let _router = site.router();
        let received = Received::subscribe(&site.session("viewer.wall"), "plumbline/v1/**");
        let beta = site.session("vehicle.beta");
        // Messages on one connection stay in order, so the forged ones have been rejected once
        // beta's own message arrives.
        wait_for("beta's own message", || {
            for key in [ATTITUDE, "plumbline/v1/*/attitude", "plumbline/v1/beta/attitude"] {
                beta.put(key, "forged").wait().unwrap();
            }
            received.contains("plumbline/v1/beta/attitude")
        });
        assert!(received.keys().iter().all(|key| key == "plumbline/v1/beta/attitude"), "{:?}", received.keys());
        let alpha = site.session("vehicle.alpha");
        wait_for("the same message from alpha", || {
            alpha.put(ATTITUDE, "true").wait().unwrap();
            received.contains(ATTITUDE)
        });
    }
}

#[test]
fn vehicle_receives_nothing_from_other_vehicle() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let _router = site.router();
        let beta = site.session("vehicle.beta");
        let received_by_beta = Received::subscribe(&beta, "plumbline/v1/**");
        let received = Received::subscribe(&site.session("viewer.wall"), "plumbline/v1/**");
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        wait_for("ten attitudes", || {
            alpha.publish();
            received.keys().len() > 10
        });
        assert_eq!(query_keys(&beta, ATTITUDE), Vec::<String>::new());
        assert_eq!(query_keys(&beta, SWAP), Vec::<String>::new());
        assert_eq!((received_by_beta.keys(), alpha.commands.keys()), (vec![], vec![]));
    }
}

#[test]
fn vehicle_cannot_reply_or_declare_for_other_vehicle() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "vehicle.beta", "operator.ann"]) {
        let _router = site.router();
        let operator = site.session("operator.ann");
        let alive = Received::subscribe_liveliness(&operator, "plumbline/v1/*/@live/*");
        // Makes all the declarations of alpha, but with the certificate of beta.
        let beta = site.session("vehicle.beta");
        let forged = Vehicle::new(beta.clone(), "alpha");
        let intercepted = Received::default();
        let recorder = intercepted.clone();
        let wildcard = beta.declare_queryable("plumbline/v1/*/command/swap");
        wildcard.callback(move |query| recorder.add(query.key_expr().as_str())).background().wait().unwrap();
        let _own = Vehicle::new(beta, "beta");
        wait_for("beta's own token", || alive.contains("plumbline/v1/beta/@live/fuser"));
        wait_for("beta's own reply", || !query_keys(&operator, "plumbline/v1/beta/attitude").is_empty());
        assert_eq!(query_keys(&operator, ATTITUDE), Vec::<String>::new());
        assert_eq!(query_keys(&operator, SWAP), Vec::<String>::new());
        assert!(!alive.keys().iter().any(|key| key.contains("alpha")), "{:?}", alive.keys());
        assert_eq!((forged.commands.keys(), intercepted.keys()), (vec![], vec![]));

        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        wait_for("alpha's own token", || alive.contains("plumbline/v1/alpha/@live/fuser"));
        wait_for("alpha's own reply", || query_keys(&operator, SWAP) == [SWAP]);
        assert!(!alpha.commands.keys().is_empty() && forged.commands.keys().is_empty());
    }
}

#[test]
fn ground_parties_cannot_publish() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "viewer.wall", "viewer.desk", "operator.ann"]) {
        let _router = site.router();
        let received = Received::subscribe(&site.session("viewer.desk"), "plumbline/v1/**");
        let alpha = Vehicle::new(site.session("vehicle.alpha"), "alpha");
        let forged = "plumbline/v1/alpha/course";
        for party in ["viewer.wall", "operator.ann"] {
            let ground = site.session(party);
            // Messages on one connection stay in order, so the reply follows the forged message,
            // and the vehicle's own message follows the reply.
            wait_for("a reply", || {
                ground.put(forged, "forged").wait().unwrap();
                !query_keys(&ground, ATTITUDE).is_empty()
            });
        }
        wait_for("telemetry of alpha", || {
            alpha.publish();
            received.contains(ATTITUDE)
        });
        assert!(!received.contains(forged));
        wait_for("the same message from alpha", || {
            alpha.session.put(forged, "true").wait().unwrap();
            received.contains(forged)
        });
    }
}

#[test]
fn revoked_party_is_blocked_by_updated_list() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "vehicle.beta", "viewer.wall"]) {
        let stolen = site.copy_folder("vehicle.beta");
        let beta_attitude = "plumbline/v1/beta/attitude";
        let viewer_receives_beta = |revoked: bool| {
            let _router = site.router();
            let received = Received::subscribe(&site.session("viewer.wall"), "plumbline/v1/**");
            let (alpha, beta) = (site.session("vehicle.alpha"), site.open(stolen.path()).unwrap());
            wait_for("telemetry of alpha", || {
                beta.put(beta_attitude, "level").wait().unwrap();
                alpha.put(ATTITUDE, "level").wait().unwrap();
                received.keys().iter().filter(|key| *key == ATTITUDE).count() > 10
                    && (revoked || received.contains(beta_attitude))
            });
            received.contains(beta_attitude)
        };
        assert!(viewer_receives_beta(false));
        site.revoke("vehicle.beta");
        assert!(!viewer_receives_beta(true));
    }
}

#[test]
fn vehicle_started_before_router_connects_later() {
    for site in Site::with_vehicle_clients_and_peers(&["vehicle.alpha", "viewer.wall"]) {
        let config = site.configuration(&site.path("vehicle.alpha"));
        let early = std::thread::spawn(move || zenoh::open(config).wait().unwrap());
        std::thread::sleep(std::time::Duration::from_millis(500));
        assert!(!early.is_finished());
        let _router = site.router();
        let alpha = early.join().unwrap();
        let received = Received::subscribe(&site.session("viewer.wall"), "plumbline/v1/**");
        wait_for("telemetry of the vehicle", || {
            alpha.put(ATTITUDE, "level").wait().unwrap();
            received.contains(ATTITUDE)
        });
    }
}
