//! Encoding and distribution of messages to the Foxglove clients.
//!
//! Each message is encoded once, and only if a client subscribes to its channel.

use std::sync::{
    Arc,
    atomic::{AtomicU64, AtomicUsize, Ordering},
};

use axum::body::Bytes;
use graph::Topic;
use runtime::clock::{monotonic_ns, realtime_offset_ns};
use tokio::sync::broadcast;
use wire::channel::{Channel, Encoder, channels, encode_for_viewers};

use crate::{foxglove::rate_limit::RateLimit, local_system::observed_topics, source::SourceState};

/// Maximum number of messages queued per client, enough for all messages of half a second. A client
/// that falls further behind loses the oldest messages.
const MAX_QUEUED_MESSAGES: usize = 512;
/// Backward step in ns of the publication time, above which the system is considered restarted. The
/// publication times of concurrent publishers differ by less.
const RESTART_STEP_NS: u64 = 1_000_000_000;

/// Channels, their subscriber counts, and the queues of the clients.
#[derive(Debug)]
pub(crate) struct Broadcaster {
    pub(crate) channels: Vec<Channel>,
    messages: broadcast::Sender<ChannelMessage>,
    /// Number of subscribed clients by channel index.
    subscriber_counts: Vec<AtomicUsize>,
    /// Session identifier: the start time on CLOCK_REALTIME, ns, incremented if necessary to be
    /// unique.
    session: AtomicU64,
}

/// Encoded message of a channel.
#[derive(Debug, Clone)]
pub(crate) struct ChannelMessage {
    pub(crate) session: u64,
    /// Index of the channel.
    pub(crate) channel: usize,
    /// Publication time on CLOCK_REALTIME, ns.
    pub(crate) t_ns: u64,
    pub(crate) data: Bytes,
}

impl Default for Broadcaster {
    fn default() -> Self {
        let channels = channels(&observed_topics().collect::<Vec<_>>());
        let subscriber_counts = channels.iter().map(|_| AtomicUsize::new(0)).collect();
        let messages = broadcast::Sender::new(MAX_QUEUED_MESSAGES);
        Self { channels, messages, subscriber_counts, session: AtomicU64::new(now_ns()) }
    }
}

impl Broadcaster {
    /// Returns `true` if a client is connected.
    pub(crate) fn has_clients(&self) -> bool {
        self.messages.receiver_count() > 0
    }

    /// Subscribes to all messages published from now on.
    pub(crate) fn subscribe(&self) -> broadcast::Receiver<ChannelMessage> {
        self.messages.subscribe()
    }

    /// Returns the identifier of the current session.
    pub(crate) fn session(&self) -> u64 {
        self.session.load(Ordering::SeqCst)
    }

    /// Updates the subscriber counts after a client has changed its subscriptions. For each
    /// channel, `before` yields `true` if the client was subscribed before the change, and `after`
    /// yields `true` if the client is subscribed after the change.
    pub(crate) fn update_subscriptions(&self, before: impl Iterator<Item = bool>, after: impl Iterator<Item = bool>) {
        for (clients, change) in self.subscriber_counts.iter().zip(before.zip(after)) {
            match change {
                (false, true) => _ = clients.fetch_add(1, Ordering::SeqCst),
                (true, false) => _ = clients.fetch_sub(1, Ordering::SeqCst),
                _ => {}
            }
        }
    }

    fn has_subscribers(&self, channel: usize) -> bool {
        self.subscriber_counts.get(channel).is_some_and(|clients| clients.load(Ordering::SeqCst) > 0)
    }

    fn start_session(&self) {
        // The identifier must differ even if two sessions start within the clock's resolution.
        let _ = self.session.try_update(Ordering::SeqCst, Ordering::SeqCst, |last| Some(now_ns().max(last + 1)));
    }
}

/// Encodes messages for the channels with subscribers.
#[derive(Debug)]
pub(crate) struct Feed {
    broadcaster: Arc<Broadcaster>,
    /// CLOCK_REALTIME minus CLOCK_MONOTONIC, measured once at the start, ns.
    offset_ns: i64,
    topic_feeds: Vec<Option<TopicFeed>>,
    /// `true` if the source has stopped since it was last live; `None` until it is live for the
    /// first time.
    has_stopped: Option<bool>,
}

/// Encoder and channels of a topic.
#[derive(Debug)]
struct TopicFeed {
    encoder: Encoder,
    rate_limit: Option<RateLimit>,
    /// Latest publication time so far on CLOCK_MONOTONIC, ns.
    newest_ns: u64,
    /// Indices of the topic's channels.
    channels: Vec<usize>,
}

impl Feed {
    pub(crate) fn new(broadcaster: Arc<Broadcaster>) -> Self {
        let mut topic_feeds: Vec<_> = Topic::ALL.iter().map(|_| None).collect();
        for topic in observed_topics() {
            let channels = broadcaster.channels.iter().enumerate().filter(|(_, channel)| channel.topic == topic);
            let channels = channels.map(|(index, _)| index).collect();
            let (encoder, rate_limit) = (Encoder::new(topic), RateLimit::for_topic(topic));
            topic_feeds[topic as usize] = Some(TopicFeed { encoder, rate_limit, newest_ns: 0, channels });
        }
        Self { broadcaster, offset_ns: realtime_offset_ns(), topic_feeds, has_stopped: None }
    }

    /// Publishes a message of `topic` that was received at `received_ns` on CLOCK_MONOTONIC.
    pub(crate) fn push(&mut self, topic: Topic, bytes: &[u8], received_ns: u64) {
        let Self { broadcaster, offset_ns, topic_feeds, .. } = self;
        let Some(topic_feed) = &mut topic_feeds[topic as usize] else { return };
        if !topic_feed.channels.iter().any(|channel| broadcaster.has_subscribers(*channel)) {
            return;
        }
        let sent_ns = topic_feed.encoder.sent_ns(bytes, received_ns);
        if sent_ns.saturating_add(RESTART_STEP_NS) < topic_feed.newest_ns {
            broadcaster.start_session();
            (topic_feed.newest_ns, topic_feed.rate_limit) = (0, RateLimit::for_topic(topic));
        }
        topic_feed.newest_ns = topic_feed.newest_ns.max(sent_ns);
        if !topic_feed.rate_limit.as_mut().is_none_or(|limit| limit.admit(sent_ns)) {
            return;
        }
        let Some((data, stamps)) = topic_feed.encoder.encode(bytes, received_ns, *offset_ns) else { return };
        let (data, session) = (Bytes::from(data), broadcaster.session());
        for index in topic_feed.channels.iter().copied().filter(|index| broadcaster.has_subscribers(*index)) {
            let Channel { name, is_for_viewers, .. } = &broadcaster.channels[index];
            let data = match is_for_viewers {
                true => encode_for_viewers(name, bytes, stamps.log_ns).map(Bytes::from),
                false => Some(data.clone()),
            };
            if let Some(data) = data {
                // Sending fails only if the subscriber has disconnected in the meantime.
                let _ =
                    broadcaster.messages.send(ChannelMessage { session, channel: index, t_ns: stamps.log_ns, data });
            }
        }
    }

    /// Processes the source's state. A source that becomes live again starts a new session.
    pub(crate) fn set_source_state(&mut self, state: &SourceState) {
        match (state, self.has_stopped) {
            (SourceState::Live, Some(true)) => {
                self.broadcaster.start_session();
                for (topic, topic_feed) in Topic::ALL.iter().zip(&mut self.topic_feeds) {
                    if let Some(topic_feed) = topic_feed {
                        (topic_feed.newest_ns, topic_feed.rate_limit) = (0, RateLimit::for_topic(*topic));
                    }
                }
                self.has_stopped = Some(false);
            }
            (SourceState::Live, _) => self.has_stopped = Some(false),
            (_, Some(_)) => self.has_stopped = Some(true),
            (_, None) => {}
        }
    }
}

/// Returns the time on CLOCK_REALTIME, ns.
fn now_ns() -> u64 {
    monotonic_ns().saturating_add_signed(realtime_offset_ns())
}

#[cfg(test)]
mod tests {
    use messages::{AttitudeOutput, SystemEvent};
    use tokio::sync::broadcast::error::TryRecvError;

    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    fn attitude(tick: u64, t_sent_ns: u64) -> AttitudeOutput {
        let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
        attitude.quaternion = [1.0, 0.0, 0.0, 0.0];
        (attitude.header.tick, attitude.header.t_sent_ns) = (tick, t_sent_ns);
        attitude
    }

    fn all_channels(broadcaster: &Broadcaster, subscribed: bool) -> impl Iterator<Item = bool> {
        broadcaster.channels.iter().map(move |_| subscribed).collect::<Vec<_>>().into_iter()
    }

    fn names(broadcaster: &Broadcaster, queue: &mut broadcast::Receiver<ChannelMessage>) -> Vec<String> {
        let messages = std::iter::from_fn(|| queue.try_recv().ok());
        messages.map(|message| broadcaster.channels[message.channel].name.clone()).collect()
    }

    #[test]
    fn unsubscribed_topics_are_not_encoded() {
        let broadcaster = Arc::new(Broadcaster::default());
        let (mut feed, mut queue) = (Feed::new(broadcaster.clone()), broadcaster.subscribe());
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 5)), 9);
        assert_eq!(names(&broadcaster, &mut queue), Vec::<String>::new());
        broadcaster.update_subscriptions(all_channels(&broadcaster, false), all_channels(&broadcaster, true));
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(1, SECOND_NS)), 9);
        assert_eq!(names(&broadcaster, &mut queue), ["/attitude", "/tf", "/pose"]);
        feed.push(Topic::Attitude, &[1, 2, 3], 9);
        feed.push(Topic::Credit, &[], 9);
        broadcaster.update_subscriptions(all_channels(&broadcaster, true), all_channels(&broadcaster, false));
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(2, 2 * SECOND_NS)), 9);
        assert_eq!(names(&broadcaster, &mut queue), Vec::<String>::new());
    }

    #[test]
    fn restarted_system_starts_new_session() {
        let broadcaster = Arc::new(Broadcaster::default());
        let mut feed = Feed::new(broadcaster.clone());
        broadcaster.update_subscriptions(all_channels(&broadcaster, false), all_channels(&broadcaster, true));
        let first = broadcaster.session();
        feed.set_source_state(&SourceState::Connecting(String::new()));
        feed.set_source_state(&SourceState::Live);
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 9 * SECOND_NS)), 0);
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(1, 9 * SECOND_NS - SECOND_NS / 2)), 0);
        assert_eq!(broadcaster.session(), first, "publishers may differ by half a second");
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 7 * SECOND_NS)), 0);
        let second = broadcaster.session();
        assert!(second > first, "a step back in time starts a session");
        let mut queue = broadcaster.subscribe();
        feed.push(Topic::Attitude, bytemuck::bytes_of(&attitude(20, 7 * SECOND_NS + 20_000_000)), 0);
        assert_eq!(queue.try_recv().unwrap().session, second, "messages carry the new session");
        feed.set_source_state(&SourceState::Ended(String::new()));
        feed.set_source_state(&SourceState::Connecting(String::new()));
        assert_eq!(broadcaster.session(), second);
        feed.set_source_state(&SourceState::Live);
        assert!(broadcaster.session() > second);
    }

    #[test]
    fn slow_client_misses_messages_without_blocking() {
        let broadcaster = Arc::new(Broadcaster::default());
        let (mut feed, mut queue) = (Feed::new(broadcaster.clone()), broadcaster.subscribe());
        broadcaster.update_subscriptions(all_channels(&broadcaster, false), all_channels(&broadcaster, true));
        for number in 0..1000 {
            let event = SystemEvent { number, ..bytemuck::Zeroable::zeroed() };
            feed.push(Topic::Event, bytemuck::bytes_of(&event), 7);
        }
        assert!(
            matches!(queue.try_recv(), Err(TryRecvError::Lagged(missed)) if missed == 1000 - MAX_QUEUED_MESSAGES as u64)
        );
        assert_eq!(names(&broadcaster, &mut queue).len(), MAX_QUEUED_MESSAGES, "the newest are kept");
    }
}
