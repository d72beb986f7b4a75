//! The network: the only crate that names Zenoh, for the gateway on board and for whoever looks at a vehicle from elsewhere.
//!
//! Input, output: bytes under keys. Time: every wait has a limit. Failure: a network that is not there, is slow or is blocked shows
//! as messages that do not arrive; nothing here waits for it. No multicast, no gossip: only the endpoints named are spoken to.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`ends`] | the endpoints, and what secures them |
//! | [`outlet`] | what a vehicle shows: messages, answers, signs of life |
//! | [`remote`] | a vehicle seen from elsewhere |
#![forbid(unsafe_code)]

pub mod ends;
pub mod outlet;
pub mod remote;

use std::time::{Duration, Instant};

use zenoh::{Session, Wait};

pub use ends::Ends;
pub use outlet::{Answering, Outlet, Question, Sign};
pub use remote::{Arrival, Stream};

/// How long a closing session may take; the process ends in any case.
const CLOSE_LIMIT: Duration = Duration::from_millis(200);

/// A place in the network.
#[derive(Debug, Clone)]
pub struct Link {
    session: Session,
}

impl Link {
    /// Takes a place in the network. Whom it is to connect to is tried for ever, in the background.
    pub fn open(ends: &Ends) -> Result<Self, LinkError> {
        let failed = |cause: zenoh::Error| {
            let (at, cause) = (ends.to_string(), cause.to_string());
            // After the words comes the place in Zenoh's source.
            let cause = cause.split(" at /").next().unwrap_or_default().into();
            if ends.client { LinkError::Connect { ends: at, cause } } else { LinkError::Open { ends: at, cause } }
        };
        Ok(Self { session: zenoh::open(ends.config()?).wait().map_err(failed)? })
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

    /// How many are connected.
    pub fn neighbours(&self) -> usize {
        let info = self.session.info();
        info.peers_zid().wait().count() + info.routers_zid().wait().count()
    }

    /// Leaves, so that others know at once.
    pub fn close(&self) {
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
    #[error("opening {ends}: {cause}; is the port taken, or a certificate not there?")]
    Open {
        /// The endpoints.
        ends: String,
        /// What Zenoh says.
        cause: String,
    },
    /// A client was not let in.
    #[error(
        "connecting to {ends}: {cause} does a gateway or a router listen there, and has the authority of these keys signed its certificate, for this address?"
    )]
    Connect {
        /// The endpoints.
        ends: String,
        /// What Zenoh says.
        cause: String,
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
    /// Nobody is connected.
    #[error(
        "connecting to {ends}: nobody is there; does the gateway run, and is that where `plumb ps` says it listens?"
    )]
    Nobody {
        /// The endpoints.
        ends: String,
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
