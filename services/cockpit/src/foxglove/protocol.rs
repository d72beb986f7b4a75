//! What is said to a client, and heard of it: the Foxglove WebSocket protocol v1, as far as a server that only shows needs it.
//!
//! Input: a client's texts. Output: texts in JSON, messages as bytes. Time: that of a message, ns since 1970. Failure: what a client may
//! not ask for is answered with a status that says why.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::Deserialize;
use serde_json::json;
use wire::channel::Channel;

/// The names of the protocol, the newer one first: both mean the same here.
pub(crate) const NAMES: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// A binary message is one of a channel.
const MESSAGE_DATA: u8 = 1;
/// What was asked for cannot be done.
const STATUS_ERROR: u8 = 2;

/// Which system it is; another `session` is another beginning.
pub(crate) fn server_info(system: &str, session: u64) -> String {
    let metadata = json!({ "version": env!("CARGO_PKG_VERSION"), "system": system });
    let (name, capabilities) = (format!("plumbline {system}"), [""; 0]);
    let session = session.to_string();
    json!({ "op": "serverInfo", "name": name, "capabilities": capabilities, "metadata": metadata, "sessionId": session })
        .to_string()
}

/// Which channels there are; a channel's id is its place.
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

/// A message of a channel to whoever has subscribed to it as `subscription`.
pub(crate) fn message(subscription: u32, t_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 + 4 + 8 + data.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&t_ns.to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

/// Why something is not done.
pub(crate) fn refusal(why: &str) -> String {
    json!({ "op": "status", "level": STATUS_ERROR, "message": why }).to_string()
}

/// What a client asks for.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Asked {
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

/// What a client has subscribed to: for each channel the id that it has chosen.
#[derive(Debug)]
pub(crate) struct Subscriptions(Vec<Option<u32>>);

impl Subscriptions {
    /// Nothing of so many channels.
    pub(crate) fn none(channels: usize) -> Self {
        Self(vec![None; channels])
    }

    /// The client's id for a channel.
    pub(crate) fn of(&self, channel: usize) -> Option<u32> {
        self.0.get(channel).copied().flatten()
    }

    /// Whether each channel is subscribed to.
    pub(crate) fn each(&self) -> impl Iterator<Item = bool> {
        self.0.iter().map(Option::is_some)
    }

    /// Does what a client asks for; why where something is not done.
    pub(crate) fn hear(&mut self, text: &str) -> Result<(), String> {
        let asked =
            serde_json::from_str(text).map_err(|error| format!("this is no message of the protocol: {error}"))?;
        match asked {
            Asked::Subscribe { subscriptions } => {
                subscriptions.into_iter().try_for_each(|asked| self.subscribe(&asked))
            }
            Asked::Unsubscribe { subscription_ids } => subscription_ids.into_iter().try_for_each(|id| {
                let held = self.0.iter_mut().find(|held| **held == Some(id));
                held.map(|held| *held = None).ok_or_else(|| format!("there is no subscription {id}"))
            }),
            Asked::Other => Err("this server shows: subscribe and unsubscribe are all that can be asked for".into()),
        }
    }

    fn subscribe(&mut self, asked: &Subscription) -> Result<(), String> {
        let Subscription { id, channel_id } = *asked;
        if self.0.contains(&Some(id)) {
            return Err(format!("there is a subscription {id} already"));
        }
        let place = self.0.get_mut(channel_id as usize).ok_or_else(|| format!("there is no channel {channel_id}"))?;
        if place.is_some() {
            return Err(format!("channel {channel_id} is subscribed to already"));
        }
        *place = Some(id);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    #[test]
    fn subscriptions_are_one_for_each_channel_and_what_else_is_asked_for_is_refused() {
        let mut own = Subscriptions::none(3);
        own.hear(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":2},{"id":0,"channelId":0}]}"#).unwrap();
        assert_eq!((own.of(2), own.of(0), own.of(1), own.of(9)), (Some(7), Some(0), None, None));
        for (asked, why) in [
            (r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":1}]}"#, "a subscription 7 already"),
            (r#"{"op":"subscribe","subscriptions":[{"id":8,"channelId":2}]}"#, "channel 2 is subscribed to already"),
            (r#"{"op":"subscribe","subscriptions":[{"id":8,"channelId":3}]}"#, "no channel 3"),
            (r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#, "no message of the protocol"),
            (r#"{"op":"unsubscribe","subscriptionIds":[5]}"#, "no subscription 5"),
            (r#"{"op":"setParameters","parameters":[]}"#, "all that can be asked for"),
            ("[]", "no message of the protocol"),
        ] {
            let said = own.hear(asked).unwrap_err();
            assert!(said.contains(why), "{asked}: {said}");
        }
        own.hear(r#"{"op":"unsubscribe","subscriptionIds":[7]}"#).unwrap();
        assert_eq!(own.each().collect::<Vec<_>>(), [true, false, false]);
        own.hear(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":2}]}"#).unwrap();
    }

    #[test]
    fn a_message_is_its_kind_its_subscription_its_time_and_its_bytes() {
        assert_eq!(message(0x0102, 0x0304, &[9, 8]), [1, 2, 1, 0, 0, 4, 3, 0, 0, 0, 0, 0, 0, 9, 8]);
    }

    #[test]
    fn a_channel_brings_its_schema() {
        let channels = wire::channel::channels(&[graph::Topic::Attitude]);
        let said: Value = serde_json::from_str(&advertise(&channels)).unwrap();
        let all = said["channels"].as_array().unwrap();
        let names: Vec<_> = all.iter().map(|one| one["topic"].as_str().unwrap()).collect();
        assert_eq!(names, ["/attitude", "/tf", "/pose"]);
        let schema = STANDARD.decode(all[1]["schema"].as_str().unwrap()).unwrap();
        assert_eq!(Some(schema), wire::schema::descriptors_for("foxglove.FrameTransform"));
        let info: Value = serde_json::from_str(&server_info("boat", 5)).unwrap();
        assert_eq!((&info["name"], &info["sessionId"]), (&"plumbline boat".into(), &"5".into()));
        assert_eq!(info["capabilities"], serde_json::json!([]));
    }
}
