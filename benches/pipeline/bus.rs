//! The bus alone: processes that pass the header of each message on, over the topics `imu`, `gyro`, `accel` and `fused`.

use bus::{Bus, Publisher, Subscriber, SystemName};
use messages::{AccelPoint, FusedState, GyroStep, ImuSample, Message, Ticked};

use crate::{
    Cost, Failure, Variant,
    chain::{self, Input, Join, Outlet, Part, Place, TOPIC_SAMPLES, WAIT_LIMIT},
};

struct In<M: Message>(Subscriber<M>);

impl<M: Ticked> Input for In<M> {
    type Sample = M;

    fn receive(&mut self) -> Result<Option<M>, Failure> {
        Ok(self.0.receive()?)
    }

    fn wait(&mut self) {
        self.0.wait(WAIT_LIMIT);
    }
}

struct Out<M: Message>(Publisher<M>);

impl<M: Ticked> Outlet for Out<M> {
    type Sample = M;

    fn send(&mut self, sample: &M) -> Result<(), Failure> {
        Ok(self.0.send(sample)?)
    }

    fn wake(&mut self) {
        self.0.wake();
    }
}

/// Measures the variant.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let name = format!("bench-bus-{}", std::process::id());
    let _claim = SystemName::new(&name)?.claim()?;
    chain::run(Variant::Bus, &name, rate_hz, seconds)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    chain::end_with_parent()?;
    let bus = Bus::join(&SystemName::new(&part.share)?, &format!("{:?}", part.place).to_lowercase())?;
    match part.place {
        Place::Source => chain::source(part, outlet::<ImuSample>(&bus)?),
        Place::Gyro => chain::relay(part, input::<ImuSample>(&bus)?, outlet::<GyroStep>(&bus)?, pass),
        Place::Accel => chain::relay(part, input::<ImuSample>(&bus)?, outlet::<AccelPoint>(&bus)?, pass),
        Place::Fuser => {
            let join = Join::new(input::<GyroStep>(&bus)?, input::<AccelPoint>(&bus)?);
            chain::relay(part, join, outlet::<FusedState>(&bus)?, pass)
        }
        Place::Sink => chain::sink(part, input::<FusedState>(&bus)?),
    }
}

fn input<M: Message>(bus: &Bus) -> Result<In<M>, Failure> {
    Ok(In(bus.subscriber(TOPIC_SAMPLES)?))
}

fn outlet<M: Message>(bus: &Bus) -> Result<Out<M>, Failure> {
    Ok(Out(bus.publisher(TOPIC_SAMPLES)?))
}

/// A message with the header of another.
fn pass<A: Ticked, B: Ticked>(sample: &A) -> B {
    let mut passed = B::zeroed();
    *passed.header_mut() = *sample.header();
    passed
}
