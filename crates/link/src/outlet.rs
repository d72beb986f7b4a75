//! What a vehicle shows: messages, answers, signs of life.

use zenoh::{
    Wait,
    bytes::Encoding,
    liveliness::LivelinessToken,
    pubsub::Publisher,
    qos::CongestionControl,
    query::{Query, Queryable},
};

use crate::{Link, LinkError, at_key};

/// The encoding of why there is no answer. Zenoh's own errors have others.
pub(crate) const REASON: Encoding = Encoding::TEXT_PLAIN;

/// The encoding that tells the type of a payload.
fn encoding(message: &str) -> Encoding {
    Encoding::APPLICATION_PROTOBUF.with_schema(message)
}

/// Publishes under one key.
#[derive(Debug)]
pub struct Outlet(Publisher<'static>);

/// Says that something lives, until it is dropped.
#[derive(Debug)]
pub struct Liveliness(#[allow(dead_code, reason = "it is its life that counts")] LivelinessToken);

/// Answers, until it is dropped.
#[derive(Debug)]
pub struct Answering(#[allow(dead_code, reason = "it is its life that counts")] Queryable<()>);

/// What somebody asks.
#[derive(Debug)]
pub struct Question(Query);

impl Link {
    /// Publishes messages of this type under a key. What a reader cannot take is left out for this reader, and for no other.
    pub fn outlet(&self, key: &str, message: &str) -> Result<Outlet, LinkError> {
        self.session
            .declare_publisher(key.to_owned())
            .encoding(encoding(message))
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map(Outlet)
            .map_err(at_key("publishing", key))
    }

    /// Publishes bytes under a key that mean something to the same program only.
    pub fn carrier(&self, key: &str) -> Result<Outlet, LinkError> {
        self.session
            .declare_publisher(key.to_owned())
            .encoding(Encoding::ZENOH_BYTES)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map(Outlet)
            .map_err(at_key("publishing", key))
    }

    /// Says that something lives.
    pub fn sign(&self, key: &str) -> Result<Liveliness, LinkError> {
        let token = self.session.liveliness().declare_token(key.to_owned());
        token.wait().map(Liveliness).map_err(at_key("saying what lives at", key))
    }

    /// Answers questions about a key or several; `answer` is called by the network and must not take long.
    pub fn answering(
        &self,
        key: &str,
        answer: impl Fn(Question) + Send + Sync + 'static,
    ) -> Result<Answering, LinkError> {
        let queryable = self.session.declare_queryable(key.to_owned()).callback(move |query| answer(Question(query)));
        queryable.wait().map(Answering).map_err(at_key("answering", key))
    }
}

impl Outlet {
    /// Sends a message. It is not known whether anybody takes it.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.0.put(bytes).wait().map_err(at_key("publishing", self.0.key_expr().as_str()))
    }
}

impl Outlet {
    /// Sends a message with something beside it.
    pub fn send_with(&self, bytes: Vec<u8>, attachment: Vec<u8>) -> Result<(), LinkError> {
        let put = self.0.put(bytes).attachment(attachment);
        put.wait().map_err(at_key("publishing", self.0.key_expr().as_str()))
    }
}

impl Question {
    /// What came with it.
    pub fn payload(&self) -> Vec<u8> {
        self.0.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default()
    }

    /// What the question says under a name, after the `?` of its key.
    pub fn number(&self, name: &str) -> Option<u64> {
        self.0.parameters().get(name)?.parse().ok()
    }

    /// It is about this key, perhaps among others.
    pub fn is_about(&self, key: &str) -> bool {
        zenoh::key_expr::KeyExpr::new(key).is_ok_and(|key| self.0.key_expr().intersects(&key))
    }

    /// Gives an answer; there may be one for each key asked about. Who has gone needs none.
    pub fn answer(&self, key: &str, message: &str, bytes: Vec<u8>) {
        let _ = self.0.reply(key.to_owned(), bytes).encoding(encoding(message)).wait();
    }

    /// Gives bytes that mean something to the same program only; there may be several answers.
    pub fn hand_over(&self, key: &str, bytes: Vec<u8>) {
        let _ = self.0.reply(key.to_owned(), bytes).wait();
    }

    /// Says why there is no answer.
    pub fn refuse(&self, reason: &str) {
        let _ = self.0.reply_err(reason.to_owned()).encoding(REASON).wait();
    }
}
