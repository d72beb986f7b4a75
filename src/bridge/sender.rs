//! Forwards attitudes over another protocol: arguments, main loop and message counts.

use std::{collections::VecDeque, fmt, thread, time::Duration};

use bridges::validity::WithholdReason;
use bus::{BusError, Observer};
use clap::Args;
use control::{ControlRequest, send_request};
use graph::Topic;
use messages::{AttitudeOutput, GnssFix, ImuSample, MagSample, Ticked};
use runtime::{ServiceConfig, service_config::FIRST_EPOCH};
use serde::Serialize;
use swap::ReorderBuffer;

use crate::{
    duration::duration,
    failure::Failure,
    system::LocalSystemArgs,
    topics::{LateTopic, POLL_INTERVAL, StopCondition, observer},
};

/// Maximum number of samples kept until the attitudes of their ticks arrive.
pub(super) const MAX_SAMPLES: usize = 16_384;

/// Arguments that select the system and the time.
#[derive(Args)]
pub(super) struct BridgeArgs {
    #[command(flatten)]
    pub(super) system: LocalSystemArgs,
    /// Time before stopping, such as 500ms, 10s or 1h [default: unlimited]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(super) duration: Option<Duration>,
}

/// Running system and the observer that a bridge has attached to it.
pub(super) struct AttachedSystem {
    pub(super) name: String,
    pub(super) observer: Observer,
}

/// Sender of attitudes in another protocol.
pub(super) trait AttitudeSender {
    /// Sends an attitude. Called once per tick, in tick order. `sample` is the sample of the same
    /// tick, if samples are read.
    fn send(&mut self, output: &AttitudeOutput, sample: Option<&ImuSample>);
    /// Sends a magnetic field. Called only if the bridge reads magnetic fields.
    fn send_field(&mut self, _field: &MagSample) {}
    /// Sends a fix. Called only if the bridge reads fixes.
    fn send_fix(&mut self, _fix: &GnssFix) {}
    /// Does periodic work, such as sending a heartbeat. Called several times a second, after all
    /// available attitudes have been sent.
    fn poll(&mut self);
}

/// Topics of the system that a bridge reads in addition to the attitude.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Inputs {
    pub(super) samples: bool,
    pub(super) fields: bool,
    pub(super) fixes: bool,
}

/// Topic that has a message only for some ticks.
struct AidingTopic {
    late: LateTopic,
    next_tick: u64,
}

impl AidingTopic {
    fn new(topic: Topic) -> Self {
        Self { late: LateTopic::new(topic), next_tick: 0 }
    }

    /// Passes new messages to `on_message`, in tick order. Skips messages that a restarted service
    /// published again.
    fn drain<M: Ticked>(&mut self, observer: &Observer, on_message: &mut dyn FnMut(&M)) -> Result<(), BusError> {
        let Self { late, next_tick } = self;
        let Some(tap) = late.tap(observer)? else { return Ok(()) };
        tap.drain(&mut |bytes| {
            let message = bytemuck::try_pod_read_unaligned::<M>(bytes).ok();
            if let Some(message) = message.filter(|message| message.header().tick >= *next_tick) {
                *next_tick = message.header().tick + 1;
                on_message(&message);
            }
        })?;
        Ok(())
    }
}

/// Counts of attitudes sent and withheld, and of messages dropped.
#[derive(Debug, Default, Serialize)]
pub(super) struct SendCounts {
    /// Number of attitudes sent.
    pub(super) attitudes: u64,
    /// Number of heartbeats sent; `None` if the protocol has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) heartbeats: Option<u64>,
    /// Number of magnetic fields sent; `None` if the bridge sends none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fields: Option<u64>,
    /// Number of fixes sent; `None` if the bridge sends none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fixes: Option<u64>,
    /// Number of diagnostic messages sent; `None` if the bridge sends none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) diagnostics: Option<u64>,
    /// Number of attitudes not sent because they were flagged as not aligned yet.
    pub(super) unaligned: u64,
    /// Number of attitudes not sent because the rotation was not finite or a required sample was
    /// missing.
    pub(super) invalid: u64,
    /// Number of attitudes, magnetic fields and fixes not sent because they were too old.
    pub(super) stale: u64,
    /// Number of messages not accepted by the network.
    pub(super) dropped: u64,
}

impl SendCounts {
    pub(super) fn withhold(&mut self, why: WithholdReason) {
        match why {
            WithholdReason::Unaligned => self.unaligned += 1,
            WithholdReason::Invalid => self.invalid += 1,
            WithholdReason::Stale => self.stale += 1,
        }
    }
}

impl BridgeArgs {
    /// Attaches to the selected system.
    pub(super) fn attach(&self) -> Result<AttachedSystem, Failure> {
        let name = self.system.name()?;
        Ok(AttachedSystem { observer: observer(&name, "bridge")?, name })
    }

    /// Sends attitudes until the time limit is reached, a signal arrives or the system ends.
    pub(super) fn forward(
        &self,
        AttachedSystem { name, observer }: &AttachedSystem,
        inputs: Inputs,
        sender: &mut dyn AttitudeSender,
    ) -> Result<(), Failure> {
        let config = send_request::<ServiceConfig>(name, &ControlRequest::ServiceConfig)?;
        let mut reorder_buffer = ReorderBuffer::with_unknown_start(FIRST_EPOCH, config.lateness_ticks() / 2);
        let mut stop = StopCondition::new(|| observer.is_running(), self.duration);
        let mut taps = (inputs.samples.then(|| LateTopic::new(Topic::Imu)), LateTopic::new(Topic::Attitude));
        let mut fields = inputs.fields.then(|| AidingTopic::new(Topic::Mag));
        let mut fixes = inputs.fixes.then(|| AidingTopic::new(Topic::Gnss));
        let (mut samples, mut arrived, mut is_joined) =
            (VecDeque::<ImuSample>::new(), Vec::<AttitudeOutput>::new(), !inputs.samples);
        while !stop.is_met() {
            if let Some(tap) = taps.1.tap(observer)? {
                tap.drain(&mut |bytes| arrived.extend(bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes)))?;
            }
            // A sample is published before the attitude of its tick, so it is available by now.
            if let Some(tap) = taps.0.as_mut().map(|late| late.tap(observer)).transpose()?.flatten() {
                tap.drain(&mut |bytes| samples.extend(bytemuck::try_pod_read_unaligned::<ImuSample>(bytes)))?;
                samples.drain(..samples.len().saturating_sub(MAX_SAMPLES));
            }
            for output in arrived.drain(..) {
                reorder_buffer.offer(output, &mut |output, _| {
                    while samples.front().is_some_and(|sample| sample.header.tick < output.header.tick) {
                        samples.pop_front();
                    }
                    let sample = samples.front().filter(|sample| sample.header.tick == output.header.tick);
                    // The samples of the first attitudes may have been published before their topic
                    // was opened, so no attitude is sent before the first one that has a sample.
                    is_joined |= sample.is_some();
                    if is_joined {
                        sender.send(&output, sample);
                    }
                });
            }
            if let Some(fields) = &mut fields {
                fields.drain(observer, &mut |field| sender.send_field(field))?;
            }
            if let Some(fixes) = &mut fixes {
                fixes.drain(observer, &mut |fix| sender.send_fix(fix))?;
            }
            sender.poll();
            thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }
}

impl fmt::Display for SendCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { attitudes, heartbeats, fields, fixes, diagnostics, unaligned, invalid, stale, dropped } = self;
        write!(f, "{attitudes} attitudes sent")?;
        let also_sent = [
            (heartbeats, "heartbeats"),
            (fields, "magnetic fields"),
            (fixes, "fixes"),
            (diagnostics, "diagnostic messages"),
        ];
        for (count, what) in also_sent.into_iter().filter_map(|(count, what)| Some(((*count)?, what))) {
            write!(f, ", {count} {what}")?;
        }
        let withheld = [(unaligned, "unaligned attitudes"), (invalid, "invalid attitudes"), (stale, "stale messages")];
        for (count, what) in withheld.into_iter().filter(|(count, _)| **count > 0) {
            write!(f, ", {count} {what} not sent")?;
        }
        if *dropped > 0 {
            write!(f, "; {dropped} messages dropped by the network")?;
        }
        Ok(())
    }
}

pub(super) fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz| (0.1..=1000.0).contains(hz));
    hz.ok_or_else(|| "expected a rate in Hz from 0.1 to 1000".into())
}
