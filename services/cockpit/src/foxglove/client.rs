//! Connection of a Foxglove client.
//!
//! Input: subscriptions of the client.
//! Output: messages of the subscribed channels, as they are published.
//! Failure: a slow client misses messages. A client that accepts no data for [`SEND_TIMEOUT`] or
//! sends [`MAX_REJECTED`] invalid requests is disconnected.

use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use tokio::{sync::broadcast::error::RecvError, time::timeout};

use super::{
    feed::Broadcaster,
    protocol::{self, Subscriptions},
};
use crate::inflow::Inflow;

/// Time after which a client that accepts no data is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Number of rejected requests after which a client is disconnected.
const MAX_REJECTED: u32 = 100;

/// Subscriptions of a client. Dropping them removes them from the broadcaster's counts.
struct ClientSubscriptions<'l> {
    broadcaster: &'l Broadcaster,
    subscriptions: Subscriptions,
}

impl ClientSubscriptions<'_> {
    fn handle(&mut self, text: &str) -> Result<(), String> {
        let before: Vec<_> = self.subscriptions.are_subscribed().collect();
        let result = self.subscriptions.handle(text);
        self.broadcaster.update_subscriptions(before.into_iter(), self.subscriptions.are_subscribed());
        result
    }
}

impl Drop for ClientSubscriptions<'_> {
    fn drop(&mut self) {
        self.broadcaster.update_subscriptions(self.subscriptions.are_subscribed(), std::iter::repeat(false));
    }
}

/// Serves a client until it disconnects.
pub(crate) async fn serve(mut socket: WebSocket, system: &str, broadcaster: &Broadcaster, inflow: &Inflow) {
    let channels = broadcaster.channels.len();
    let mut client = ClientSubscriptions { broadcaster, subscriptions: Subscriptions::new(channels) };
    let (mut messages, mut session, mut rejected) = (broadcaster.subscribe(), broadcaster.session(), 0);
    let greeting = [protocol::server_info(system, session), protocol::advertise(&broadcaster.channels)];
    for text in greeting {
        if !send(&mut socket, Message::text(text)).await {
            return;
        }
    }
    let mut is_open = true;
    while is_open {
        is_open = tokio::select! {
            biased;
            message = socket.recv() => {
                message.iter().flatten().for_each(|message| inflow.record(message));
                let handled = match message {
                    Some(Ok(Message::Text(text))) => client.handle(&text),
                    Some(Ok(Message::Binary(_))) => client.handle(""),
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => Ok(()),
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                };
                match handled {
                    Ok(()) => true,
                    Err(reason) => {
                        rejected += 1;
                        let status = Message::text(protocol::error_status(&reason));
                        rejected < MAX_REJECTED && send(&mut socket, status).await
                    }
                }
            }
            message = messages.recv() => match message {
                Ok(message) => {
                    let is_new_session = message.session != session;
                    session = message.session;
                    let info = || Message::text(protocol::server_info(system, session));
                    let is_sent = !is_new_session || send(&mut socket, info()).await;
                    match client.subscriptions.subscription_id(message.channel) {
                        Some(id) if is_sent => {
                            let data = protocol::message(id, message.t_ns, &message.data);
                            send(&mut socket, Message::binary(data)).await
                        }
                        _ => is_sent,
                    }
                }
                // This client was too slow and has missed messages.
                Err(RecvError::Lagged(_)) => true,
                Err(RecvError::Closed) => false,
            },
        };
    }
}

/// Sends a message. Returns `false` if the client has not accepted it in time.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(timeout(SEND_TIMEOUT, socket.send(message)).await, Ok(Ok(())))
}
