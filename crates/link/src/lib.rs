//! The network: the only crate that names Zenoh, for the gateway on board and for whoever looks at a vehicle from elsewhere.
//!
//! Input, output: bytes under keys. Time: every wait has a limit. Failure: a network that is not there, is slow or is blocked shows
//! as messages that do not arrive; nothing here waits for it. No multicast, no gossip: only the endpoints named are spoken to.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`endpoints`] | the endpoints, and what secures them |
//! | `guard` | how much may come in, and what those may do who show no certificate |
//! | `reach` | why somebody could not be reached |
//! | [`outlet`] | what a vehicle shows: messages, answers, signs of life |
//! | [`remote`] | a vehicle seen from elsewhere |
#![forbid(unsafe_code)]

pub mod endpoints;
mod guard;
pub mod outlet;
mod reach;
pub mod remote;

use std::time::{Duration, Instant};

use zenoh::{Session, Wait};

pub use endpoints::Endpoints;
pub use guard::SESSIONS_MAX;
pub use outlet::{Answering, Liveliness, Outlet, Question};
pub use remote::{Arrival, Stream};

/// How long a closing session may take; the process ends in any case.
const CLOSE_LIMIT: Duration = Duration::from_millis(200);
/// What was sent just before is given so much time to arrive before a session closes: QUIC forgets it with the connection. Some round trips
/// of 100 ms.
const SETTLING: Duration = Duration::from_millis(300);
/// How long a client tries where nobody answers. Whoever listens accepts one after the other, and waits 30 s for one who has begun to
/// connect and does not go on (eclipse-zenoh/zenoh#2719).
const SILENCE_LIMIT: Duration = Duration::from_secs(40);
/// How long a client tries where it is turned away, or cannot even begin.
const REFUSAL_LIMIT: Duration = Duration::from_secs(3);
/// An attempt that took longer was not answered; Zenoh gives it up after 10 s.
const ANSWER_LIMIT: Duration = Duration::from_secs(5);
/// How long one waits for its turn where somebody is there who does not answer yet; Zenoh turns away some 250 connections a second.
const BUSY_LIMIT: Duration = Duration::from_secs(10);
/// Between two attempts.
const PAUSE: Duration = Duration::from_millis(500);

/// A place in the network.
#[derive(Debug, Clone)]
pub struct Link {
    session: Session,
    is_secured: bool,
}

impl Link {
    /// Takes a place in the network. Whom it is to connect to is tried for ever, in the background; a client is there when this returns.
    pub fn open(endpoints: &Endpoints) -> Result<Self, LinkError> {
        let config = endpoints.config()?;
        let began = Instant::now();
        loop {
            let tried = Instant::now();
            let cause = match zenoh::open(config.clone()).wait() {
                Ok(session) => return Ok(Self { session, is_secured: endpoints.are_secured() }),
                Err(cause) => cause.to_string(),
            };
            if !endpoints.client {
                // After the words comes the place in Zenoh's source.
                return Err(LinkError::Open {
                    endpoints: endpoints.to_string(),
                    cause: cause.split(" at /").next().unwrap_or_default().into(),
                });
            }
            let answered = tried.elapsed() < ANSWER_LIMIT;
            if began.elapsed() > if answered { REFUSAL_LIMIT } else { SILENCE_LIMIT } {
                return Err(LinkError::Unreached { limit_s: began.elapsed().as_secs(), why: reach::why(endpoints) });
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Takes a place from which somebody is reached, within `limit`; else says why not.
    pub fn reach(endpoints: &Endpoints, limit: Duration) -> Result<Self, LinkError> {
        let link = Self::open(endpoints)?;
        // One that is busy with connections that say nothing gets to this one in its turn.
        if link.await_somebody(limit) || reach::is_somebody_there(endpoints) && link.await_somebody(BUSY_LIMIT) {
            return Ok(link);
        }
        link.close();
        Err(LinkError::Unreached { limit_s: limit.as_secs(), why: reach::why(endpoints) })
    }

    /// Waits until somebody is connected, no longer than `limit`.
    pub fn await_somebody(&self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        while self.neighbours() == 0 {
            if Instant::now() > deadline {
                return false;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        true
    }

    /// The identity of this place in the network: as keys name it, and its bytes.
    pub fn identity(&self) -> (String, [u8; 16]) {
        let id = self.session.zid();
        (id.to_string(), id.to_le_bytes())
    }

    /// How many are connected.
    pub fn neighbours(&self) -> usize {
        let info = self.session.info();
        info.peers_zid().wait().count() + info.routers_zid().wait().count()
    }

    /// Leaves, so that others know at once; what was sent before arrives.
    pub fn close(&self) {
        if self.is_secured && self.neighbours() > 0 {
            std::thread::sleep(SETTLING);
        }
        let session = self.session.clone();
        let closing = std::thread::spawn(move || {
            // One that cannot be closed ends with the process.
            let _ = session.close().wait();
        });
        let deadline = Instant::now() + CLOSE_LIMIT;
        while !closing.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Why the network did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The place could not be taken.
    #[error("opening {endpoints}: {cause}; is the port taken, or a certificate not there?")]
    Open {
        /// The endpoints.
        endpoints: String,
        /// What Zenoh says.
        cause: String,
    },
    /// Nobody was reached.
    #[error("connecting, for {limit_s} s: {why}")]
    Unreached {
        /// How long it was tried, s.
        limit_s: u64,
        /// Each endpoint and what is found there.
        why: String,
    },
    /// A certificate of one's own that does not serve.
    #[error(transparent)]
    Certificate(#[from] keys::KeysError),
    /// An address that QUIC does not connect to.
    #[error(
        "connecting to {endpoint}: over QUIC, Zenoh connects to no IPv6 address; name the host by its DNS name, or by an IPv4 address"
    )]
    Ipv6 {
        /// The endpoint.
        endpoint: String,
    },
    /// The endpoints or what secures them cannot be.
    #[error("setting {what}: {cause}")]
    Config {
        /// What was being set.
        what: &'static str,
        /// What is wrong with it.
        cause: String,
    },
    /// Every port that was tried is taken.
    #[error("listening at {endpoint}: this port and the {tried} after it are taken; name another in [gateway] listen")]
    NoPort {
        /// The first one tried.
        endpoint: String,
        /// How many more were.
        tried: u16,
    },
    /// A key could not be used.
    #[error("{doing} {key}: {cause}")]
    Key {
        /// What was being done.
        doing: &'static str,
        /// The key.
        key: String,
        /// What Zenoh says.
        cause: String,
    },
    /// Nobody has answered.
    #[error(
        "asking {key}: nobody answered, {limit_s:.0} s at most; `plumb station` shows the vehicles that one may see"
    )]
    NoAnswer {
        /// The question.
        key: String,
        /// How long it was waited for.
        limit_s: f64,
    },
    /// Whoever was asked does not answer, and says why.
    #[error("asking {key}: refused: {reason}")]
    Refused {
        /// The question.
        key: String,
        /// Why, for people.
        reason: String,
    },
    /// The answer is none.
    #[error("asking {key}: {cause}")]
    Answer {
        /// The question.
        key: String,
        /// What is wrong with it.
        cause: wire::Refusal,
    },
}

fn at_key(doing: &'static str, key: &str) -> impl Fn(zenoh::Error) -> LinkError {
    move |cause| LinkError::Key { doing, key: key.into(), cause: cause.to_string() }
}
