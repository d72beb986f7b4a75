//! Telemetry: a process publishes `attitude`, the gateway sends it, another process decodes it.

use std::time::Duration;

use bus::{Bus, SystemName};
use bytemuck::Zeroable as _;
use launch::{Gateway, TopicRate};
use link::{Endpoints, Link};
use messages::{AttitudeOutput, Header, Message};
use runtime::service_config::FIRST_EPOCH;
use wire::keys;

use crate::{
    Cost, Failure, Variant,
    part::{self, End, Part, WAIT_LIMIT},
    sample::attitude,
    system::{self, System},
    watched,
};

/// From the start until the far end must be connected.
const LIMIT: Duration = Duration::from_secs(10);
/// More messages a second than there are samples.
const EACH_HZ: f64 = 10_000.0;

/// Measures the variant.
pub(crate) fn run(variant: Variant, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let name = format!("bench-remote-{}", std::process::id());
    let rates = [(AttitudeOutput::TOPIC.name.to_owned(), TopicRate::All)].into();
    let default = Gateway::default();
    let messages_hz = if variant == Variant::Each { EACH_HZ } else { default.messages_hz };
    let system = System::new(&name, rate_hz, Gateway { rates, messages_hz, ..default })?;
    let part = |end, at: &str| Part::new(variant, end, at, rate_hz, seconds);
    let mut near = watched::start(&part(End::Near, &name))?;
    let gateway = system.gateway()?;
    let mut far = watched::start(&part(End::Far, &system.endpoint()))?;
    watched::watch(&part(End::Far, ""), &mut near, &[gateway], &mut far)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    match part.end {
        End::Near => {
            let bus = Bus::join(&SystemName::new(&part.at)?, "near")?;
            let publisher = bus.publisher::<AttitudeOutput>(system::buffer_ticks(part.rate_hz))?;
            part::send(part, |tick, now_ns| {
                publisher.send(&attitude(header(tick, now_ns)))?;
                publisher.wake();
                Ok(())
            })
        }
        End::Far => {
            let link = Link::open(&Endpoints::with_connect(std::slice::from_ref(&part.at)))?;
            let stream = link.subscribe(&keys::key("*", AttitudeOutput::TOPIC.name))?;
            if !link.wait_for_peer(LIMIT) {
                return Err(format!("nobody is at {}", part.at).into());
            }
            part::receive(part, |take| {
                if let Some(arrival) = stream.next(WAIT_LIMIT) {
                    let (_, samples) = wire::decode_batch::<AttitudeOutput>(&arrival.bytes)?;
                    samples.iter().for_each(|sample| take(sample.header.tick, sample.header.t_born_ns));
                }
                Ok(())
            })
        }
    }
}

/// Length of the message of one attitude.
pub(crate) fn message_bytes() -> usize {
    let now_ns = runtime::clock::monotonic_ns();
    let envelope = wire::v1::Envelope {
        sequence: 1000,
        start_ns: now_ns,
        samples_before: 1000,
        t_sent_ns: now_ns,
        ..Default::default()
    };
    wire::encode_batch(&envelope, &wire::encode_samples([&attitude(header(1000, now_ns))])).len()
}

/// The header of a tick that is born now.
pub(crate) fn header(tick: u64, now_ns: u64) -> Header {
    let t_end_ns = now_ns.cast_signed();
    Header {
        tick,
        t_start_ns: t_end_ns - 100_000,
        t_end_ns,
        t_born_ns: now_ns,
        t_sent_ns: now_ns,
        epoch: FIRST_EPOCH,
        incarnation: 1,
        ..Header::zeroed()
    }
}
