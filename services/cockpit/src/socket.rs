//! WebSocket of a viewer.
//!
//! Input: commands of the page.
//! Output: snapshots, status and replies, as they are published.
//! Failure: a slow viewer misses snapshots; one that accepts nothing for [`SEND_TIMEOUT`] is
//! disconnected.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Bytes,
    extract::ws::{CloseFrame, Message, WebSocket},
};
use tokio::{
    sync::{mpsc, watch},
    time::timeout,
};
use wire::{
    command::ControlMessage as _,
    v1::{PageCommand, to_page::Content},
};

use crate::{
    authorization,
    commands::{CommandSession, Commands},
    hub::{self, Cursor, Hub},
    places::Place,
    token::Tokens,
};

/// Time after which a viewer that accepts no data is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum number of replies queued for a viewer.
const MAX_QUEUED_REPLIES: usize = 16;

/// Close code for a vehicle that is not available.
pub(crate) const CLOSE_UNKNOWN_VEHICLE: u16 = 4404;
/// Maximum length of a close reason, in bytes. A control frame holds 125 bytes, and the close code
/// takes two of them.
const MAX_REASON_BYTES: usize = 120;

/// Closes the connection with the reason. The connection is accepted first, because a page cannot
/// read the response to a failed upgrade.
pub(crate) async fn close(mut socket: WebSocket, code: u16, reason: &str) {
    let reason = reason[..reason.floor_char_boundary(MAX_REASON_BYTES)].into();
    let _ = timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(CloseFrame { code, reason })))).await;
}

/// Serves a viewer until it disconnects.
pub(crate) async fn serve(
    mut socket: WebSocket,
    hub: Arc<Hub>,
    commands: Option<&Commands>,
    tokens: Option<&Tokens>,
    place: &Place,
) {
    let (mut cursor, mut news) = hub.subscribe();
    let (reply_tx, mut replies) = mpsc::channel::<Content>(MAX_QUEUED_REPLIES);
    let mut session = CommandSession::new(commands, hub.clone(), reply_tx);
    let mut is_open = true;
    while is_open {
        is_open = tokio::select! {
            biased;
            Some(reply) = replies.recv() => send(&mut socket, hub::encode(reply)).await,
            message = socket.recv() => {
                message.iter().flatten().for_each(|message| place.inflow().record(message));
                match message {
                    Some(Ok(Message::Binary(bytes))) => PageCommand::from_bytes(&bytes).is_ok_and(|command| {
                        // Without a valid token or a free place, the viewer keeps its place.
                        let _ = authorization::show_token(&command, tokens, place);
                        session.handle(command);
                        true
                    }),
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => true,
                    Some(Ok(Message::Text(_) | Message::Close(_)) | Err(_)) | None => false,
                }
            }
            message = next_message(&hub, &mut cursor, &mut news) => match message {
                Some(message) => send(&mut socket, message).await,
                None => false,
            },
        };
    }
}

/// Waits for the next message of the hub. Returns `None` if the hub is gone. No message is lost if
/// the wait is cancelled.
async fn next_message(hub: &Hub, cursor: &mut Cursor, news: &mut watch::Receiver<()>) -> Option<Bytes> {
    loop {
        if let Some(message) = hub.next_message(cursor) {
            return Some(message);
        }
        news.changed().await.ok()?;
    }
}

/// Sends a message. Returns `false` if the viewer has not accepted it in time.
async fn send(socket: &mut WebSocket, message: Bytes) -> bool {
    matches!(timeout(SEND_TIMEOUT, socket.send(Message::Binary(message))).await, Ok(Ok(())))
}
