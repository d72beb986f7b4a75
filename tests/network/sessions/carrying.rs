//! Hosts of a split system: who may take whose ticks, and nobody else, with real sessions.
use super::site::{Heard, Site, ask, until};
use zenoh::{Session, Wait};

const CARRY: &str = "plumbline/v1/board/@carry";
const KEPT: &str = "plumbline/v1/board/@carry?from=0;to=9";
const ATTITUDE: &str = "plumbline/v1/board/attitude";

/// Publishes ticks and answers for those that are kept.
struct Board {
    session: Session,
    asked: Heard,
}

impl Board {
    fn of(session: Session) -> Self {
        let asked = Heard::default();
        let to = asked.clone();
        let answer = move |query: zenoh::query::Query| {
            to.add(query.key_expr().as_str());
            query.reply(CARRY, "ticks").wait().unwrap();
        };
        session.declare_queryable(CARRY).callback(answer).background().wait().unwrap();
        Self { session, asked }
    }

    fn publish(&self) {
        for key in [CARRY, ATTITUDE] {
            self.session.put(key, "ticks").wait().unwrap();
        }
    }
}

/// Hosts of a split system and others, with board where it connects to a router and where it listens itself.
fn places() -> Vec<Carrier> {
    [false, true].map(Carrier::new).into()
}

struct Carrier {
    site: Site,
    board: Board,
    _router: Option<Session>,
}

impl Carrier {
    fn new(listens: bool) -> Self {
        let site = site();
        let router = (!listens).then(|| site.router());
        let session = if listens { site.listening("vehicle.board") } else { site.session("vehicle.board") };
        Self { site, board: Board::of(session), _router: router }
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
fn the_host_that_imports_hears_ticks_and_is_given_those_that_are_kept() {
    for Carrier { site, board, _router } in places() {
        let base = site.session("vehicle.base");
        let heard = Heard::of(&base, CARRY);
        until("ticks", || {
            board.publish();
            heard.has(CARRY)
        });
        until("those that are kept", || ask(&base, KEPT) == [CARRY]);
        // It is a host of the system, and no reader of telemetry.
        let overheard = Heard::of(&base, "plumbline/v1/**");
        let again = Heard::of(&base, CARRY);
        until("more ticks", || {
            board.publish();
            again.all().len() > 10
        });
        assert!(!overheard.has(ATTITUDE), "{:?}", overheard.all());
    }
}

#[test]
fn nobody_else_hears_ticks_or_is_given_any() {
    for Carrier { site, board, _router } in places() {
        let base = Heard::of(&site.session("vehicle.base"), CARRY);
        let others = ["vehicle.other", "viewer.wall", "operator.ann"].map(|party| site.session(party));
        let keys = [CARRY, "plumbline/v1/*/@carry", "plumbline/v1/**"];
        let overheard: Vec<_> = others.iter().flat_map(|other| keys.map(|key| Heard::of(other, key))).collect();
        let viewer = Heard::of(&others[1], ATTITUDE);
        until("base and viewer", || {
            board.publish();
            base.all().len() > 10 && viewer.has(ATTITUDE)
        });
        assert!(overheard.iter().all(|heard| !heard.has(CARRY)));
        assert_eq!(board.asked.all(), Vec::<String>::new());
        for other in &others {
            for key in [KEPT, "plumbline/v1/*/@carry?from=0;to=9", "plumbline/v1/board/**"] {
                assert!(!ask(other, key).contains(&CARRY.to_owned()), "{key}");
            }
        }
        assert_eq!(board.asked.all(), Vec::<String>::new());
    }
}

#[test]
fn nobody_carries_in_the_name_of_another() {
    let site = site();
    let _router = site.router();
    let base = site.session("vehicle.base");
    let heard = Heard::of(&base, CARRY);
    let own = "plumbline/v1/other/attitude";
    let viewer = Heard::of(&site.session("viewer.wall"), own);
    let forged = Board::of(site.session("vehicle.other"));
    // In this order on one connection: when its own has come, the forged ones will not.
    until("what is its own", || {
        forged.publish();
        forged.session.put(own, "level").wait().unwrap();
        viewer.has(own)
    });
    assert_eq!(ask(&base, KEPT), Vec::<String>::new());
    assert_eq!((heard.all(), forged.asked.all()), (vec![], vec![]));
    let board = Board::of(site.session("vehicle.board"));
    until("the same from board", || {
        board.publish();
        heard.has(CARRY)
    });
}

#[test]
fn a_host_that_was_revoked_is_brought_nothing() {
    let site = site();
    let stolen = site.copy_of("vehicle.base");
    site.revoke("vehicle.base");
    let _router = site.router();
    let base = site.open(stolen.path()).unwrap();
    let heard = Heard::of(&base, CARRY);
    let viewer = Heard::of(&site.session("viewer.wall"), ATTITUDE);
    let board = Board::of(site.session("vehicle.board"));
    until("the viewer", || {
        board.publish();
        viewer.all().len() > 10
    });
    assert_eq!((ask(&base, KEPT), heard.all(), board.asked.all()), (vec![], vec![], vec![]));
}

#[test]
fn nobody_imports_from_who_is_not_there() {
    let site = Site::new(&["vehicle.board"]);
    let [base, typo] = ["vehicle.base", "vehicle.baord"].map(|party| party.parse().unwrap());
    let error = site.keys.issue(&base, &[], &[typo], 30, false).unwrap_err();
    assert!(error.to_string().contains("no vehicle.baord"), "{error}");
    assert!(!site.path("vehicle.base").exists());
}
