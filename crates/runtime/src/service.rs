//! Main loop of a slot's service on the bus.

use bus::{BusError, Publisher, Subscriber};
use messages::{Checkpoint, Control, State, Ticked};

use crate::{
    Role, RuntimeError, ServiceContext, brief_wait::BriefWait, clock::monotonic_ns, input_scheduling::poll_fairly,
    ordered_subscriber::SlotInputs, service_config::CONTROL_BUFFER, shadow::ShadowComparison, slot::SlotProcessor,
    slot_service::SlotService,
};

/// Longest time for which inputs are polled before health is reported and decisions are checked,
/// regardless of the number of queued messages.
const MAX_POLL_NS: u64 = 50_000_000;

/// Runs the main loop of a service until it receives a stop request.
///
/// # Errors
///
/// Fails if the bus fails or the stage fails permanently.
pub fn serve(service: &mut dyn ServiceLoop) -> Result<(), RuntimeError> {
    while !service.should_stop() {
        service.run_round()?;
        service.wait();
    }
    Ok(())
}

/// Main loop of a service.
///
/// The services use it as a trait object. The generic [`SlotLoop`] is therefore compiled only in
/// the crate `slots`, which creates it.
pub trait ServiceLoop {
    /// Handles all available messages and decisions, and publishes what is due.
    ///
    /// # Errors
    ///
    /// Fails if the bus fails or the stage fails permanently.
    fn run_round(&mut self) -> Result<(), RuntimeError>;
    /// Sleeps until the input that the next output is waiting for has a message, or until the
    /// supervisor wakes the service.
    fn wait(&mut self);
    /// Returns `true` once the service has received a stop request.
    fn should_stop(&mut self) -> bool;
}

/// Main loop of a slot's service.
pub struct SlotLoop<S: SlotProcessor> {
    context: ServiceContext,
    inputs: SlotInputs<S::Input>,
    service: SlotService<S>,
    output: Publisher<S::Output>,
    checkpoints: Publisher<Checkpoint>,
    control: Subscriber<Control>,
    shadow: Option<ShadowComparison<S::Output>>,
    brief_wait: BriefWait,
    /// Number of messages that are read from one input before the others are polled.
    batch_size: usize,
    /// Maximum number of polls in a round that leave further messages unread.
    max_polls: usize,
}

impl<S: SlotProcessor> SlotLoop<S> {
    /// Opens the topics of the service and reports that it is ready.
    ///
    /// # Errors
    ///
    /// Fails if the bus fails.
    pub fn start(context: ServiceContext, slot: S, inputs: SlotInputs<S::Input>) -> Result<Self, RuntimeError> {
        let input_tick = inputs.iter().map(|input| input.next_tick()).max().unwrap_or(0);
        let output: Publisher<S::Output> = context.publisher()?;
        let (service, resume_error) = SlotService::new(slot, &context.config, input_tick, output.next_tick());
        if let Some(error) = resume_error {
            eprintln!("service {}: cannot resume: {error}; starting without a checkpoint", context.service);
        }
        let batch_size = context.config.batch_size();
        let mut slot_loop = Self {
            batch_size,
            max_polls: inputs.len() * (context.config.buffer_ticks() / batch_size + 1),
            output,
            checkpoints: context.bus.publisher(CONTROL_BUFFER)?,
            control: context.control()?,
            shadow: match context.config.role {
                Role::Owner { .. } => None,
                Role::Candidate => Some(ShadowComparison::new(&context)?),
            },
            service,
            inputs,
            context,
            brief_wait: BriefWait::default(),
        };
        slot_loop.publish_health(State::READY)?;
        slot_loop.context.bus.wake_all();
        Ok(slot_loop)
    }

    /// Reads the inputs and publishes the outputs of ticks that the service owns.
    fn poll(&mut self) -> Result<(), RuntimeError> {
        let owned_before = self.service.owns_next_tick();
        let Self { context, inputs, service, output, shadow, batch_size, max_polls, .. } = self;
        let (mut polls_left, mut started_ns, mut has_sent) = (*max_polls, None, false);
        let may_continue = |_: &mut SlotService<S>| {
            let now_ns = monotonic_ns();
            polls_left = polls_left.saturating_sub(1);
            polls_left > 0 && now_ns - *started_ns.get_or_insert(now_ns) <= MAX_POLL_NS
        };
        poll_fairly(service, inputs.len(), may_continue, SlotService::awaited_input, |service, input| {
            let (ticks, mut failed) = (service.ticks(), None);
            let has_more = inputs[input].drain(*batch_size, &mut |message| {
                let mut on_computed = |out: &S::Output| shadow.iter_mut().for_each(|shadow| shadow.record(out));
                service.offer(message, &mut on_computed, &mut |out| {
                    has_sent = true;
                    failed = failed.take().or(publish(output, out).err());
                });
            })?;
            match (failed, service.failure()) {
                (Some(error), _) => return Err(RuntimeError::from(error)),
                (None, Some(cause)) => return Err(RuntimeError::StageFailed { slot: S::SLOT, cause }),
                (None, None) => {}
            }
            if service.ticks() != ticks {
                output.wake();
            }
            Ok(has_more)
        })?;
        // Sending a message also delivers the history.
        if !has_sent {
            output.deliver_history()?;
        }
        // A health report confirms that the service gave up its ownership, so it is published
        // immediately.
        if owned_before && !service.owns_next_tick() {
            context.make_health_due();
        }
        Ok(())
    }

    /// Applies decisions about the slot.
    fn apply_decisions(&mut self) -> Result<(), RuntimeError> {
        let Self { context, service, output, control, .. } = self;
        let (mut failed, mut decided) = (None, false);
        control.drain(CONTROL_BUFFER, |control| {
            decided |=
                service.apply_decision(&control, &mut |out| failed = failed.take().or(publish(output, out).err()));
        })?;
        if decided {
            output.wake();
            context.make_health_due();
        }
        // A service that has become the owner is no longer compared with the owner.
        self.shadow.take_if(|_| service.owns_next_tick());
        if let Some(shadow) = &mut self.shadow {
            shadow.compare()?;
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Publishes a checkpoint if one is due.
    fn publish_checkpoint(&mut self) -> Result<(), RuntimeError> {
        match self.service.checkpoint() {
            Ok(Some(checkpoint)) => Ok(self.checkpoints.send_checkpoint(checkpoint)?),
            Ok(None) => Ok(()),
            Err(cause) => Err(RuntimeError::StageFailed { slot: S::SLOT, cause }),
        }
    }

    fn publish_health(&mut self, state: State) -> Result<(), RuntimeError> {
        let Self { context, inputs, service, .. } = self;
        context.publish_health(state, |health| {
            service.fill_health(health);
            for input in inputs.iter() {
                let [duplicated, repeated] = input.repeated();
                health.duplicated += duplicated;
                health.repeated += repeated;
            }
        })
    }
}

impl<S: SlotProcessor> ServiceLoop for SlotLoop<S> {
    fn run_round(&mut self) -> Result<(), RuntimeError> {
        self.poll()?;
        self.apply_decisions()?;
        self.publish_checkpoint()?;
        let state = if self.service.ticks() > 0 { State::RUNNING } else { State::READY };
        self.publish_health(state)
    }

    fn wait(&mut self) {
        let Some(awaited) = self.inputs.get(self.service.awaited_input()) else { return };
        let is_published = self.service.has_incomplete_tick() && self.brief_wait.wait(|| awaited.has_new_message());
        if !is_published {
            self.context.wait(&**awaited);
        }
    }

    fn should_stop(&mut self) -> bool {
        self.context.should_stop()
    }
}

/// Publishes the output of a tick that the service owns.
fn publish<O: Ticked>(output: &Publisher<O>, mut out: O) -> Result<(), BusError> {
    let header = out.header_mut();
    header.t_sent_ns = monotonic_ns();
    output.set_next_tick_after(header.tick);
    output.send(&out)
}
