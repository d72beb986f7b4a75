//! A split system: a process publishes `imu` on the bus of one system, another reads it on the bus of the other.

use bus::{Bus, SystemName};
use bytemuck::Zeroable as _;
use launch::{Gateway, Import};
use messages::{Credit, ImuSample, Message};
use runtime::service_config::CONTROL_BUFFER;

use crate::{
    Cost, Failure, Variant,
    gateway::header,
    part::{self, End, Part, WAIT_LIMIT},
    system::{self, System},
    watched,
};

/// Measures the variant.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let names = ["board", "base"].map(|host| format!("bench-{host}-{}", std::process::id()));
    let [board, base] = &names;
    let topics = vec![ImuSample::TOPIC.name.to_owned()];
    let quiet = || Gateway { rates: [].into(), ..Gateway::default() };
    let exporting = System::new(board, rate_hz, Gateway { export: topics.clone(), ..quiet() })?;
    let import = Some(Import { vehicle: board.clone(), topics });
    let importing = System::new(base, rate_hz, Gateway { import, connect: vec![exporting.endpoint()], ..quiet() })?;
    let part = |end, at: &str| Part::new(Variant::Carried, end, at, rate_hz, seconds);
    let mut far = watched::start(&part(End::Far, base))?;
    let mut near = watched::start(&part(End::Near, board))?;
    let gateways = [exporting.gateway()?, importing.gateway()?];
    watched::watch(&part(End::Far, ""), &mut near, &gateways, &mut far)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    let bus = Bus::join(&SystemName::new(&part.at)?, "end")?;
    let buffer_ticks = system::buffer_ticks(part.rate_hz);
    match part.end {
        End::Near => {
            let publisher = bus.publisher::<ImuSample>(buffer_ticks)?;
            part::send(part, |tick, now_ns| {
                publisher.send(&ImuSample { header: header(tick, now_ns), ..ImuSample::zeroed() })?;
                publisher.wake();
                Ok(())
            })
        }
        End::Far => {
            let subscriber = bus.subscriber::<ImuSample>(buffer_ticks)?;
            // Leave for all ticks there are.
            let credit = bus.publisher::<Credit>(CONTROL_BUFFER)?;
            credit.send(&Credit { ticks: u64::MAX / 2, ends: 0 })?;
            let mut heard = false;
            part::receive(part, |take| {
                if !heard {
                    credit.deliver_history()?;
                }
                subscriber.wait(WAIT_LIMIT);
                Ok(subscriber.drain(buffer_ticks, |sample| {
                    heard = true;
                    take(sample.header.tick, sample.header.t_born_ns);
                })?)
            })
        }
    }
}
