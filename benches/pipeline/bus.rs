//! Variant `bus`: processes that forward the header of each message over the bus topics `imu`,
//! `gyro`, `accel` and `fused`.

use bus::{Bus, Publisher, Subscriber, SystemName};
use messages::{AccelPoint, FusedState, GyroStep, ImuSample, Message, Ticked};

use crate::{
    Cost, Failure, Variant,
    chain::{self, ChainRole, Input, Join, MAX_WAIT, Output, ProcessSettings, TOPIC_SAMPLES},
};

struct BusInput<M: Message>(Subscriber<M>);

impl<M: Ticked> Input for BusInput<M> {
    type Sample = M;

    fn receive(&mut self) -> Result<Option<M>, Failure> {
        Ok(self.0.receive()?)
    }

    fn wait(&mut self) {
        self.0.wait(MAX_WAIT);
    }
}

struct BusOutput<M: Message>(Publisher<M>);

impl<M: Ticked> Output for BusOutput<M> {
    type Sample = M;

    fn send(&mut self, sample: &M) -> Result<(), Failure> {
        Ok(self.0.send(sample)?)
    }

    fn wake(&mut self) {
        self.0.wake();
    }
}

/// Measures the variant `bus`.
pub(crate) fn run(rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let name = format!("bench-bus-{}", std::process::id());
    let _claim = SystemName::new(&name)?.claim()?;
    chain::run(Variant::Bus, &name, rate_hz, seconds)
}

/// Runs one process of the variant `bus`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    chain::die_with_parent()?;
    let bus = Bus::join(&SystemName::new(&settings.shared_name)?, &format!("{:?}", settings.role).to_lowercase())?;
    match settings.role {
        ChainRole::Source => chain::source(settings, output::<ImuSample>(&bus)?),
        ChainRole::Gyro => chain::relay(settings, input::<ImuSample>(&bus)?, output::<GyroStep>(&bus)?, forward),
        ChainRole::Accel => chain::relay(settings, input::<ImuSample>(&bus)?, output::<AccelPoint>(&bus)?, forward),
        ChainRole::Fuser => {
            let join = Join::new(input::<GyroStep>(&bus)?, input::<AccelPoint>(&bus)?);
            chain::relay(settings, join, output::<FusedState>(&bus)?, forward)
        }
        ChainRole::Sink => chain::sink(settings, input::<FusedState>(&bus)?),
    }
}

fn input<M: Message>(bus: &Bus) -> Result<BusInput<M>, Failure> {
    Ok(BusInput(bus.subscriber(TOPIC_SAMPLES)?))
}

fn output<M: Message>(bus: &Bus) -> Result<BusOutput<M>, Failure> {
    Ok(BusOutput(bus.publisher(TOPIC_SAMPLES)?))
}

/// Returns a message with the header of the given message.
fn forward<A: Ticked, B: Ticked>(sample: &A) -> B {
    let mut passed = B::zeroed();
    *passed.header_mut() = *sample.header();
    passed
}
