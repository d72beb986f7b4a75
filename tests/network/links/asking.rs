//! Whoever asks learns whether there is an answer, why there is none, or that nobody said anything.

use std::{net::TcpListener, sync::Mutex, time::Duration};

use link::{Endpoints, Link, LinkError, Question};
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
    let asking = Link::open(&Endpoints::connecting(&[endpoint])).unwrap();
    assert!(asking.await_somebody(LIMIT));
    asking
}

/// One who answers so, and one who can ask.
fn answering(answer: impl Fn(Question) + Send + Sync + 'static) -> (impl Sized, Link) {
    let endpoint = endpoint();
    let board = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
    let answering = board.answering(KEY, answer).unwrap();
    ((board, answering), asking(endpoint))
}

fn services() -> Services {
    Services { t_now_ns: 7, services: Vec::new() }
}

#[test]
fn a_refusal_reaches_the_caller_with_its_reason() {
    let (_board, asking) = answering(|question| question.refuse("the door\u{1b}[2J is closed"));
    let error = asking.ask_one::<Services>(KEY, Vec::new(), LIMIT).unwrap_err();
    // What a terminal would obey is left out.
    assert!(matches!(&error, LinkError::Refused { reason, .. } if reason == "the door[2J is closed"), "{error}");
}

#[test]
fn an_answer_counts_more_than_a_refusal() {
    let (_board, asking) = answering(|question| {
        question.refuse("not by me");
        question.answer(KEY, Services::NAME, services().encoded());
    });
    assert_eq!(asking.ask_one::<Services>(KEY, Vec::new(), LIMIT).unwrap(), services());
}

#[test]
fn silence_is_no_refusal() {
    let kept = Mutex::new(Vec::new());
    let (_board, asking) = answering(move |question| kept.lock().unwrap().push(question));
    let error = asking.ask_one::<SwapAnswer>(KEY, Vec::new(), Duration::from_millis(300)).unwrap_err();
    assert!(matches!(error, LinkError::NoAnswer { .. }), "{error}");
    assert!(asking.ask(KEY, Vec::new(), Duration::from_millis(300)).unwrap().is_empty());
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
    let error = asking(endpoint).ask_one::<Services>(KEY, Vec::new(), LIMIT).unwrap_err();
    assert!(matches!(error, LinkError::NoAnswer { .. }), "{error}");
}
