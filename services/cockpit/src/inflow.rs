//! Limits on the bytes that a client sends.
//!
//! Input: the bytes of a connection, after TLS.
//! Output: the same bytes, delayed so that their mean rate does not exceed [`RATE_PER_S`].
//! Time: CLOCK_MONOTONIC, as measured by the runtime.
//! Failure: a WebSocket whose message is incomplete after [`MAX_PARTIAL_BYTES`], framing included,
//! is closed. This also limits empty fragments, which do not count towards the size of a message.

use std::{
    future::Future as _,
    io,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::extract::ws::Message;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep, sleep_until},
};

/// Maximum size of a viewer's command and of a Foxglove client's request, in bytes.
pub(crate) const MAX_MESSAGE_BYTES: usize = 4096;
/// Maximum number of bytes of an incomplete message. The framing of an unfragmented message takes 8
/// bytes. The remaining margin is for clients that fragment their messages.
const MAX_PARTIAL_BYTES: usize = 2 * MAX_MESSAGE_BYTES;
/// Number of bytes that a client may send at once. It suffices for the requests that load the page
/// or a recording.
const BURST_BYTES: usize = 64 * 1024;
/// Maximum sustained rate of received data, in bytes per second. It corresponds to about 5000 of
/// the smallest frames per second.
const RATE_PER_S: usize = 32 * 1024;
/// Maximum number of bytes per read, so that no client delays the others.
const MAX_READ_BYTES: usize = 4096;
/// Pause in reading from a client that has sent too much.
const DELAY: Duration = Duration::from_millis(100);
/// Framing overhead of a ping or pong, in bytes: a header of 2 bytes and a mask of 4.
const CONTROL_FRAMING_BYTES: usize = 6;

/// Count of the bytes of a client's incomplete message.
#[derive(Debug, Default)]
pub(crate) struct Inflow {
    /// `true` once the connection is a WebSocket.
    has_messages: AtomicBool,
    /// Bytes received since the last complete message.
    partial_bytes: AtomicUsize,
}

impl Inflow {
    /// Starts counting. Called when the connection becomes a WebSocket.
    pub(crate) fn start_messages(&self) {
        self.partial_bytes.store(0, Ordering::Relaxed);
        self.has_messages.store(true, Ordering::Relaxed);
    }

    /// Records a received message. A ping or pong may arrive between the fragments of a message, so
    /// only the bytes of the ping or pong are subtracted from the count.
    pub(crate) fn record(&self, message: &Message) {
        let bytes = match message {
            Message::Ping(data) | Message::Pong(data) => data.len() + CONTROL_FRAMING_BYTES,
            Message::Text(_) | Message::Binary(_) | Message::Close(_) => usize::MAX,
        };
        let left = self.partial_bytes.load(Ordering::Relaxed).saturating_sub(bytes);
        self.partial_bytes.store(left, Ordering::Relaxed);
    }

    fn receive(&self, bytes: usize) {
        self.partial_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    fn is_exceeded(&self) -> bool {
        self.has_messages.load(Ordering::Relaxed) && self.partial_bytes.load(Ordering::Relaxed) >= MAX_PARTIAL_BYTES
    }
}

/// Bytes that a client may still send.
#[derive(Debug)]
struct Allowance {
    bytes: usize,
    updated_at: Instant,
}

impl Allowance {
    /// Returns the number of bytes that the client may send at `now`.
    fn at(&mut self, now: Instant) -> usize {
        let earned = now.saturating_duration_since(self.updated_at).as_secs_f64() * RATE_PER_S as f64;
        // Time that is too short to earn a byte is carried over.
        if earned >= 1.0 {
            self.bytes = self.bytes.saturating_add(earned as usize).min(BURST_BYTES);
            self.updated_at = now;
        }
        self.bytes
    }
}

/// Connection of a client with limited input.
pub(crate) struct LimitedStream<S> {
    stream: S,
    inflow: Arc<Inflow>,
    allowance: Allowance,
    delay: Option<Pin<Box<Sleep>>>,
}

impl<S> LimitedStream<S> {
    /// Limits the input of `stream` and counts it in `inflow`.
    pub(crate) fn new(stream: S, inflow: Arc<Inflow>) -> Self {
        let allowance = Allowance { bytes: BURST_BYTES, updated_at: Instant::now() };
        Self { stream, inflow, allowance, delay: None }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for LimitedStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.inflow.is_exceeded() {
            return Poll::Ready(Err(io::Error::other("the message is incomplete after too many bytes")));
        }
        if let Some(delay) = &mut self.delay {
            ready!(delay.as_mut().poll(context));
            self.delay = None;
        }
        let now = Instant::now();
        let allowed = self.allowance.at(now);
        if allowed == 0 {
            let mut delay = Box::pin(sleep_until(now + DELAY));
            // The first poll registers the waker.
            let _ = delay.as_mut().poll(context);
            self.delay = Some(delay);
            return Poll::Pending;
        }
        let max_bytes = allowed.min(MAX_READ_BYTES).min(buffer.remaining());
        let mut part = ReadBuf::new(buffer.initialize_unfilled_to(max_bytes));
        ready!(Pin::new(&mut self.stream).poll_read(context, &mut part))?;
        let read = part.filled().len();
        buffer.advance(read);
        self.allowance.bytes = self.allowance.bytes.saturating_sub(read);
        self.inflow.receive(read);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for LimitedStream<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::task::Waker;

    use super::*;

    /// Stream that never ends.
    struct Endless;

    impl AsyncRead for Endless {
        fn poll_read(self: Pin<&mut Self>, _: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
            let unfilled = buffer.remaining();
            buffer.put_slice(&vec![7; unfilled]);
            Poll::Ready(Ok(()))
        }
    }

    /// Reads until the stream delays or fails. Returns the number of bytes, and the error if any.
    fn read_all(stream: &mut LimitedStream<Endless>) -> (usize, Option<io::Error>) {
        let mut context = Context::from_waker(Waker::noop());
        let mut total = 0;
        loop {
            let mut bytes = [0; 10_000];
            let mut buffer = ReadBuf::new(&mut bytes);
            match Pin::new(&mut *stream).poll_read(&mut context, &mut buffer) {
                Poll::Pending => return (total, None),
                Poll::Ready(Err(error)) => return (total, Some(error)),
                Poll::Ready(Ok(())) => {
                    let read = buffer.filled();
                    assert!(!read.is_empty() && read.len() <= MAX_READ_BYTES && read.iter().all(|byte| *byte == 7));
                    total += read.len();
                }
            }
        }
    }

    fn with_runtime(test: impl FnOnce()) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let _guard = runtime.enter();
        test();
    }

    #[test]
    fn requests_beyond_burst_are_delayed() {
        with_runtime(|| {
            let mut stream = LimitedStream::new(Endless, Arc::default());
            let (read, error) = read_all(&mut stream);
            assert!(read >= BURST_BYTES && error.is_none() && stream.delay.is_some(), "{read}");
            let now = Instant::now();
            let mut allowance = Allowance { bytes: 0, updated_at: now };
            assert_eq!(allowance.at(now + Duration::from_secs(1)), RATE_PER_S);
            assert_eq!(allowance.at(now + Duration::from_secs(100)), BURST_BYTES);
        });
    }

    #[test]
    fn endless_message_is_rejected_and_complete_ones_are_not() {
        with_runtime(|| {
            let inflow = Arc::<Inflow>::default();
            inflow.start_messages();
            let mut stream = LimitedStream::new(Endless, inflow.clone());
            let (read, error) = read_all(&mut stream);
            assert!(read == MAX_PARTIAL_BYTES && error.is_some(), "{read}");
            inflow.record(&Message::Ping(vec![0; 10].into()));
            assert_eq!(read_all(&mut stream).0, MAX_READ_BYTES, "a ping accounts for its own bytes only");
            inflow.record(&Message::Binary(vec![0].into()));
            assert_eq!(read_all(&mut stream).0, MAX_PARTIAL_BYTES);
        });
    }
}
