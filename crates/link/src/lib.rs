//! The network: access to Zenoh for the gateway on board and for remote clients.
//!
//! Input, output: bytes under keys.
//!
//! Time: every wait has a timeout.
//!
//! Failure: if the network is missing, slow or blocked, messages are lost, but no call blocks
//! because of it.
//!
//! There is no multicast and no gossip: only the configured endpoints are contacted. No other crate
//! uses Zenoh directly.
//!
//! | module | contents |
//! | --- | --- |
//! | [`endpoints`] | endpoints and their security |
//! | `admission` | limits on incoming connections, and access control without certificates |
//! | `diagnosis` | reasons why an endpoint is unreachable |
//! | [`publisher`] | the vehicle's side: messages, responses, liveliness |
//! | [`remote`] | the remote side: subscriptions and queries |
#![forbid(unsafe_code)]

mod admission;
mod diagnosis;
pub mod endpoints;
mod error;
pub mod publisher;
pub mod remote;

use std::time::{Duration, Instant};

use zenoh::{Session, Wait};

pub use admission::MAX_SESSIONS;
pub use endpoints::Endpoints;
pub use error::LinkError;
pub use publisher::{IncomingQuery, Liveliness, MessagePublisher, QueryHandler};
pub use remote::{MessageStream, RemoteMessage};

/// Timeout for closing a session. A session that is still open after that ends with the process.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(200);
/// Delay before a session is closed, so that messages in transit can arrive. QUIC discards them
/// when the connection closes. The delay covers a few round trips of 100 ms.
const DELIVERY_DELAY: Duration = Duration::from_millis(300);
/// Time for which a client retries if it receives no answer. A listener accepts connections one
/// after another, and waits up to 30 s for one that stalls during the handshake
/// (eclipse-zenoh/zenoh#2719). The time must therefore exceed 30 s.
const UNANSWERED_TIMEOUT: Duration = Duration::from_secs(40);
/// Time for which a client retries after rejections or local errors.
const REJECTED_TIMEOUT: Duration = Duration::from_secs(3);
/// Failed attempts that last at least this long count as unanswered. Without an answer, Zenoh gives
/// up only after 10 s.
const MIN_UNANSWERED_ATTEMPT: Duration = Duration::from_secs(5);
/// Time to wait for a session at a port that is open but busy. In this time Zenoh can reject about
/// 2,500 stalled connections, at 250 per second.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Delay between two attempts to open a session.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Network session, as a peer or as a client.
#[derive(Debug, Clone)]
pub struct Link {
    session: Session,
    is_secured: bool,
}

impl Link {
    /// Opens a session.
    ///
    /// A peer returns immediately and keeps connecting in the background. A client returns once it
    /// is connected.
    ///
    /// # Errors
    ///
    /// Fails if an endpoint cannot be opened or, for a client, cannot be reached in time.
    pub fn open(endpoints: &Endpoints) -> Result<Self, LinkError> {
        let config = endpoints.config()?;
        let started = Instant::now();
        loop {
            let attempt_started = Instant::now();
            let cause = match zenoh::open(config.clone()).wait() {
                Ok(session) => return Ok(Self { session, is_secured: endpoints.are_secured() }),
                Err(cause) => cause.to_string(),
            };
            if !endpoints.client {
                // Zenoh appends its source location to the message.
                return Err(LinkError::Open {
                    endpoints: endpoints.to_string(),
                    cause: cause.split(" at /").next().unwrap_or_default().into(),
                });
            }
            let was_answered = attempt_started.elapsed() < MIN_UNANSWERED_ATTEMPT;
            if started.elapsed() > if was_answered { REJECTED_TIMEOUT } else { UNANSWERED_TIMEOUT } {
                return Err(LinkError::Unreachable {
                    limit_s: started.elapsed().as_secs(),
                    reason: diagnosis::diagnose(endpoints),
                });
            }
            std::thread::sleep(RETRY_INTERVAL);
        }
    }

    /// Opens a session and waits up to `limit` until it is connected.
    ///
    /// # Errors
    ///
    /// Fails if no endpoint is connected in time. The error contains the reason for each endpoint.
    pub fn connect(endpoints: &Endpoints, limit: Duration) -> Result<Self, LinkError> {
        let link = Self::open(endpoints)?;
        // A listener that is busy with stalled connections may accept this session later.
        if link.wait_for_peer(limit) || diagnosis::is_port_open(endpoints) && link.wait_for_peer(BUSY_TIMEOUT) {
            return Ok(link);
        }
        link.close();
        Err(LinkError::Unreachable { limit_s: limit.as_secs(), reason: diagnosis::diagnose(endpoints) })
    }

    /// Waits up to `limit` for a connection to a peer. Returns `true` if there is one.
    pub fn wait_for_peer(&self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        while self.peer_count() == 0 {
            if Instant::now() > deadline {
                return false;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        true
    }

    /// Returns the identity of this session, as text for keys and as bytes.
    pub fn identity(&self) -> (String, [u8; 16]) {
        let id = self.session.zid();
        (id.to_string(), id.to_le_bytes())
    }

    /// Returns the number of connected peers and routers.
    pub fn peer_count(&self) -> usize {
        let info = self.session.info();
        info.peers_zid().wait().count() + info.routers_zid().wait().count()
    }

    /// Returns `true` if a router is connected.
    pub fn has_router(&self) -> bool {
        self.session.info().routers_zid().wait().next().is_some()
    }

    /// Waits for messages in transit, then closes the session. Closing notifies the peers
    /// immediately.
    pub fn close(&self) {
        if self.is_secured && self.peer_count() > 0 {
            std::thread::sleep(DELIVERY_DELAY);
        }
        let session = self.session.clone();
        let closing = std::thread::spawn(move || {
            // A session that cannot be closed ends with the process.
            let _ = session.close().wait();
        });
        let deadline = Instant::now() + CLOSE_TIMEOUT;
        while !closing.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

fn at_key(operation: &'static str, key: &str) -> impl Fn(zenoh::Error) -> LinkError {
    move |cause| LinkError::Key { operation, key: key.into(), cause: cause.to_string().into() }
}
