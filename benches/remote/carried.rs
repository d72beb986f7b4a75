//! Variant `carried`, a split system: `imu` is published on the bus of one system and read on the
//! bus of another.

use bus::{Bus, SystemName};
use bytemuck::Zeroable as _;
use launch::{Gateway, Import};
use messages::{Credit, ImuSample, Message};
use runtime::service_config::CONTROL_BUFFER;

use crate::{
    Cost, Failure, Variant,
    gateway::header,
    hop,
    hop_end::{self, End, MAX_WAIT, ProcessSettings},
    system::{self, System},
};

/// Measures the variant `carried`.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let names = ["board", "base"].map(|host| format!("bench-{host}-{}", std::process::id()));
    let [board, base] = &names;
    let topics = vec![ImuSample::TOPIC.name.to_owned()];
    let quiet = || Gateway { rates: [].into(), ..Gateway::default() };
    let exporting = System::new(board, rate_hz, Gateway { export: topics.clone(), ..quiet() })?;
    let import = Some(Import { vehicle: board.clone(), topics });
    let importing = System::new(base, rate_hz, Gateway { import, connect: vec![exporting.endpoint()], ..quiet() })?;
    let settings = |end, address: &str| ProcessSettings::new(Variant::Carried, end, address, rate_hz, seconds);
    let mut far = hop::start(&settings(End::Far, base))?;
    let mut near = hop::start(&settings(End::Near, board))?;
    let gateways = [exporting.gateway()?, importing.gateway()?];
    hop::measure(&settings(End::Far, ""), &mut near, &gateways, &mut far)
}

/// Runs one process of the variant `carried`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    let bus = Bus::join(&SystemName::new(&settings.address)?, "end")?;
    let buffer_ticks = system::buffer_ticks(settings.rate_hz);
    match settings.end {
        End::Near => {
            let publisher = bus.publisher::<ImuSample>(buffer_ticks)?;
            hop_end::send(settings, |tick, now_ns| {
                publisher.send(&ImuSample { header: header(tick, now_ns), ..ImuSample::zeroed() })?;
                publisher.wake();
                Ok(())
            })
        }
        End::Far => {
            let subscriber = bus.subscriber::<ImuSample>(buffer_ticks)?;
            // Grants credit for all ticks.
            let credit = bus.publisher::<Credit>(CONTROL_BUFFER)?;
            credit.send(&Credit { ticks: u64::MAX / 2, ends: 0 })?;
            let mut has_received = false;
            hop_end::receive(settings, |record| {
                if !has_received {
                    credit.deliver_history()?;
                }
                subscriber.wait(MAX_WAIT);
                Ok(subscriber.drain(buffer_ticks, |sample| {
                    has_received = true;
                    record(sample.header.tick, sample.header.t_born_ns);
                })?)
            })
        }
    }
}
