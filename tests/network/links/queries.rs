//! Outcomes of a query: a reply, a rejection with its reason, or no response.

use std::{net::TcpListener, sync::Mutex, time::Duration};

use link::{Endpoints, IncomingQuery, Link, LinkError};
use wire::{
    command::ControlMessage,
    v1::{Services, SwapAnswer},
};
use zenoh::Wait;

const KEY: &str = "test/query";
/// Timeout for replies that are expected.
const REPLY_TIMEOUT: Duration = Duration::from_secs(20);

/// Returns an endpoint at which no process listens.
fn endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

/// Opens a link that can query `endpoint`.
fn open_client(endpoint: String) -> Link {
    let client = Link::open(&Endpoints::with_connect(&[endpoint])).unwrap();
    assert!(client.wait_for_peer(REPLY_TIMEOUT));
    client
}

/// Opens a link that handles queries with `handler`, and one that can query it.
fn open_pair(handler: impl Fn(IncomingQuery) + Send + Sync + 'static) -> (impl Sized, Link) {
    let endpoint = endpoint();
    let board = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
    let queryable = board.handle_queries(KEY, handler).unwrap();
    ((board, queryable), open_client(endpoint))
}

fn services() -> Services {
    Services { t_now_ns: 7, services: Vec::new() }
}

#[test]
fn rejection_reaches_caller_with_reason() {
    let (_board, client) = open_pair(|query| query.reject("swaps are\u{1b}[2J disabled"));
    let error = client.query_one::<Services>(KEY, Vec::new(), REPLY_TIMEOUT).unwrap_err();
    // The reason is escaped when printed.
    assert!(
        matches!(&error, LinkError::Rejected { reason, .. } if *reason == *"swaps are\u{1b}[2J disabled"),
        "{error}"
    );
    assert!(error.to_string().ends_with(r"rejected: swaps are\u{1b}[2J disabled"), "{error}");
}

#[test]
fn reply_takes_precedence_over_rejection() {
    let (_board, client) = open_pair(|query| {
        query.reject("another queryable replies");
        query.reply(KEY, Services::NAME, services().to_bytes());
    });
    assert_eq!(client.query_one::<Services>(KEY, Vec::new(), REPLY_TIMEOUT).unwrap(), services());
}

#[test]
fn missing_reply_is_reported_as_no_response() {
    let pending = Mutex::new(Vec::new());
    let (_board, client) = open_pair(move |query| pending.lock().unwrap().push(query));
    let error = client.query_one::<SwapAnswer>(KEY, Vec::new(), Duration::from_millis(300)).unwrap_err();
    assert!(matches!(error, LinkError::NoResponse { .. }), "{error}");
    assert!(client.query(KEY, Vec::new(), Duration::from_millis(300)).unwrap().is_empty());
}

#[test]
fn zenoh_error_is_reported_as_no_response() {
    let endpoint = endpoint();
    let mut config = zenoh::Config::default();
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    let board = zenoh::open(config).wait().unwrap();
    let timeout = |query: zenoh::query::Query| query.reply_err("Timeout").wait().unwrap();
    let _queryable = board.declare_queryable(KEY).callback(timeout).wait().unwrap();
    let error = open_client(endpoint).query_one::<Services>(KEY, Vec::new(), REPLY_TIMEOUT).unwrap_err();
    assert!(matches!(error, LinkError::NoResponse { .. }), "{error}");
}

#[test]
fn number_of_responses_to_a_query_is_limited() {
    let (_board, client) = open_pair(|query| (0..3000).for_each(|_| query.reply_raw(KEY, Vec::new())));
    assert_eq!(client.query(KEY, Vec::new(), REPLY_TIMEOUT).unwrap().len(), 1024);
}
