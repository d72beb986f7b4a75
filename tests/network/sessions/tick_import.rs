//! Access to the ticks of a split system: only the authorised host receives them.
use super::site::{Received, Site, query_keys, wait_for};
use zenoh::{Session, Wait};

const CARRY: &str = "plumbline/v1/board/@carry";
const CACHED: &str = "plumbline/v1/board/@carry?from=0;to=9";
const ATTITUDE: &str = "plumbline/v1/board/attitude";

/// Publishes ticks and replies to queries for cached ticks.
struct Board {
    session: Session,
    queries: Received,
}

impl Board {
    fn new(session: Session) -> Self {
        let queries = Received::default();
        let recorder = queries.clone();
        let reply = move |query: zenoh::query::Query| {
            recorder.add(query.key_expr().as_str());
            query.reply(CARRY, "ticks").wait().unwrap();
        };
        session.declare_queryable(CARRY).callback(reply).background().wait().unwrap();
        Self { session, queries }
    }

    fn publish(&self) {
        for key in [CARRY, ATTITUDE] {
            self.session.put(key, "ticks").wait().unwrap();
        }
    }
}

/// Returns two setups: one in which the board connects to a router, and one in which the board
/// itself listens.
fn board_setups() -> Vec<BoardSetup> {
    [false, true].map(BoardSetup::new).into()
}

struct BoardSetup {
    site: Site,
    board: Board,
    _router: Option<Session>,
}

impl BoardSetup {
    fn new(listens: bool) -> Self {
        let site = site();
        let router = (!listens).then(|| site.router());
        let session = if listens { site.listening("vehicle.board") } else { site.session("vehicle.board") };
        Self { site, board: Board::new(session), _router: router }
    }
}

fn site() -> Site {
    let site = Site::new(&["vehicle.other", "viewer.wall", "operator.ann"]);
    let [base, board] = ["vehicle.base", "vehicle.board"].map(|party| party.parse().unwrap());
    site.keys.issue(&board, &["127.0.0.1".parse().unwrap()], &[], 30, false).unwrap();
    site.keys.issue(&base, &[], &[board], 30, false).unwrap();
    site
}

#[test]
fn importing_host_receives_live_and_cached_ticks() {
    for BoardSetup { site, board, _router } in board_setups() {
        let base = site.session("vehicle.base");
        let received = Received::subscribe(&base, CARRY);
        wait_for("ticks", || {
            board.publish();
            received.contains(CARRY)
        });
        wait_for("cached ticks", || query_keys(&base, CACHED) == [CARRY]);
        // The role permits access to ticks but not to telemetry.
        let telemetry = Received::subscribe(&base, "plumbline/v1/**");
        let more_ticks = Received::subscribe(&base, CARRY);
        wait_for("more ticks", || {
            board.publish();
            more_ticks.keys().len() > 10
        });
        assert!(!telemetry.contains(ATTITUDE), "{:?}", telemetry.keys());
    }
}

#[test]
fn unauthorised_clients_receive_no_ticks() {
    for BoardSetup { site, board, _router } in board_setups() {
        let base = Received::subscribe(&site.session("vehicle.base"), CARRY);
        let others = ["vehicle.other", "viewer.wall", "operator.ann"].map(|party| site.session(party));
        let keys = [CARRY, "plumbline/v1/*/@carry", "plumbline/v1/**"];
        let unauthorised: Vec<_> =
            others.iter().flat_map(|other| keys.map(|key| Received::subscribe(other, key))).collect();
        let viewer = Received::subscribe(&others[1], ATTITUDE);
        wait_for("messages at base and viewer", || {
            board.publish();
            base.keys().len() > 10 && viewer.contains(ATTITUDE)
        });
        assert!(unauthorised.iter().all(|received| !received.contains(CARRY)));
        assert_eq!(board.queries.keys(), Vec::<String>::new());
        for other in &others {
            for key in [CACHED, "plumbline/v1/*/@carry?from=0;to=9", "plumbline/v1/board/**"] {
                assert!(!query_keys(other, key).contains(&CARRY.to_owned()), "{key}");
            }
        }
        assert_eq!(board.queries.keys(), Vec::<String>::new());
    }
}

#[test]
fn host_cannot_export_in_name_of_other_host() {
    let site = site();
    let _router = site.router();
    let base = site.session("vehicle.base");
    let received = Received::subscribe(&base, CARRY);
    let own = "plumbline/v1/other/attitude";
    let viewer = Received::subscribe(&site.session("viewer.wall"), own);
    let forged = Board::new(site.session("vehicle.other"));
    // Messages on one connection stay in order, so the forged ones have been rejected once the
    // vehicle's own message arrives.
    wait_for("the vehicle's own message", || {
        forged.publish();
        forged.session.put(own, "level").wait().unwrap();
        viewer.contains(own)
    });
    assert_eq!(query_keys(&base, CACHED), Vec::<String>::new());
    assert_eq!((received.keys(), forged.queries.keys()), (vec![], vec![]));
    let board = Board::new(site.session("vehicle.board"));
    wait_for("the same ticks from the board", || {
        board.publish();
        received.contains(CARRY)
    });
}

#[test]
fn revoked_host_receives_no_ticks() {
    let site = site();
    let stolen = site.copy_folder("vehicle.base");
    site.revoke("vehicle.base");
    let _router = site.router();
    let base = site.open(stolen.path()).unwrap();
    let received = Received::subscribe(&base, CARRY);
    let viewer = Received::subscribe(&site.session("viewer.wall"), ATTITUDE);
    let board = Board::new(site.session("vehicle.board"));
    wait_for("telemetry at the viewer", || {
        board.publish();
        viewer.keys().len() > 10
    });
    assert_eq!((query_keys(&base, CACHED), received.keys(), board.queries.keys()), (vec![], vec![], vec![]));
}

#[test]
fn import_from_unknown_vehicle_is_rejected() {
    let site = Site::new(&["vehicle.board"]);
    let [base, typo] = ["vehicle.base", "vehicle.baord"].map(|party| party.parse().unwrap());
    let error = site.keys.issue(&base, &[], &[typo], 30, false).unwrap_err();
    assert!(error.to_string().contains("no vehicle.baord"), "{error}");
    assert!(!site.path("vehicle.base").exists());
}
