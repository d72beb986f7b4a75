//! Messages of the Foxglove WebSocket protocol v1 that a server without optional capabilities
//! needs.
//!
//! Input: JSON requests from a client.
//! Output: JSON text messages and binary messages.
//! Time: message time, ns since 1970.
//! Failure: an invalid request is answered with an error status.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::Deserialize;
use serde_json::json;
use wire::channel::Channel;

/// Accepted names of the WebSocket subprotocol, newest first. The server treats both in the same
/// way.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Opcode of a binary frame with a channel message.
const MESSAGE_DATA: u8 = 1;
/// Level of a status message for a rejected request.
const STATUS_ERROR: u8 = 2;

/// Returns the server information. Clients discard their state when `session` changes.
pub(crate) fn server_info(system: &str, session: u64) -> String {
    let metadata = json!({ "version": env!("CARGO_PKG_VERSION"), "system": system });
    let (name, capabilities) = (format!("plumbline {system}"), [""; 0]);
    let session = session.to_string();
    json!({ "op": "serverInfo", "name": name, "capabilities": capabilities, "metadata": metadata, "sessionId": session })
        .to_string()
}

/// Returns the advertisement of the channels. The id of a channel is its index.
pub(crate) fn advertise(channels: &[Channel]) -> String {
    let channels = channels.iter().zip(0_u32..).map(|(channel, id)| {
        let schema = STANDARD.encode(wire::schema::descriptors_for(&channel.schema).unwrap_or_default());
        json!({
            "id": id,
            "topic": channel.name,
            "encoding": "protobuf",
            "schemaName": channel.schema,
            "schema": schema,
            "schemaEncoding": "protobuf",
        })
    });
    json!({ "op": "advertise", "channels": channels.collect::<Vec<_>>() }).to_string()
}

/// Encodes a channel message with the client's subscription id.
pub(crate) fn message(subscription: u32, t_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 + 4 + 8 + data.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&t_ns.to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

/// Returns a status message with the reason for a rejected request.
pub(crate) fn error_status(reason: &str) -> String {
    json!({ "op": "status", "level": STATUS_ERROR, "message": reason }).to_string()
}

/// Request from a client.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

/// Subscriptions of a client: the id chosen by the client for each channel, `None` if not
/// subscribed.
#[derive(Debug)]
pub(crate) struct Subscriptions(Vec<Option<u32>>);

impl Subscriptions {
    /// Creates a set for the given number of channels, none of them subscribed.
    pub(crate) fn new(channels: usize) -> Self {
        Self(vec![None; channels])
    }

    /// Returns the client's subscription id for a channel, or `None` if it is not subscribed.
    pub(crate) fn subscription_id(&self, channel: usize) -> Option<u32> {
        self.0.get(channel).copied().flatten()
    }

    /// Returns for each channel whether the client is subscribed to it.
    pub(crate) fn are_subscribed(&self) -> impl Iterator<Item = bool> {
        self.0.iter().map(Option::is_some)
    }

    /// Applies a request from the client.
    ///
    /// # Errors
    ///
    /// Returns the reason if the request is rejected. Subscriptions listed before the invalid one
    /// remain in effect.
    pub(crate) fn handle(&mut self, text: &str) -> Result<(), String> {
        let request = serde_json::from_str(text).map_err(|error| format!("not a message of the protocol: {error}"))?;
        match request {
            Request::Subscribe { subscriptions } => {
                subscriptions.into_iter().try_for_each(|subscription| self.subscribe(&subscription))
            }
            Request::Unsubscribe { subscription_ids } => subscription_ids.into_iter().try_for_each(|id| {
                let slot = self.0.iter_mut().find(|slot| **slot == Some(id));
                slot.map(|slot| *slot = None).ok_or_else(|| format!("no subscription {id}"))
            }),
            Request::Other => Err("operation not supported; use subscribe or unsubscribe".into()),
        }
    }

    fn subscribe(&mut self, subscription: &Subscription) -> Result<(), String> {
        let Subscription { id, channel_id } = *subscription;
        if self.0.contains(&Some(id)) {
            return Err(format!("subscription {id} already exists"));
        }
        let slot = self.0.get_mut(channel_id as usize).ok_or_else(|| format!("no channel {channel_id}"))?;
        if slot.is_some() {
            return Err(format!("channel {channel_id} already has a subscription"));
        }
        *slot = Some(id);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    #[test]
    fn one_subscription_per_channel_and_other_requests_rejected() {
        let mut subscriptions = Subscriptions::new(3);
        subscriptions
            .handle(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":2},{"id":0,"channelId":0}]}"#)
            .unwrap();
        let ids = [2, 0, 1, 9].map(|channel| subscriptions.subscription_id(channel));
        assert_eq!(ids, [Some(7), Some(0), None, None]);
        for (request, reason) in [
            (r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":1}]}"#, "subscription 7 already exists"),
            (r#"{"op":"subscribe","subscriptions":[{"id":8,"channelId":2}]}"#, "channel 2 already has"),
            (r#"{"op":"subscribe","subscriptions":[{"id":8,"channelId":3}]}"#, "no channel 3"),
            (r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#, "not a message of the protocol"),
            (r#"{"op":"unsubscribe","subscriptionIds":[5]}"#, "no subscription 5"),
            (r#"{"op":"setParameters","parameters":[]}"#, "use subscribe or unsubscribe"),
            ("[]", "not a message of the protocol"),
        ] {
            let error = subscriptions.handle(request).unwrap_err();
            assert!(error.contains(reason), "{request}: {error}");
        }
        subscriptions.handle(r#"{"op":"unsubscribe","subscriptionIds":[7]}"#).unwrap();
        assert_eq!(subscriptions.are_subscribed().collect::<Vec<_>>(), [true, false, false]);
        subscriptions.handle(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":2}]}"#).unwrap();
    }

    #[test]
    fn message_has_opcode_subscription_time_and_payload() {
        assert_eq!(message(0x0102, 0x0304, &[9, 8]), [1, 2, 1, 0, 0, 4, 3, 0, 0, 0, 0, 0, 0, 9, 8]);
    }

    #[test]
    fn advertisement_includes_schemas() {
        let channels = wire::channel::channels(&[graph::Topic::Attitude]);
        let advertisement: Value = serde_json::from_str(&advertise(&channels)).unwrap();
        let all = advertisement["channels"].as_array().unwrap();
        let names: Vec<_> = all.iter().map(|channel| channel["topic"].as_str().unwrap()).collect();
        assert_eq!(names, ["/attitude", "/tf", "/pose"]);
        let schema = STANDARD.decode(all[1]["schema"].as_str().unwrap()).unwrap();
        assert_eq!(Some(schema), wire::schema::descriptors_for("foxglove.FrameTransform"));
        let info: Value = serde_json::from_str(&server_info("boat", 5)).unwrap();
        assert_eq!((&info["name"], &info["sessionId"]), (&"plumbline boat".into(), &"5".into()));
        assert_eq!(info["capabilities"], serde_json::json!([]));
    }
}
