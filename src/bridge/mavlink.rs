//! `plumb bridge mavlink`: sends attitudes as MAVLink 2 over UDP.

use std::time::{Duration, Instant};

use bridges::{
    datagrams::{DatagramError, DatagramSender, Endpoint},
    mavlink::{HeartbeatStatus, MavlinkAttitude, MavlinkEncoder, MavlinkPosition, ONBOARD_COMPUTER_COMPONENT_ID},
    validity,
};
use clap::Args;
use launch::TopicRate;
use messages::{AttitudeOutput, GnssFix, ImuSample};
use runtime::{clock::monotonic_ns, decimator::Decimator};

use super::sender::{AttitudeSender, BridgeArgs, Inputs, SendCounts, rate_hz};
use crate::{failure::Outcome, stdout::print_result};

/// Interval between two heartbeats.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Time without an attitude after which heartbeats carry the status [`HeartbeatStatus::Silent`].
const SILENCE_TIMEOUT: Duration = Duration::from_secs(1);

/// Arguments of `plumb bridge mavlink`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb bridge mavlink --component-id 1       # a vehicle in QGroundControl
  plumb bridge mavlink --to udpout:192.168.1.9:14550 --rate-hz 20
  plumb bridge mavlink --system-id 7 --for 10s  # next to an autopilot

Sends HEARTBEAT, ATTITUDE_QUATERNION, ATTITUDE, ODOMETRY and, for each fix with
a position, GLOBAL_POSITION_INT. Only component 1 is shown as a vehicle
(docs/how-to/bridges.md).")]
pub(crate) struct Mavlink {
    #[command(flatten)]
    args: BridgeArgs,
    /// Destination of the datagrams
    #[arg(long, value_name = "udpout:HOST:PORT", default_value = "udpout:127.0.0.1:14550")]
    to: Endpoint,
    /// Attitudes per second of source time, Hz, 0.1 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 50.0, value_parser = rate_hz)]
    rate_hz: f64,
    /// MAVLink system id; use the autopilot's if there is one
    #[arg(long, value_name = "1…255", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    system_id: u8,
    /// MAVLink component id: 191 for an onboard computer, 1 for a vehicle
    #[arg(long, value_name = "1…255", default_value_t = ONBOARD_COMPUTER_COMPONENT_ID, value_parser = clap::value_parser!(u8).range(1..))]
    component_id: u8,
}

impl Mavlink {
    pub(super) fn run(&self) -> Outcome {
        let observer = self.args.attach()?;
        let mut sender = MavlinkSender::open(self)?;
        self.args.forward(&observer, Inputs { fixes: true, ..Inputs::default() }, &mut sender)?;
        Ok(print_result(&sender.counts, self.args.system.json))
    }
}

/// Sender of MAVLink messages to one address.
struct MavlinkSender {
    speaker: MavlinkEncoder,
    datagrams: DatagramSender,
    decimator: Decimator,
    last_heartbeat: Option<Instant>,
    /// Newest attitude sent, and the time of sending.
    last_attitude: Option<(MavlinkAttitude, Instant)>,
    /// Altitude of the first fix sent, m.
    first_altitude_m: Option<f64>,
    counts: SendCounts,
}

impl MavlinkSender {
    fn open(mavlink: &Mavlink) -> Result<Self, DatagramError> {
        Ok(Self {
            speaker: MavlinkEncoder::new(mavlink.system_id, mavlink.component_id),
            datagrams: DatagramSender::open(&mavlink.to)?,
            decimator: Decimator::new(TopicRate::Hz(mavlink.rate_hz)),
            last_heartbeat: None,
            last_attitude: None,
            first_altitude_m: None,
            counts: SendCounts { heartbeats: Some(0), fixes: Some(0), ..SendCounts::default() },
        })
    }
}

impl AttitudeSender for MavlinkSender {
    fn send(&mut self, output: &AttitudeOutput, _sample: Option<&ImuSample>) {
        if !self.decimator.accept(output.header.t_end_ns) {
            return;
        }
        if let Err(why) = validity::validate(output, monotonic_ns()) {
            return self.counts.withhold(why);
        }
        let attitude = MavlinkAttitude::new(output);
        let speaker = &mut self.speaker;
        let frames = [speaker.attitude_quaternion(&attitude), speaker.attitude(&attitude), speaker.odometry(&attitude)];
        for frame in frames {
            self.counts.dropped += u64::from(!self.datagrams.send(&frame));
        }
        self.counts.attitudes += 1;
        self.last_attitude = Some((attitude, Instant::now()));
    }

    fn send_fix(&mut self, fix: &GnssFix) {
        let recent = self.last_attitude.as_ref().filter(|(_, sent)| sent.elapsed() < SILENCE_TIMEOUT);
        let attitude = recent.map(|(attitude, _)| attitude);
        let Some(position) = MavlinkPosition::new(fix, self.first_altitude_m, attitude) else { return };
        if let Err(why) = validity::check_age(&fix.header, monotonic_ns()) {
            return self.counts.withhold(why);
        }
        self.first_altitude_m.get_or_insert(fix.altitude_m);
        let frame = self.speaker.global_position(&position);
        self.counts.dropped += u64::from(!self.datagrams.send(&frame));
        self.counts.fixes.iter_mut().for_each(|fixes| *fixes += 1);
    }

    /// Sends a heartbeat if one is due.
    fn poll(&mut self) {
        if self.last_heartbeat.is_some_and(|last_heartbeat| last_heartbeat.elapsed() < HEARTBEAT_INTERVAL) {
            return;
        }
        // A late heartbeat does not delay the next one, unless it is late by a whole interval.
        let due = self.last_heartbeat.map(|last_heartbeat| last_heartbeat + HEARTBEAT_INTERVAL);
        self.last_heartbeat = due.filter(|due| due.elapsed() < HEARTBEAT_INTERVAL).or_else(|| Some(Instant::now()));
        let condition = match &self.last_attitude {
            None => HeartbeatStatus::Starting,
            Some((_, sent)) if sent.elapsed() < SILENCE_TIMEOUT => HeartbeatStatus::Active,
            Some(_) => HeartbeatStatus::Silent,
        };
        let frame = self.speaker.heartbeat(condition);
        self.counts.dropped += u64::from(!self.datagrams.send(&frame));
        self.counts.heartbeats.iter_mut().for_each(|beats| *beats += 1);
    }
}
