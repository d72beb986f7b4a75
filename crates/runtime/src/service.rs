//! The loop of a service over the bus.

use bus::{BusError, Publisher, Subscriber};
use messages::{Checkpoint, Control, State, Ticked};

use crate::{
    Role, RuntimeError, ServiceContext, clock::monotonic_ns, comparable::Comparable, reader::Input,
    service_config::BUFFER_BESIDE, shadow::Shadowing, slot::Slot, slot_service::SlotService, turns::take_turns,
};

/// However much there is to do, after so long a service says how it is and looks at the decisions.
const TURN_LIMIT_NS: u64 = 50_000_000;

/// Runs a slot until the service is to end. `inputs` are in the slot's own order.
pub fn serve<S: Slot>(context: ServiceContext, slot: S, inputs: &[&dyn Input<S::Input>]) -> Result<(), RuntimeError> {
    let input_tick = inputs.iter().map(|input| input.next_tick()).max().unwrap_or(0);
    let output: Publisher<S::Output> = context.publisher()?;
    let (service, refused) = SlotService::new(slot, context.service, &context.config, input_tick, output.next_tick());
    if let Some(error) = refused {
        eprintln!("the service {} does not go on from its checkpoint: {error}; it begins anew", context.service);
    }
    let mut serving = Serving {
        output,
        checkpoints: context.bus.publisher(BUFFER_BESIDE)?,
        control: context.control()?,
        shadow: match context.config.role {
            Role::Owner { .. } => None,
            Role::Candidate => Some(Shadowing::begin(&context)?),
        },
        service,
        context,
    };
    serving.publish_health(inputs, State::READY)?;
    serving.context.bus.wake_all();
    while !serving.context.ends() {
        serving.poll(inputs)?;
        serving.follow_decisions()?;
        serving.publish_checkpoint()?;
        let state = if serving.service.ticks() > 0 { State::RUNNING } else { State::READY };
        serving.publish_health(inputs, state)?;
        if let Some(lacking) = inputs.get(serving.service.lacks()) {
            serving.context.wait(*lacking);
        }
    }
    Ok(())
}

/// A slot's service at work on the bus.
struct Serving<S: Slot> {
    context: ServiceContext,
    service: SlotService<S>,
    output: Publisher<S::Output>,
    checkpoints: Publisher<Checkpoint>,
    control: Subscriber<Control>,
    shadow: Option<Shadowing<S::Output>>,
}

impl<S: Slot> Serving<S>
where
    S::Output: Comparable,
{
    /// Takes what the inputs hold and publishes what follows from it, as far as the slot is owned.
    fn poll(&mut self, inputs: &[&dyn Input<S::Input>]) -> Result<(), RuntimeError> {
        self.output.deliver_history()?;
        let (before, begun_ns) = (self.service.ticks(), monotonic_ns());
        let published = self.service.publishes();
        let Self { context, service, output, shadow, .. } = self;
        let turn = context.config.turn();
        let mut looks_left = inputs.len() * (context.config.buffer_ticks() / turn + 1);
        let goes_on = |service: &mut SlotService<S>| {
            if service.ticks() != before {
                output.wake();
            }
            looks_left = looks_left.saturating_sub(1);
            looks_left > 0 && monotonic_ns() - begun_ns <= TURN_LIMIT_NS
        };
        take_turns(service, inputs.len(), goes_on, SlotService::lacks, |service, input| {
            let (mut taken, mut failed) = (0, None);
            inputs[input].drain(turn, &mut |message| {
                taken += 1;
                let mut computed = |out: &S::Output| shadow.iter_mut().for_each(|shadow| shadow.computed(out));
                service.offer(message, &mut computed, &mut |out| {
                    failed = failed.take().or(publish(output, out).err());
                });
            })?;
            match (failed, service.failure()) {
                (Some(error), _) => Err(RuntimeError::from(error)),
                (None, Some(why)) => Err(RuntimeError::Failed { slot: context.service, why }),
                (None, None) => Ok(taken),
            }
        })?;
        // Whoever takes over is confirmed by that.
        if published && !service.publishes() {
            context.publish_health_at_once();
        }
        Ok(())
    }

    /// Follows the decisions about the slot.
    fn follow_decisions(&mut self) -> Result<(), RuntimeError> {
        let Self { context, service, output, control, .. } = self;
        let (mut failed, mut decided) = (None, false);
        control.drain(BUFFER_BESIDE, |control| {
            decided |= service.decide(&control, &mut |out| failed = failed.take().or(publish(output, out).err()));
        })?;
        if decided {
            output.wake();
            context.publish_health_at_once();
        }
        // Who owns the slot is no shadow.
        self.shadow.take_if(|_| service.publishes());
        if let Some(shadow) = &mut self.shadow {
            shadow.compare()?;
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Publishes the state every so many ticks.
    fn publish_checkpoint(&mut self) -> Result<(), RuntimeError> {
        let Some(checkpoint) = self.service.checkpoint() else { return Ok(()) };
        match self.service.failure() {
            Some(why) => Err(RuntimeError::Failed { slot: self.context.service, why }),
            None => Ok(self.checkpoints.send(&checkpoint)?),
        }
    }

    fn publish_health(&mut self, inputs: &[&dyn Input<S::Input>], state: State) -> Result<(), RuntimeError> {
        let service = &self.service;
        self.context.publish_health(state, |health| {
            service.describe(health);
            for input in inputs {
                let [again, said_again] = input.repeated();
                health.duplicated += again;
                health.repeated += said_again;
            }
        })
    }
}

/// Sends an output that the service owns.
fn publish<O: Ticked>(output: &Publisher<O>, mut out: O) -> Result<(), BusError> {
    let header = out.header_mut();
    header.t_sent_ns = monotonic_ns();
    output.set_next_tick_after(header.tick);
    output.send(&out)
}
