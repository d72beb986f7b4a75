//! The vehicle's side of the network: messages, query responses and liveliness.

use zenoh::{
    Wait,
    bytes::Encoding,
    liveliness::LivelinessToken,
    pubsub::Publisher,
    qos::CongestionControl,
    query::{Query, Queryable},
};

use crate::{Link, LinkError, at_key};

/// Encoding of the reason for a rejection. It differs from the encodings of Zenoh's own errors.
pub(crate) const REASON_ENCODING: Encoding = Encoding::TEXT_PLAIN;

/// Returns the encoding for a protobuf message of the given type.
fn encoding(message: &str) -> Encoding {
    Encoding::APPLICATION_PROTOBUF.with_schema(message)
}

/// Publisher of messages under one key.
#[derive(Debug)]
pub struct MessagePublisher(Publisher<'static>);

/// Liveliness token, valid until it is dropped.
#[derive(Debug)]
pub struct Liveliness(#[allow(dead_code, reason = "dropping it withdraws the token")] LivelinessToken);

/// Handler of incoming queries, active until it is dropped.
#[derive(Debug)]
pub struct QueryHandler(#[allow(dead_code, reason = "dropping it stops the handler")] Queryable<()>);

/// Query received from a remote client.
#[derive(Debug)]
pub struct IncomingQuery(Query);

impl Link {
    /// Creates a publisher of protobuf messages of the given type.
    ///
    /// Messages that a slow subscriber cannot receive are dropped for that subscriber only.
    pub fn publisher(&self, key: &str, message: &str) -> Result<MessagePublisher, LinkError> {
        self.session
            .declare_publisher(key.to_owned())
            .encoding(encoding(message))
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map(MessagePublisher)
            .map_err(at_key("publishing", key))
    }

    /// Creates a publisher of untyped bytes, which only instances of the same program understand.
    pub fn raw_publisher(&self, key: &str) -> Result<MessagePublisher, LinkError> {
        self.session
            .declare_publisher(key.to_owned())
            .encoding(Encoding::ZENOH_BYTES)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map(MessagePublisher)
            .map_err(at_key("publishing", key))
    }

    /// Declares that the entity at `key` is alive until the returned token is dropped.
    pub fn declare_liveliness(&self, key: &str) -> Result<Liveliness, LinkError> {
        let token = self.session.liveliness().declare_token(key.to_owned());
        token.wait().map(Liveliness).map_err(at_key("declaring liveliness at", key))
    }

    /// Handles queries for one or more keys. Zenoh calls `handler`, which must not block.
    pub fn handle_queries(
        &self,
        key: &str,
        handler: impl Fn(IncomingQuery) + Send + Sync + 'static,
    ) -> Result<QueryHandler, LinkError> {
        let queryable =
            self.session.declare_queryable(key.to_owned()).callback(move |query| handler(IncomingQuery(query)));
        queryable.wait().map(QueryHandler).map_err(at_key("handling queries at", key))
    }
}

impl MessagePublisher {
    /// Publishes a message. Its delivery is not confirmed.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.0.put(bytes).wait().map_err(at_key("publishing", self.0.key_expr().as_str()))
    }
}

impl MessagePublisher {
    /// Publishes a message with an attachment.
    pub fn send_with_attachment(&self, bytes: Vec<u8>, attachment: Vec<u8>) -> Result<(), LinkError> {
        let put = self.0.put(bytes).attachment(attachment);
        put.wait().map_err(at_key("publishing", self.0.key_expr().as_str()))
    }
}

impl IncomingQuery {
    /// Returns the payload of the query; empty if it has none.
    pub fn payload(&self) -> Vec<u8> {
        self.0.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default()
    }

    /// Returns the numeric value of a parameter given after the `?` of the query.
    pub fn parameter_u64(&self, name: &str) -> Option<u64> {
        self.0.parameters().get(name)?.parse().ok()
    }

    /// Returns `true` if the query covers `key`.
    pub fn matches_key(&self, key: &str) -> bool {
        zenoh::key_expr::KeyExpr::new(key).is_ok_and(|key| self.0.key_expr().intersects(&key))
    }

    /// Sends a protobuf response for `key`. A query can receive one response for each of its keys.
    /// Errors are ignored, because the client may have disconnected.
    pub fn reply(&self, key: &str, message: &str, bytes: Vec<u8>) {
        let _ = self.0.reply(key.to_owned(), bytes).encoding(encoding(message)).wait();
    }

    /// Sends a response of untyped bytes. A query can receive several responses.
    pub fn reply_raw(&self, key: &str, bytes: Vec<u8>) {
        let _ = self.0.reply(key.to_owned(), bytes).wait();
    }

    /// Rejects the query with a reason.
    pub fn reject(&self, reason: &str) {
        let _ = self.0.reply_err(reason.to_owned()).encoding(REASON_ENCODING).wait();
    }
}
