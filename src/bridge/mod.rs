//! `plumb bridge`: the attitude of a running system in the protocols of others, and their readings for it.

mod mavlink;
mod ros;
mod ros_sensor;

use std::{
    collections::VecDeque,
    fmt,
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use bridges::{datagrams::DatagramError, soundness::Withheld};
use bus::{BusError, Observer, Tap};
use clap::{Args, Subcommand};
use control::{ControlError, ControlRequest, send_request};
use driver::DriverError;
use graph::Topic;
use link::LinkError;
use messages::{AttitudeOutput, ImuSample};
use runtime::{ServiceConfig, service_config::FIRST_EPOCH};
use serde::Serialize;
use swap::ReorderBuffer;

use crate::{
    fail,
    out::print,
    remote::RemoteError,
    seeing::{LOOK, Until, observer},
    system::OnBoard,
    up::duration_s,
};

/// Between two attempts to open a topic.
const OPEN_INTERVAL: Duration = Duration::from_millis(200);
/// Samples of the IMU that are kept for the attitudes of their ticks.
const MAX_SAMPLES: usize = 16_384;

#[derive(Subcommand)]
pub(crate) enum Bridge {
    /// Send MAVLink 2 by UDP, as QGroundControl shows it: HEARTBEAT, ATTITUDE_QUATERNION and ATTITUDE (docs/bridges.md).
    Mavlink(mavlink::Mavlink),
    /// Publish sensor_msgs/msg/Imu for ROS 2 with rmw_zenoh, through its router (docs/bridges.md).
    Ros(ros::Ros),
    /// Give a system whose source is the bus the readings of ROS 2 with rmw_zenoh: sensor_msgs/msg/Imu and MagneticField (docs/bridges.md).
    RosSensor(ros_sensor::RosSensor),
}

/// Of which system, and for how long.
#[derive(Args)]
struct Observed {
    #[command(flatten)]
    system: OnBoard,
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
    #[error(transparent)]
    Remote(#[from] RemoteError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Driver(#[from] DriverError),
}

impl BridgeError {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Remote(error) => error.exit_code(),
            _ => 1,
        }
    }
}

/// Who sends attitudes.
trait Sender {
    /// An attitude, in the order of ticks, each once, and the sample of its tick where samples are read.
    fn take(&mut self, output: &AttitudeOutput, sample: Option<&ImuSample>);
    /// What there was has been taken; called several times a second.
    fn look(&mut self);
}

/// What became of the attitudes.
#[derive(Debug, Default, Serialize)]
struct Sent {
    /// Attitudes sent.
    attitudes: u64,
    /// Heartbeats sent, where the protocol has them.
    #[serde(skip_serializing_if = "Option::is_none")]
    heartbeats: Option<u64>,
    /// Attitudes that were none yet, by their flag.
    unaligned: u64,
    /// Attitudes that were no rotation or not finite, or had no sample where it is needed.
    invalid: u64,
    /// Attitudes published too long ago.
    stale: u64,
    /// Messages that the network did not take.
    dropped: u64,
}

impl Sent {
    fn withhold(&mut self, why: Withheld) {
        match why {
            Withheld::Unaligned => self.unaligned += 1,
            Withheld::Invalid => self.invalid += 1,
            Withheld::Stale => self.stale += 1,
        }
    }
}

pub(crate) fn run(bridge: &Bridge) -> ExitCode {
    match bridge {
        Bridge::Mavlink(mavlink) => ended(mavlink.run(), mavlink.observed.system.json),
        Bridge::Ros(ros) => ended(ros.run(), ros.observed.system.json),
        Bridge::RosSensor(sensor) => ended(sensor.run(), sensor.observed.system.json),
    }
}

/// Says what became of the messages.
fn ended<C: Serialize + fmt::Display>(counts: Result<C, BridgeError>, json: bool) -> ExitCode {
    match counts {
        // Numbers always serialise.
        Ok(counts) if json => print(&serde_json::to_string(&counts).unwrap_or_default()),
        Ok(counts) => print(&counts),
        Err(error) => fail(&error, error.exit_code()),
    }
}

impl Observed {
    fn seat(&self) -> Result<Observer, BridgeError> {
        Ok(observer(&self.system.name(), "bridge")?)
    }

    /// Hands over attitudes until the time is over, by Ctrl-C, or to the end of the system.
    fn follow(&self, seat: &Observer, samples: bool, sender: &mut dyn Sender) -> Result<(), BridgeError> {
        let config = send_request::<ServiceConfig>(&self.system.name(), &ControlRequest::ServiceConfig)?;
        let mut reorder_buffer = ReorderBuffer::with_unknown_start(FIRST_EPOCH, config.lateness_ticks() / 2);
        let mut until = Until::new(|| seat.is_running(), self.duration_s.map(Duration::from_secs_f64));
        let mut taps = (samples.then(|| Late::of(Topic::Imu)), Late::of(Topic::Attitude));
        let (mut kept, mut came, mut joined) = (VecDeque::<ImuSample>::new(), Vec::<AttitudeOutput>::new(), !samples);
        while !until.is_over() {
            if let Some(tap) = taps.1.tap(seat)? {
                tap.drain(&mut |bytes| came.extend(bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes)))?;
            }
            // The sample of a tick is published before its attitude, and so is here once that has come.
            if let Some(tap) = taps.0.as_mut().map(|late| late.tap(seat)).transpose()?.flatten() {
                tap.drain(&mut |bytes| kept.extend(bytemuck::try_pod_read_unaligned::<ImuSample>(bytes)))?;
                kept.drain(..kept.len().saturating_sub(MAX_SAMPLES));
            }
            for output in came.drain(..) {
                reorder_buffer.offer(output, &mut |output, _| {
                    while kept.front().is_some_and(|sample| sample.header.tick < output.header.tick) {
                        kept.pop_front();
                    }
                    let sample = kept.front().filter(|sample| sample.header.tick == output.header.tick);
                    // Samples of the first attitudes may have passed before the topic was opened.
                    joined |= sample.is_some();
                    if joined {
                        sender.take(&output, sample);
                    }
                });
            }
            sender.look();
            thread::sleep(LOOK);
        }
        Ok(())
    }
}

/// A topic that may not be there yet.
struct Late {
    topic: Topic,
    tap: Option<Tap>,
    sought: Option<Instant>,
}

impl Late {
    fn of(topic: Topic) -> Self {
        Self { topic, tap: None, sought: None }
    }

    fn tap(&mut self, seat: &Observer) -> Result<Option<&Tap>, BusError> {
        if self.tap.is_none() && self.sought.is_none_or(|sought| sought.elapsed() >= OPEN_INTERVAL) {
            self.sought = Some(Instant::now());
            self.tap = match seat.tap(self.topic) {
                Ok(tap) => Some(tap),
                Err(BusError::TopicNotOpen { .. }) => None,
                Err(error) => return Err(error),
            };
        }
        Ok(self.tap.as_ref())
    }
}

impl fmt::Display for Sent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { attitudes, heartbeats, unaligned, invalid, stale, dropped } = self;
        write!(f, "{attitudes} attitudes sent")?;
        heartbeats.iter().try_for_each(|beats| write!(f, ", {beats} heartbeats"))?;
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
