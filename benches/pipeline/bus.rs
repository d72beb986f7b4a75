//! The bus alone: processes that pass the header of each message on, over the topics `imu`, `gyro` and `fused`.

use bus::{Bus, Domain, Publisher, Subscriber};
use messages::{FusedState, GyroStep, ImuSample, Message, Ticked};

use crate::{
    Cost, Failure, Variant,
    chain::{self, Inlet, LINK_SAMPLES, Outlet, Part, WAIT_LIMIT},
};

struct In<M: Message>(Subscriber<M>);

impl<M: Ticked> Inlet for In<M> {
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
    let _claim = Domain::new(&name)?.claim()?;
    chain::run(Variant::Bus, &name, rate_hz, seconds)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    chain::end_with_parent()?;
    let member = Member { bus: Bus::join(&Domain::new(&part.share)?, &format!("place-{}", part.place))?, part };
    match part.place {
        0 => chain::source(part, member.outlet::<ImuSample>()?),
        1 => member.relay::<ImuSample, GyroStep>(),
        2 => member.relay::<GyroStep, FusedState>(),
        _ => chain::sink(part, member.inlet::<FusedState>()?),
    }
}

struct Member<'a> {
    bus: Bus,
    part: &'a Part,
}

impl Member<'_> {
    fn inlet<M: Message>(&self) -> Result<In<M>, Failure> {
        Ok(In(self.bus.subscriber(LINK_SAMPLES)?))
    }

    fn outlet<M: Message>(&self) -> Result<Out<M>, Failure> {
        Ok(Out(self.bus.publisher(LINK_SAMPLES)?))
    }

    fn relay<A: Ticked, B: Ticked>(&self) -> Result<(), Failure> {
        chain::relay(self.part, self.inlet::<A>()?, self.outlet::<B>()?, |sample| {
            let mut passed = B::zeroed();
            *passed.header_mut() = *sample.header();
            passed
        })
    }
}
