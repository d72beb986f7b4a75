//! A client: what it subscribes to goes out as it comes. One who does not take what is sent is dropped after a while; one who is slow misses
//! messages; one who asks for what is not there again and again is dropped.

use std::{future::poll_fn, pin::pin, task::Poll, time::Duration};

use axum::extract::ws::{Message, WebSocket};
use tokio::{
    sync::broadcast::{Receiver, error::RecvError},
    time::timeout,
};

use super::{
    feed::{Live, Told},
    protocol::{self, Subscriptions},
};

/// Who has taken nothing for so long is dropped.
const SEND_LIMIT: Duration = Duration::from_secs(5);
/// Requests that are refused before a client is dropped.
const MAX_REFUSED: u32 = 100;

/// What a client wants, for as long as it is there.
struct Wants<'l> {
    live: &'l Live,
    subscriptions: Subscriptions,
}

impl Wants<'_> {
    fn hear(&mut self, text: &str) -> Result<(), String> {
        let before: Vec<_> = self.subscriptions.each().collect();
        let done = self.subscriptions.hear(text);
        self.live.want(before.into_iter(), self.subscriptions.each());
        done
    }
}

impl Drop for Wants<'_> {
    fn drop(&mut self) {
        self.live.want(self.subscriptions.each(), std::iter::repeat(false));
    }
}

/// Serves a client until it goes.
pub(crate) async fn serve(mut socket: WebSocket, system: &str, live: &Live) {
    let mut wants = Wants { live, subscriptions: Subscriptions::none(live.channels.len()) };
    let (mut told, mut session, mut refused) = (live.join(), live.session(), 0);
    let greeting = [protocol::server_info(system, session), protocol::advertise(&live.channels)];
    for text in greeting {
        if !send(&mut socket, Message::text(text)).await {
            return;
        }
    }
    loop {
        let goes_on = match next(&mut socket, &mut told).await {
            Step::Told(message) => {
                let begins = message.session != session;
                session = message.session;
                let info = || Message::text(protocol::server_info(system, session));
                let greeted = !begins || send(&mut socket, info()).await;
                match wants.subscriptions.of(message.channel) {
                    Some(id) if greeted => {
                        let data = protocol::message(id, message.t_ns, &message.data);
                        send(&mut socket, Message::binary(data)).await
                    }
                    _ => greeted,
                }
            }
            Step::Asked(text) => match wants.hear(&text) {
                Ok(()) => true,
                Err(why) => {
                    refused += 1;
                    refused < MAX_REFUSED && send(&mut socket, Message::text(protocol::refusal(&why))).await
                }
            },
            Step::Missed => true,
            Step::Gone => false,
        };
        if !goes_on {
            return;
        }
    }
}

/// What comes next.
enum Step {
    Told(Told),
    Asked(String),
    /// Messages came that this client was too slow for, or nothing of interest.
    Missed,
    Gone,
}

async fn next(socket: &mut WebSocket, told: &mut Receiver<Told>) -> Step {
    // Whichever is ready first; each of them can be left and begun again without a loss.
    let (mut said, mut asked) = (pin!(told.recv()), pin!(socket.recv()));
    poll_fn(|context| {
        if let Poll::Ready(message) = asked.as_mut().poll(context) {
            return Poll::Ready(match message {
                Some(Ok(Message::Text(text))) => Step::Asked(text.as_str().to_owned()),
                Some(Ok(Message::Binary(_))) => Step::Asked(String::new()),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Step::Missed,
                Some(Ok(Message::Close(_)) | Err(_)) | None => Step::Gone,
            });
        }
        match said.as_mut().poll(context) {
            Poll::Ready(Ok(message)) => Poll::Ready(Step::Told(message)),
            Poll::Ready(Err(RecvError::Lagged(_))) => Poll::Ready(Step::Missed),
            Poll::Ready(Err(RecvError::Closed)) => Poll::Ready(Step::Gone),
            Poll::Pending => Poll::Pending,
        }
    })
    .await
}

/// Whether it was taken in time.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(timeout(SEND_LIMIT, socket.send(message)).await, Ok(Ok(())))
}
