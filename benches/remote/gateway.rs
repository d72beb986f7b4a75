//! Variants `each` and `batches`: `attitude` is published on the bus, sent by the gateway and
//! decoded by another process.

use std::time::Duration;

use bus::{Bus, SystemName};
use bytemuck::Zeroable as _;
use launch::{Gateway, TopicRate};
use link::{Endpoints, Link};
use messages::{AttitudeOutput, Header, Message};
use runtime::service_config::FIRST_EPOCH;
use wire::keys;

use crate::{
    Cost, Failure, Variant, hop,
    hop_end::{self, End, MAX_WAIT, ProcessSettings},
    sample::attitude,
    system::{self, System},
};

/// Time allowed for the far end to connect.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Message rate above every sample rate, so that each sample is sent in its own message.
const UNBATCHED_HZ: f64 = 10_000.0;

/// Measures the variant `each` or `batches`.
pub(crate) fn run(variant: Variant, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let name = format!("bench-remote-{}", std::process::id());
    let rates = [(AttitudeOutput::TOPIC.name.to_owned(), TopicRate::All)].into();
    let default = Gateway::default();
    let messages_hz = if variant == Variant::Each { UNBATCHED_HZ } else { default.messages_hz };
    let system = System::new(&name, rate_hz, Gateway { rates, messages_hz, ..default })?;
    let settings = |end, address: &str| ProcessSettings::new(variant, end, address, rate_hz, seconds);
    let mut near = hop::start(&settings(End::Near, &name))?;
    let gateway = system.gateway()?;
    let mut far = hop::start(&settings(End::Far, &system.endpoint()))?;
    hop::measure(&settings(End::Far, ""), &mut near, &[gateway], &mut far)
}

/// Runs one process of the variant `each` or `batches`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    match settings.end {
        End::Near => {
            let bus = Bus::join(&SystemName::new(&settings.address)?, "near")?;
            let publisher = bus.publisher::<AttitudeOutput>(system::buffer_ticks(settings.rate_hz))?;
            hop_end::send(settings, |tick, now_ns| {
                publisher.send(&attitude(header(tick, now_ns)))?;
                publisher.wake();
                Ok(())
            })
        }
        End::Far => {
            let link = Link::open(&Endpoints::with_connect(std::slice::from_ref(&settings.address)))?;
            let stream = link.subscribe(&keys::key("*", AttitudeOutput::TOPIC.name))?;
            if !link.wait_for_peer(CONNECT_TIMEOUT) {
                return Err(format!("no gateway is reachable at {}", settings.address).into());
            }
            hop_end::receive(settings, |record| {
                if let Some(arrival) = stream.next(MAX_WAIT) {
                    let (_, samples) = wire::decode_batch::<AttitudeOutput>(&arrival.bytes)?;
                    samples.iter().for_each(|sample| record(sample.header.tick, sample.header.t_born_ns));
                }
                Ok(())
            })
        }
    }
}

/// Returns the encoded length, in bytes, of a message that contains one attitude.
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

/// Returns the header of a tick with timestamps derived from the current time.
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
