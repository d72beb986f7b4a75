//! `plumb bridge mavlink`: MAVLink 2 by UDP.

use std::time::{Duration, Instant};

use bridges::{
    datagrams::{DatagramError, Datagrams, Endpoint},
    mavlink::{AUTOPILOT, Attitude, Condition, Speaker, attitude},
    soundness,
};
use clap::Args;
use gateway::decimator::Decimator;
use launch::TopicRate;
use messages::{AttitudeOutput, ImuSample};
use runtime::clock::monotonic_ns;

use super::{BridgeError, Observed, Sender, Sent, rate_hz};

/// Between two heartbeats.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Whoever has had no attitude for so long is told.
const SILENCE_LIMIT: Duration = Duration::from_secs(1);

/// The command line of `plumb bridge mavlink`.
#[derive(Args)]
pub(crate) struct Mavlink {
    #[command(flatten)]
    pub(super) observed: Observed,
    /// Where it goes.
    #[arg(long, value_name = "udpout:HOST:PORT", default_value = "udpout:127.0.0.1:14550")]
    to: Endpoint,
    /// Attitudes a second of the source's time, as each of the two messages.
    #[arg(long, value_name = "HZ", default_value_t = 50.0, value_parser = rate_hz)]
    rate_hz: f64,
    /// The system's number in MAVLink.
    #[arg(long, value_name = "1…255", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    system_id: u8,
    /// The component's number in it: 1 is shown as a vehicle; beside an autopilot 191, with the autopilot's system.
    #[arg(long, value_name = "1…255", default_value_t = AUTOPILOT, value_parser = clap::value_parser!(u8).range(1..))]
    component_id: u8,
}

impl Mavlink {
    pub(super) fn run(&self) -> Result<Sent, BridgeError> {
        let seat = self.observed.seat()?;
        let mut ground = Ground::open(self)?;
        self.observed.follow(&seat, false, &mut ground)?;
        Ok(ground.sent)
    }
}

/// Attitudes as messages to one address.
struct Ground {
    speaker: Speaker,
    datagrams: Datagrams,
    decimator: Decimator,
    beaten: Option<Instant>,
    spoken: Option<Instant>,
    sent: Sent,
}

impl Ground {
    fn open(mavlink: &Mavlink) -> Result<Self, DatagramError> {
        Ok(Self {
            speaker: Speaker::new(mavlink.system_id, mavlink.component_id),
            datagrams: Datagrams::open(&mavlink.to)?,
            decimator: Decimator::new(TopicRate::Hz(mavlink.rate_hz)),
            beaten: None,
            spoken: None,
            sent: Sent { heartbeats: Some(0), ..Sent::default() },
        })
    }
}

impl Sender for Ground {
    fn take(&mut self, output: &AttitudeOutput, _sample: Option<&ImuSample>) {
        if !self.decimator.accept(output.header.t_end_ns) {
            return;
        }
        if let Err(why) = soundness::check(output, monotonic_ns()) {
            return self.sent.withhold(why);
        }
        let Attitude { quaternion, angles } = attitude(output);
        for raw in [self.speaker.frame(&quaternion), self.speaker.frame(&angles)] {
            self.sent.dropped += u64::from(!self.datagrams.send(raw.raw_bytes()));
        }
        self.sent.attitudes += 1;
        self.spoken = Some(Instant::now());
    }

    /// A heartbeat where one is due.
    fn look(&mut self) {
        if self.beaten.is_some_and(|beaten| beaten.elapsed() < HEARTBEAT_INTERVAL) {
            return;
        }
        // A beat that comes late does not put off the next one, unless it is a whole one late.
        let due = self.beaten.map(|beaten| beaten + HEARTBEAT_INTERVAL);
        self.beaten = due.filter(|due| due.elapsed() < HEARTBEAT_INTERVAL).or_else(|| Some(Instant::now()));
        let condition = match self.spoken {
            None => Condition::Starting,
            Some(spoken) if spoken.elapsed() < SILENCE_LIMIT => Condition::Active,
            Some(_) => Condition::Silent,
        };
        let raw = self.speaker.heartbeat(condition);
        self.sent.dropped += u64::from(!self.datagrams.send(raw.raw_bytes()));
        self.sent.heartbeats.iter_mut().for_each(|beats| *beats += 1);
    }
}
