//! Messages on their way to whoever has subscribed: encoded once, where somebody wants them.

use std::sync::{
    Arc,
    atomic::{AtomicU64, AtomicUsize, Ordering},
};

use axum::body::Bytes;
use graph::Topic;
use runtime::clock::{monotonic_ns, realtime_offset_ns};
use tokio::sync::broadcast;
use wire::channel::{Channel, Clocks, Encoder, channels, encode_for_viewers};

use crate::{board::TOPICS, foxglove::pace::Pace, source::SourceState};

/// Messages that a client may be behind before it misses some: half a second of every channel.
const MAX_BEHIND: usize = 512;
/// A message whose publication is so much before the last one's is of a system that has begun anew.
const BACKWARDS_NS: u64 = 1_000_000_000;

/// Between who takes messages and who sends them.
#[derive(Debug)]
pub(crate) struct Live {
    pub(crate) channels: Vec<Channel>,
    told: broadcast::Sender<Told>,
    /// Clients of each channel.
    wanted: Vec<AtomicUsize>,
    /// When what is shown began, CLOCK_REALTIME, ns: no two sessions have the same.
    session: AtomicU64,
}

/// A message of a channel.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    pub(crate) session: u64,
    /// Its place.
    pub(crate) channel: usize,
    /// Publication on CLOCK_REALTIME, ns.
    pub(crate) t_ns: u64,
    pub(crate) data: Bytes,
}

impl Default for Live {
    fn default() -> Self {
        let channels = channels(&TOPICS);
        let wanted = channels.iter().map(|_| AtomicUsize::new(0)).collect();
        Self { channels, told: broadcast::Sender::new(MAX_BEHIND), wanted, session: AtomicU64::new(now_ns()) }
    }
}

impl Live {
    /// Somebody is told.
    pub(crate) fn is_watched(&self) -> bool {
        self.told.receiver_count() > 0
    }

    /// What is told from now on.
    pub(crate) fn join(&self) -> broadcast::Receiver<Told> {
        self.told.subscribe()
    }

    /// The session that is shown.
    pub(crate) fn session(&self) -> u64 {
        self.session.load(Ordering::SeqCst)
    }

    /// A client wants the channels that it did not want before, and the other way about.
    pub(crate) fn want(&self, before: impl Iterator<Item = bool>, now: impl Iterator<Item = bool>) {
        for (clients, change) in self.wanted.iter().zip(before.zip(now)) {
            match change {
                (false, true) => _ = clients.fetch_add(1, Ordering::SeqCst),
                (true, false) => _ = clients.fetch_sub(1, Ordering::SeqCst),
                _ => {}
            }
        }
    }

    fn is_wanted(&self, channel: usize) -> bool {
        self.wanted.get(channel).is_some_and(|clients| clients.load(Ordering::SeqCst) > 0)
    }

    fn begin_session(&self) {
        // Two within the clock's step are two all the same.
        let _ = self.session.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |last| Some(now_ns().max(last + 1)));
    }
}

/// Takes messages, and tells those that somebody wants.
#[derive(Debug)]
pub(crate) struct Feed {
    live: Arc<Live>,
    clocks: Clocks,
    intakes: Vec<Option<Intake>>,
    /// It has been shown, and has stopped since.
    has_stopped: Option<bool>,
}

/// A topic's messages.
#[derive(Debug)]
struct Intake {
    encoder: Encoder,
    pace: Option<Pace>,
    /// The newest publication, CLOCK_MONOTONIC, ns.
    newest_ns: u64,
    /// The places of its channels.
    channels: Vec<usize>,
}

impl Feed {
    pub(crate) fn new(live: Arc<Live>) -> Self {
        let mut intakes: Vec<_> = Topic::ALL.iter().map(|_| None).collect();
        for topic in TOPICS {
            let channels = live.channels.iter().enumerate().filter(|(_, channel)| channel.topic == topic);
            let channels = channels.map(|(place, _)| place).collect();
            let (encoder, pace) = (Encoder::new(topic), Pace::of(topic));
            intakes[topic as usize] = Some(Intake { encoder, pace, newest_ns: 0, channels });
        }
        // The time of the source goes with no message here, and so its rate is not needed.
        let clocks = Clocks { offset_ns: realtime_offset_ns(), rate_hz: 0.0 };
        Self { live, clocks, intakes, has_stopped: None }
    }

    /// Takes a message of a topic at `taken_ns`, CLOCK_MONOTONIC.
    pub(crate) fn take(&mut self, topic: Topic, bytes: &[u8], taken_ns: u64) {
        let Self { live, clocks, intakes, .. } = self;
        let Some(intake) = &mut intakes[topic as usize] else { return };
        if !intake.channels.iter().any(|channel| live.is_wanted(*channel)) {
            return;
        }
        let sent_ns = intake.encoder.sent_ns(bytes, taken_ns);
        if sent_ns.saturating_add(BACKWARDS_NS) < intake.newest_ns {
            live.begin_session();
            (intake.newest_ns, intake.pace) = (0, Pace::of(topic));
        }
        intake.newest_ns = intake.newest_ns.max(sent_ns);
        if !intake.pace.as_mut().is_none_or(|pace| pace.admits(sent_ns)) {
            return;
        }
        let Some((data, stamps)) = intake.encoder.encode(bytes, taken_ns, *clocks) else { return };
        let (data, session) = (Bytes::from(data), live.session());
        for place in intake.channels.iter().copied().filter(|place| live.is_wanted(*place)) {
            let Channel { name, is_for_viewers, .. } = &live.channels[place];
            let data = match is_for_viewers {
                true => encode_for_viewers(name, bytes, stamps.log_ns).map(Bytes::from),
                false => Some(data.clone()),
            };
            if let Some(data) = data {
                // Whoever wanted it may have gone meanwhile.
                let _ = live.told.send(Told { session, channel: place, t_ns: stamps.log_ns, data });
            }
        }
    }

    /// Is told how the source is; one that comes again begins anew.
    pub(crate) fn source_is(&mut self, state: &SourceState) {
        match (state, self.has_stopped) {
            (SourceState::Live, Some(true)) => {
                self.live.begin_session();
                for (topic, intake) in Topic::ALL.iter().zip(&mut self.intakes) {
                    if let Some(intake) = intake {
                        (intake.newest_ns, intake.pace) = (0, Pace::of(*topic));
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

/// CLOCK_REALTIME, ns.
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

    fn all(live: &Live, wanted: bool) -> impl Iterator<Item = bool> {
        live.channels.iter().map(move |_| wanted).collect::<Vec<_>>().into_iter()
    }

    fn names(live: &Live, told: &mut broadcast::Receiver<Told>) -> Vec<String> {
        let told = std::iter::from_fn(|| told.try_recv().ok());
        told.map(|told| live.channels[told.channel].name.clone()).collect()
    }

    #[test]
    fn what_nobody_wants_is_not_encoded_and_the_attitude_has_three_channels() {
        let live = Arc::new(Live::default());
        let (mut feed, mut told) = (Feed::new(live.clone()), live.join());
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 5)), 9);
        assert_eq!(names(&live, &mut told), Vec::<String>::new());
        live.want(all(&live, false), all(&live, true));
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(1, SECOND_NS)), 9);
        assert_eq!(names(&live, &mut told), ["/attitude", "/tf", "/pose"]);
        feed.take(Topic::Attitude, &[1, 2, 3], 9);
        feed.take(Topic::Credit, &[], 9);
        live.want(all(&live, true), all(&live, false));
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(2, 2 * SECOND_NS)), 9);
        assert_eq!(names(&live, &mut told), Vec::<String>::new());
    }

    #[test]
    fn a_system_that_begins_anew_is_another_session() {
        let live = Arc::new(Live::default());
        let mut feed = Feed::new(live.clone());
        live.want(all(&live, false), all(&live, true));
        let first = live.session();
        feed.source_is(&SourceState::Connecting(String::new()));
        feed.source_is(&SourceState::Live);
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 9 * SECOND_NS)), 0);
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(1, 9 * SECOND_NS - SECOND_NS / 2)), 0);
        assert_eq!(live.session(), first, "of two publishers one is a little late");
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(0, 7 * SECOND_NS)), 0);
        let second = live.session();
        assert!(second > first, "time has gone back");
        let mut told = live.join();
        feed.take(Topic::Attitude, bytemuck::bytes_of(&attitude(20, 7 * SECOND_NS + 20_000_000)), 0);
        assert_eq!(told.try_recv().unwrap().session, second, "and goes on");
        feed.source_is(&SourceState::Ended(String::new()));
        feed.source_is(&SourceState::Connecting(String::new()));
        assert_eq!(live.session(), second);
        feed.source_is(&SourceState::Live);
        assert!(live.session() > second);
    }

    #[test]
    fn a_client_that_does_not_read_misses_messages_and_holds_up_nobody() {
        let live = Arc::new(Live::default());
        let (mut feed, mut told) = (Feed::new(live.clone()), live.join());
        live.want(all(&live, false), all(&live, true));
        for number in 0..1000 {
            let event = SystemEvent { number, ..bytemuck::Zeroable::zeroed() };
            feed.take(Topic::Event, bytemuck::bytes_of(&event), 7);
        }
        assert!(matches!(told.try_recv(), Err(TryRecvError::Lagged(missed)) if missed == 1000 - MAX_BEHIND as u64));
        assert_eq!(names(&live, &mut told).len(), MAX_BEHIND, "and has the newest");
    }
}
