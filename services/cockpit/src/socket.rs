//! WebSocket of a viewer.
//!
//! Input: commands of the page.
//! Output: snapshots, status and replies, as they are published.
//! Failure: a slow viewer misses snapshots; one that accepts nothing for [`SEND_TIMEOUT`] is
//! disconnected.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Bytes,
    extract::ws::{CloseFrame, Message, WebSocket, close_code},
};
use tokio::{
    sync::{broadcast::error::RecvError, mpsc},
    time::timeout,
};
use wire::{
    command::ControlMessage as _,
    v1::{PageCommand, SwapAnswer, page_command::Kind, to_page::Said},
};

use crate::{
    commands::{CommandSession, Commands},
    hub::{self, Hub},
    token::Tokens,
};

/// Time after which a viewer that accepts no data is disconnected.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum number of replies queued for a viewer.
const MAX_QUEUED_REPLIES: usize = 16;

/// Time limit for presenting a required token.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(5);

/// Close code for a vehicle that is not available.
const CLOSE_UNKNOWN_VEHICLE: u16 = 4404;
/// Maximum length of a close reason, bytes. A control frame holds 125 bytes, two of which are the
/// close code.
const MAX_REASON_BYTES: usize = 120;

/// Closes the connection with the reason. The connection is accepted first, because a page cannot
/// read the response to a failed upgrade.
pub(crate) async fn close_unavailable(mut socket: WebSocket, reason: &str) {
    let reason = reason[..reason.floor_char_boundary(MAX_REASON_BYTES)].into();
    let frame = CloseFrame { code: CLOSE_UNKNOWN_VEHICLE, reason };
    let _ = timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(frame)))).await;
}

/// Serves a viewer until it disconnects.
///
/// If `required_tokens` is `Some`, the viewer must first present one of these tokens.
pub(crate) async fn serve(
    mut socket: WebSocket,
    hub: Arc<Hub>,
    commands: Option<&Commands>,
    required_tokens: Option<Option<&Tokens>>,
) {
    if let Some(tokens) = required_tokens
        && !presents_token(&mut socket, tokens).await
    {
        let frame = CloseFrame { code: close_code::POLICY, reason: "token missing or wrong".into() };
        let _ = timeout(SEND_TIMEOUT, socket.send(Message::Close(Some(frame)))).await;
        return;
    }
    let (initial, mut messages) = hub.subscribe();
    for message in initial {
        if !send(&mut socket, message).await {
            return;
        }
    }
    let (reply_tx, mut reply_rx) = mpsc::channel::<SwapAnswer>(MAX_QUEUED_REPLIES);
    let mut session = CommandSession::new(commands, hub.clone(), reply_tx);
    loop {
        let event = next_event(&mut socket, &mut messages, &mut reply_rx).await;
        let is_open = match event {
            Event::Message(message) => send(&mut socket, message).await,
            Event::Reply(reply) => send(&mut socket, hub::encode(Said::Answer(reply))).await,
            Event::Lagged(messages) => {
                let [picture, calibration] = hub.catch_up(messages);
                send(&mut socket, picture).await && send(&mut socket, calibration).await
            }
            Event::Ignored => true,
            Event::Command(bytes) => session.handle(&bytes),
            Event::Closed => false,
        };
        if !is_open {
            return;
        }
    }
}

async fn presents_token(socket: &mut WebSocket, tokens: Option<&Tokens>) -> bool {
    let Ok(Some(Ok(Message::Binary(bytes)))) = timeout(TOKEN_TIMEOUT, socket.recv()).await else { return false };
    let command = PageCommand::from_bytes(&bytes).ok().filter(|command| command.kind() == Kind::Look);
    command.zip(tokens).is_some_and(|(command, tokens)| tokens.role(&command.token).is_some())
}

/// Event on a viewer's connection.
enum Event {
    Message(Bytes),
    Reply(SwapAnswer),
    Command(Bytes),
    /// Number of messages that this viewer was too slow to receive.
    Lagged(u64),
    Ignored,
    Closed,
}

async fn next_event(
    socket: &mut WebSocket,
    messages: &mut tokio::sync::broadcast::Receiver<Bytes>,
    replies: &mut mpsc::Receiver<SwapAnswer>,
) -> Event {
    use std::{future::poll_fn, pin::pin, task::Poll};
    // Polls all three futures. They are cancel-safe, so dropping them loses nothing.
    let (mut next_message, mut next_reply, mut next_command) =
        (pin!(messages.recv()), pin!(replies.recv()), pin!(socket.recv()));
    poll_fn(|context| {
        if let Poll::Ready(Some(reply)) = next_reply.as_mut().poll(context) {
            return Poll::Ready(Event::Reply(reply));
        }
        if let Poll::Ready(message) = next_command.as_mut().poll(context) {
            return Poll::Ready(match message {
                Some(Ok(Message::Binary(bytes))) => Event::Command(bytes),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Event::Ignored,
                Some(Ok(Message::Text(_) | Message::Close(_)) | Err(_)) | None => Event::Closed,
            });
        }
        match next_message.as_mut().poll(context) {
            Poll::Ready(Ok(message)) => Poll::Ready(Event::Message(message)),
            Poll::Ready(Err(RecvError::Lagged(messages))) => Poll::Ready(Event::Lagged(messages)),
            Poll::Ready(Err(RecvError::Closed)) => Poll::Ready(Event::Closed),
            Poll::Pending => Poll::Pending,
        }
    })
    .await
}

/// Sends a message. Returns `false` if the viewer has not accepted it in time.
async fn send(socket: &mut WebSocket, message: Bytes) -> bool {
    matches!(timeout(SEND_TIMEOUT, socket.send(Message::Binary(message))).await, Ok(Ok(())))
}
