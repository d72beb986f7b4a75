//! `plumb bridge`: the attitude of a running system in the protocols of others.

use std::{
    fmt,
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use bridges::{
    datagrams::{DatagramError, Datagrams, Endpoint},
    mavlink::{AUTOPILOT, Condition, Speaker, Withheld, attitude},
};
use bus::{BusError, Tap};
use clap::{Args, Subcommand};
use control::{ControlError, ControlRequest, ask};
use gateway::decimator::Decimator;
use graph::Topic;
use launch::Rate;
use messages::AttitudeOutput;
use runtime::{ServiceConfig, clock::monotonic_ns, service_config::FIRST_EPOCH};
use serde::Serialize;
use swap::ReorderBuffer;

use crate::{
    fail,
    out::print,
    seeing::{LOOK, Until, observer},
    system::OnBoard,
    up::duration_s,
};

/// Between two heartbeats.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Whoever has had no attitude for so long is told.
const SILENCE_LIMIT: Duration = Duration::from_secs(1);
/// Between two attempts to open the topic.
const OPEN_INTERVAL: Duration = Duration::from_millis(200);

#[derive(Subcommand)]
pub(crate) enum Bridge {
    /// Send MAVLink 2 by UDP, as QGroundControl shows it: HEARTBEAT, ATTITUDE_QUATERNION and ATTITUDE (docs/bridges.md).
    Mavlink(Mavlink),
}

/// The command line of `plumb bridge mavlink`.
#[derive(Args)]
pub(crate) struct Mavlink {
    #[command(flatten)]
    system: OnBoard,
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
    /// How long, as `10s`, `500ms`, `2m`, `1h` [default: until the system ends, or Ctrl-C].
    #[arg(long = "for", value_name = "TIME", value_parser = duration_s)]
    duration_s: Option<f64>,
}

/// Why nothing is sent.
#[derive(Debug, thiserror::Error)]
enum BridgeError {
    #[error(transparent)]
    Bus(#[from] BusError),
    #[error(transparent)]
    Control(#[from] ControlError),
    #[error(transparent)]
    Datagrams(#[from] DatagramError),
}

/// What became of the attitudes.
#[derive(Debug, Default, Serialize)]
struct Sent {
    /// Attitudes sent, each as two messages.
    attitudes: u64,
    /// Heartbeats sent.
    heartbeats: u64,
    /// Attitudes that were none yet, by their flag.
    unaligned: u64,
    /// Attitudes that were no rotation or not finite.
    invalid: u64,
    /// Attitudes published too long ago.
    stale: u64,
    /// Messages that the network did not take.
    dropped: u64,
}

pub(crate) fn run(Bridge::Mavlink(mavlink): &Bridge) -> ExitCode {
    match follow(mavlink) {
        // Numbers always serialise.
        Ok(sent) if mavlink.system.json => print(&serde_json::to_string(&sent).unwrap_or_default()),
        Ok(sent) => print(&sent),
        Err(error) => fail(&error, 1),
    }
}

/// Sends until the time is over, by Ctrl-C, or to the end of the system.
fn follow(mavlink: &Mavlink) -> Result<Sent, BridgeError> {
    let name = mavlink.system.name();
    let seat = observer(&name, "bridge")?;
    let config = ask::<ServiceConfig>(&name, &ControlRequest::ServiceConfig)?;
    let mut reorder_buffer = ReorderBuffer::joining(FIRST_EPOCH, config.lateness_ticks() / 2);
    let mut sender = Sender::open(mavlink)?;
    let mut until = Until::new(|| seat.is_running(), mavlink.duration_s.map(Duration::from_secs_f64));
    let (mut tap, mut sought) = (None::<Tap>, None::<Instant>);
    while !until.is_over() {
        if tap.is_none() && sought.is_none_or(|sought| sought.elapsed() >= OPEN_INTERVAL) {
            sought = Some(Instant::now());
            tap = match seat.tap(Topic::Attitude) {
                Ok(tap) => Some(tap),
                Err(BusError::Unopened { .. }) => None,
                Err(error) => return Err(error.into()),
            };
        }
        if let Some(tap) = &tap {
            tap.drain(&mut |bytes| {
                if let Ok(output) = bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes) {
                    reorder_buffer.offer(output, &mut |output, _| sender.take(&output));
                }
            })?;
        }
        sender.beat();
        thread::sleep(LOOK);
    }
    Ok(sender.sent)
}

/// Attitudes as messages to one address.
struct Sender {
    speaker: Speaker,
    datagrams: Datagrams,
    decimator: Decimator,
    beaten: Option<Instant>,
    spoken: Option<Instant>,
    sent: Sent,
}

impl Sender {
    fn open(mavlink: &Mavlink) -> Result<Self, DatagramError> {
        Ok(Self {
            speaker: Speaker::new(mavlink.system_id, mavlink.component_id),
            datagrams: Datagrams::open(&mavlink.to)?,
            decimator: Decimator::to(Rate::Hz(mavlink.rate_hz)),
            beaten: None,
            spoken: None,
            sent: Sent::default(),
        })
    }

    fn take(&mut self, output: &AttitudeOutput) {
        if !self.decimator.keeps(output.header.t_end_ns) {
            return;
        }
        match attitude(output, monotonic_ns()) {
            Ok(both) => {
                for raw in [self.speaker.frame(&both.quaternion), self.speaker.frame(&both.angles)] {
                    self.sent.dropped += u64::from(!self.datagrams.send(raw.raw_bytes()));
                }
                self.sent.attitudes += 1;
                self.spoken = Some(Instant::now());
            }
            Err(Withheld::Unaligned) => self.sent.unaligned += 1,
            Err(Withheld::Invalid) => self.sent.invalid += 1,
            Err(Withheld::Stale) => self.sent.stale += 1,
        }
    }

    /// A heartbeat where one is due.
    fn beat(&mut self) {
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
        self.sent.heartbeats += 1;
    }
}

impl fmt::Display for Sent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { attitudes, heartbeats, unaligned, invalid, stale, dropped } = self;
        write!(f, "{attitudes} attitudes and {heartbeats} heartbeats sent")?;
        let withheld = [(unaligned, "unaligned"), (invalid, "invalid"), (stale, "stale")];
        for (count, what) in withheld.into_iter().filter(|(count, _)| **count > 0) {
            write!(f, ", {count} {what} ones withheld")?;
        }
        if *dropped > 0 {
            write!(f, "; {dropped} messages dropped by the network")?;
        }
        Ok(())
    }
}

fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz| (0.1..=1000.0).contains(hz));
    hz.ok_or_else(|| "expected a number of Hz from 0.1 to 1000".into())
}
