//! Whoever asks learns whether there is an answer, why there is none, or that nobody said anything.

use std::{net::TcpListener, sync::Mutex, time::Duration};

use link::{Endpoints, Link, LinkError, IncomingQuery};
use wire::{
    command::ControlMessage,
    v1::{Services, SwapAnswer},
};
use zenoh::Wait;

const KEY: &str = "asking/thing";
/// For answers that come.
const LIMIT: Duration = Duration::from_secs(20);

/// Where nobody listens.
fn endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

/// One who can ask there.
fn asking(endpoint: String) -> Link {
    let asking = Link::open(&Endpoints::with_connect(&[endpoint])).unwrap();
    assert!(asking.wait_for_peer(LIMIT));
    asking
}

/// One who answers so, and one who can ask.
fn answering(answer: impl Fn(IncomingQuery) + Send + Sync + 'static) -> (impl Sized, Link) {
    let endpoint = endpoint();
    let board = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
    let answering = board.handle_queries(KEY, answer).unwrap();
    ((board, answering), asking(endpoint))
}

fn services() -> Services {
    Services { t_now_ns: 7, services: Vec::new() }
}

#[test]
fn a_refusal_reaches_the_caller_with_its_reason() {
    let (_board, asking) = answering(|question| question.reject("the door\u{1b}[2J is closed"));
    let error = asking.query_one::<Services>(KEY, Vec::new(), LIMIT).unwrap_err();
    // What a terminal would obey is left out.
    assert!(matches!(&error, LinkError::Rejected { reason, .. } if reason == "the door[2J is closed"), "{error}");
}

#[test]
fn an_answer_counts_more_than_a_refusal() {
    let (_board, asking) = answering(|question| {
        question.reject("not by me");
        question.reply(KEY, Services::NAME, services().to_bytes());
    });
    assert_eq!(asking.query_one::<Services>(KEY, Vec::new(), LIMIT).unwrap(), services());
}

#[test]
fn silence_is_no_refusal() {
    let kept = Mutex::new(Vec::new());
    let (_board, asking) = answering(move |question| kept.lock().unwrap().push(question));
    let error = asking.query_one::<SwapAnswer>(KEY, Vec::new(), Duration::from_millis(300)).unwrap_err();
    assert!(matches!(error, LinkError::NoResponse { .. }), "{error}");
    assert!(asking.query(KEY, Vec::new(), Duration::from_millis(300)).unwrap().is_empty());
}

#[test]
fn an_error_of_zenoh_itself_is_no_refusal() {
    let endpoint = endpoint();
    let mut config = zenoh::Config::default();
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    let board = zenoh::open(config).wait().unwrap();
    let timeout = |query: zenoh::query::Query| query.reply_err("Timeout").wait().unwrap();
    let _answering = board.declare_queryable(KEY).callback(timeout).wait().unwrap();
    let error = asking(endpoint).query_one::<Services>(KEY, Vec::new(), LIMIT).unwrap_err();
    assert!(matches!(error, LinkError::NoResponse { .. }), "{error}");
}
