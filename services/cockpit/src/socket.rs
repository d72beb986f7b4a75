//! A viewer: pictures go out as they come, commands come in. One who does not take what is sent is dropped after a while; one who is slow
//! misses pictures.

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
    commands::{Commands, CommandSession},
    hub::{self, Hub},
    token::Tokens,
};

/// Who has taken nothing for so long is dropped.
const SEND_LIMIT: Duration = Duration::from_secs(5);
/// Answers that wait for a viewer.
const ANSWERS: usize = 16;

/// By then whoever must show a token has shown it.
const TOKEN_LIMIT: Duration = Duration::from_secs(5);

/// The code of the page for a vehicle of which there is nothing to be seen.
const ABSENT: u16 = 4404;
/// The reason with a code is this long at most, bytes.
const MAX_REASON: usize = 120;

/// Says why there is nothing to be seen: of a request that is refused a page does not learn the reason.
pub(crate) async fn turn_away(mut socket: WebSocket, why: &str) {
    let why = CloseFrame { code: ABSENT, reason: why[..why.floor_char_boundary(MAX_REASON)].into() };
    let _ = timeout(SEND_LIMIT, socket.send(Message::Close(Some(why)))).await;
}

/// Serves a viewer until it goes; where there is a `door`, first one of its tokens is to be shown.
pub(crate) async fn serve(
    mut socket: WebSocket,
    hub: Arc<Hub>,
    commands: Option<&Commands>,
    door: Option<Option<&Tokens>>,
) {
    if let Some(tokens) = door
        && !shows_token(&mut socket, tokens).await
    {
        let why = CloseFrame { code: close_code::POLICY, reason: "the token is missing or wrong".into() };
        let _ = timeout(SEND_LIMIT, socket.send(Message::Close(Some(why)))).await;
        return;
    }
    let (first, mut told) = hub.subscribe();
    for message in first {
        if !send(&mut socket, message).await {
            return;
        }
    }
    let (answers, mut answered) = mpsc::channel::<SwapAnswer>(ANSWERS);
    let mut session = CommandSession::new(commands, hub.clone(), answers);
    loop {
        let step = next(&mut socket, &mut told, &mut answered).await;
        let goes_on = match step {
            Step::Told(message) => send(&mut socket, message).await,
            Step::Answered(answer) => send(&mut socket, hub::encode(Said::Answer(answer))).await,
            Step::Missed(messages) => {
                let [picture, calibration] = hub.catch_up(messages);
                send(&mut socket, picture).await && send(&mut socket, calibration).await
            }
            Step::Nothing => true,
            Step::Asked(bytes) => session.handle(&bytes),
            Step::Gone => false,
        };
        if !goes_on {
            return;
        }
    }
}

async fn shows_token(socket: &mut WebSocket, tokens: Option<&Tokens>) -> bool {
    let Ok(Some(Ok(Message::Binary(bytes)))) = timeout(TOKEN_LIMIT, socket.recv()).await else { return false };
    let look = PageCommand::from_bytes(&bytes).ok().filter(|command| command.kind() == Kind::Look);
    look.zip(tokens).is_some_and(|(look, tokens)| tokens.role(&look.token).is_some())
}

/// What comes next.
enum Step {
    Told(Bytes),
    Answered(SwapAnswer),
    Asked(Bytes),
    /// So many messages were made that this viewer was too slow for.
    Missed(u64),
    Nothing,
    Gone,
}

async fn next(
    socket: &mut WebSocket,
    told: &mut tokio::sync::broadcast::Receiver<Bytes>,
    answered: &mut mpsc::Receiver<SwapAnswer>,
) -> Step {
    use std::{future::poll_fn, pin::pin, task::Poll};
    // Whichever is ready first; each of them can be left and begun again without a loss.
    let (mut said, mut answer, mut asked) = (pin!(told.recv()), pin!(answered.recv()), pin!(socket.recv()));
    poll_fn(|context| {
        if let Poll::Ready(Some(answer)) = answer.as_mut().poll(context) {
            return Poll::Ready(Step::Answered(answer));
        }
        if let Poll::Ready(message) = asked.as_mut().poll(context) {
            return Poll::Ready(match message {
                Some(Ok(Message::Binary(bytes))) => Step::Asked(bytes),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Step::Nothing,
                Some(Ok(Message::Text(_) | Message::Close(_)) | Err(_)) | None => Step::Gone,
            });
        }
        match said.as_mut().poll(context) {
            Poll::Ready(Ok(message)) => Poll::Ready(Step::Told(message)),
            Poll::Ready(Err(RecvError::Lagged(messages))) => Poll::Ready(Step::Missed(messages)),
            Poll::Ready(Err(RecvError::Closed)) => Poll::Ready(Step::Gone),
            Poll::Pending => Poll::Pending,
        }
    })
    .await
}

/// Whether it was taken in time.
async fn send(socket: &mut WebSocket, message: Bytes) -> bool {
    matches!(timeout(SEND_LIMIT, socket.send(Message::Binary(message))).await, Ok(Ok(())))
}
