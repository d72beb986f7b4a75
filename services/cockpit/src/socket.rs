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
    v1::{PageCommand, page_command::Kind, to_page::Content},
};

use crate::{
    commands::{CommandSession, Commands},
    hub::{self, Cursor, Hub},
    inflow::Inflow,
    places::{NoPlace, Place},
    token::Tokens,
};

/// Time after which a viewer that accepts no data is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum number of replies queued for a viewer.
const MAX_QUEUED_REPLIES: usize = 16;

/// Time limit for presenting a required token.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(5);

/// Close code for a vehicle that is not available.
pub(crate) const CLOSE_UNKNOWN_VEHICLE: u16 = 4404;
/// Maximum length of a close reason, in bytes. A control frame holds 125 bytes, and the close code
/// takes two of them.
const MAX_REASON_BYTES: usize = 120;

/// Reason why a viewer is not served.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TokenRejection {
    /// The first message contains no valid token.
    #[error("token missing or wrong")]
    Missing,
    /// All places for clients with a token of this role are taken.
    #[error(transparent)]
    NoPlace(#[from] NoPlace),
}

/// Closes the connection with the reason. The connection is accepted first, because a page cannot
/// read the response to a failed upgrade.
pub(crate) async fn close(mut socket: WebSocket, code: u16, reason: &str) {
    let reason = reason[..reason.floor_char_boundary(MAX_REASON_BYTES)].into();
    let _ = timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(CloseFrame { code, reason })))).await;
}

/// Receives a token as the viewer's first message.
///
/// # Errors
///
/// Fails if the message does not arrive in time, contains no valid token, or all places of clients
/// with this token are taken.
pub(crate) async fn receive_token(
    socket: &mut WebSocket,
    tokens: Option<&Tokens>,
    place: &Place,
) -> Result<(), TokenRejection> {
    let Ok(Some(Ok(message))) = timeout(TOKEN_TIMEOUT, socket.recv()).await else {
        return Err(TokenRejection::Missing);
    };
    place.inflow().record(&message);
    let Message::Binary(bytes) = message else { return Err(TokenRejection::Missing) };
    let command = PageCommand::from_bytes(&bytes).ok().filter(|command| command.kind() == Kind::View);
    let role = command.zip(tokens).and_then(|(command, tokens)| tokens.role(&command.token));
    Ok(place.show_token(role.ok_or(TokenRejection::Missing)?)?)
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
    let (reply_tx, mut reply_rx) = mpsc::channel::<Content>(MAX_QUEUED_REPLIES);
    let mut session = CommandSession::new(commands, hub.clone(), reply_tx);
    loop {
        let event = next_event(&mut socket, place.inflow(), &hub, (&mut cursor, &mut news), &mut reply_rx).await;
        let is_open = match event {
            Event::Message(message) => send(&mut socket, message).await,
            Event::Ignored => true,
            Event::Command(bytes) => match PageCommand::from_bytes(&bytes) {
                Ok(command) => {
                    if let Some(role) = tokens.and_then(|tokens| tokens.role(&command.token)) {
                        // If there is no free place, the viewer keeps its present one.
                        let _ = place.show_token(role);
                    }
                    session.handle(command);
                    true
                }
                Err(_) => false,
            },
            Event::Closed => false,
        };
        if !is_open {
            return;
        }
    }
}

/// Event on a viewer's connection.
enum Event {
    Message(Bytes),
    Command(Bytes),
    Ignored,
    Closed,
}

async fn next_event(
    socket: &mut WebSocket,
    inflow: &Inflow,
    hub: &Hub,
    (cursor, news): (&mut Cursor, &mut watch::Receiver<()>),
    replies: &mut mpsc::Receiver<Content>,
) -> Event {
    use std::{future::poll_fn, pin::pin, task::Poll};
    // Polls all three futures. They are cancel-safe, so dropping them loses nothing.
    let (mut next_news, mut next_reply, mut next_command) =
        (pin!(news.changed()), pin!(replies.recv()), pin!(socket.recv()));
    poll_fn(|context| {
        if let Poll::Ready(Some(reply)) = next_reply.as_mut().poll(context) {
            return Poll::Ready(Event::Message(hub::encode(reply)));
        }
        if let Poll::Ready(message) = next_command.as_mut().poll(context) {
            message.iter().flatten().for_each(|message| inflow.record(message));
            return Poll::Ready(match message {
                Some(Ok(Message::Binary(bytes))) => Event::Command(bytes),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Event::Ignored,
                Some(Ok(Message::Text(_) | Message::Close(_)) | Err(_)) | None => Event::Closed,
            });
        }
        if let Some(message) = hub.next_message(cursor) {
            return Poll::Ready(Event::Message(message));
        }
        match next_news.as_mut().poll(context) {
            // The next call returns the message.
            Poll::Ready(Ok(())) => Poll::Ready(Event::Ignored),
            Poll::Ready(Err(_)) => Poll::Ready(Event::Closed),
            Poll::Pending => Poll::Pending,
        }
    })
    .await
}

/// Sends a message. Returns `false` if the viewer has not accepted it in time.
async fn send(socket: &mut WebSocket, message: Bytes) -> bool {
    matches!(timeout(SEND_TIMEOUT, socket.send(Message::Binary(message))).await, Ok(Ok(())))
}
