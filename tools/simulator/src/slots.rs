//! Simulated process that runs a slot.

use std::convert::Infallible;

use launch::{Service, Slot};
use messages::{Difference, Health, State, Ticked};
use runtime::{
    ServiceConfig, SingleInputSlot, SlotProcessor, input_scheduling::poll_fairly, ordered_subscriber::OrderedStream,
    service_config::Resume, slot_service::SlotService,
};
use slots::{
    accel::AccelProcessor,
    course::{CourseMessage, CourseSlot},
    fuser::{FuserMessage, FuserSlot},
    gyro::GyroProcessor,
};
use swap::Role;

use crate::{
    bus::{Bus, SubscriberId, Topic},
    random::Random,
};

/// Interval between health messages, ms.
const HEALTH_MS: u64 = 100;
/// Interval in ms between health messages of a process that was started as a candidate.
const CANDIDATE_HEALTH_MS: u64 = 10;
/// Interval between difference messages of a candidate, ms.
const DIFFERENCE_MS: u64 = 100;

/// Process of one of the four slots.
pub(crate) enum SlotProcess {
    Gyro(Box<Worker<SingleInputSlot<GyroProcessor>>>),
    Accel(Box<Worker<SingleInputSlot<AccelProcessor>>>),
    Fuser(Box<Worker<FuserSlot>>),
    Course(Box<Worker<CourseSlot>>),
}

impl SlotProcess {
    /// Opens the topics and restores the state from which the slot resumes.
    pub(crate) fn start(slot: Slot, config: &ServiceConfig, bus: &mut Bus) -> Result<Self, String> {
        let text = |error: runtime::RuntimeError| error.to_string();
        let mut ports = Ports::new(config, bus);
        Ok(match slot {
            Slot::Gyro => {
                let inputs = vec![ports.unordered(|bus| &mut bus.imu)];
                Self::Gyro(ports.start_worker(slots::gyro::slot(config).map_err(text)?, inputs, |bus| &mut bus.gyro))
            }
            Slot::Accel => {
                let inputs = vec![ports.unordered(|bus| &mut bus.imu)];
                Self::Accel(ports.start_worker(slots::accel::slot(config).map_err(text)?, inputs, |bus| &mut bus.accel))
            }
            Slot::Fuser => {
                let inputs: Vec<InputReader<FuserMessage>> = vec![
                    ports.ordered(|bus| &mut bus.gyro),
                    ports.ordered(|bus| &mut bus.accel),
                    ports.unordered(|bus| &mut bus.mag),
                    ports.unordered(|bus| &mut bus.gnss),
                    ports.control(),
                ];
                Self::Fuser(ports.start_worker(slots::fuser::slot(config).map_err(text)?, inputs, |bus| &mut bus.fused))
            }
            Slot::Course => {
                let inputs: Vec<InputReader<CourseMessage>> =
                    vec![ports.ordered(|bus| &mut bus.fused), ports.unordered(|bus| &mut bus.gnss)];
                Self::Course(
                    ports.start_worker(slots::course::slot(config).map_err(text)?, inputs, |bus| &mut bus.attitude),
                )
            }
        })
    }

    /// Polls the service once. Returns `false` if it is killed.
    pub(crate) fn poll(&mut self, context: &mut PollContext<'_>) -> bool {
        match self {
            Self::Gyro(worker) => worker.poll(context),
            Self::Accel(worker) => worker.poll(context),
            Self::Fuser(worker) => worker.poll(context),
            Self::Course(worker) => worker.poll(context),
        }
    }
}

/// Data that a process needs for one poll.
pub(crate) struct PollContext<'a> {
    pub(crate) now_ms: u64,
    pub(crate) bus: &'a mut Bus,
    pub(crate) random: &'a mut Random,
    /// Number of deliveries after which the process is killed; `None` if it is not to be killed.
    pub(crate) deliveries_left: Option<u32>,
    /// Probability that a health or difference message is lost, per mille.
    pub(crate) lost_report_per_mille: u64,
    /// First tick with an invalid output; `None` if all outputs are valid.
    pub(crate) invalid_from_tick: Option<u64>,
}

/// Function that reads messages of one topic and converts them to inputs of the slot.
type InputReader<I> = Box<dyn FnMut(&mut Bus, &mut Random, &mut Vec<I>)>;
/// Function that selects a topic of the bus.
type TopicAccessor<M> = fn(&mut Bus) -> &mut Topic<M>;

/// Ports of a process on the bus, opened one by one.
struct Ports<'a> {
    config: &'a ServiceConfig,
    bus: &'a mut Bus,
    wants_history: bool,
    next_tick: u64,
}

impl<'a> Ports<'a> {
    fn new(config: &'a ServiceConfig, bus: &'a mut Bus) -> Self {
        let checkpoint = config.resume.as_ref().and_then(Resume::checkpoint);
        let next_tick = checkpoint.map_or(0, |checkpoint| checkpoint.next_tick);
        Self { config, bus, wants_history: config.resume.is_some(), next_tick }
    }

    fn subscribe<M: Copy>(&mut self, topic: TopicAccessor<M>, wants_history: bool) -> SubscriberId {
        let id = self.bus.next_subscriber();
        topic(self.bus).subscribe(id, self.config.incarnation, wants_history);
        id
    }

    fn unordered<I: From<M> + 'static, M: Copy + 'static>(&mut self, topic: TopicAccessor<M>) -> InputReader<I> {
        let (id, limit) = (self.subscribe(topic, self.wants_history), self.config.batch_size());
        Box::new(move |bus, random, messages| {
            for _ in 0..limit {
                let Some(message) = topic(bus).receive(id, random) else { return };
                messages.push(message.into());
            }
        })
    }

    fn ordered<I: From<M> + 'static, M: Ticked>(&mut self, topic: TopicAccessor<M>) -> InputReader<I> {
        let (id, limit) = (self.subscribe(topic, self.wants_history), self.config.batch_size());
        let mut stream = OrderedStream::new(self.next_tick, topic(self.bus).next_tick, self.config);
        Box::new(move |bus, random, messages| {
            let read = |count, stage: &mut dyn FnMut(M)| -> Result<(), Infallible> {
                std::iter::from_fn(|| topic(bus).receive(id, random)).take(count).for_each(stage);
                Ok(())
            };
            let Ok(()) = stream.advance(limit, read, &mut |message| messages.push(message.into()));
        })
    }

    fn control(&mut self) -> InputReader<FuserMessage> {
        let id = self.subscribe(|bus| &mut bus.control, true);
        Box::new(move |bus, random, messages| {
            while let Some(control) = bus.control.receive(id, random) {
                messages.push(control.into());
            }
        })
    }

    fn start_worker<S: SlotProcessor>(
        mut self,
        slot: S,
        inputs: Vec<InputReader<S::Input>>,
        output: TopicAccessor<S::Output>,
    ) -> Box<Worker<S>> {
        let control = self.subscribe(|bus| &mut bus.control, true);
        let Self { config, bus, .. } = self;
        let incarnation = config.incarnation;
        output(bus).add_publisher(incarnation);
        bus.health.add_publisher(incarnation);
        bus.checkpoint.add_publisher(incarnation);
        bus.difference.add_publisher(incarnation);
        let newest = [bus.imu.next_tick, bus.gyro.next_tick, bus.accel.next_tick, bus.fused.next_tick];
        let input_tick = match S::SLOT {
            Slot::Gyro | Slot::Accel => newest[0],
            Slot::Fuser => newest[1].max(newest[2]),
            Slot::Course => newest[3],
        };
        let output_tick = output(bus).next_tick;
        let (slot_service, _) = SlotService::new(slot, config, input_tick, output_tick);
        let health = Health { service: Service::from(S::SLOT) as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
        Box::new(Worker {
            service: slot_service,
            inputs,
            control,
            output,
            candidate: config.role == Role::Candidate,
            health,
            health_sent_ms: None,
            difference_sent_ms: 0,
        })
    }
}

/// Running service of a slot.
pub(crate) struct Worker<S: SlotProcessor> {
    service: SlotService<S>,
    inputs: Vec<InputReader<S::Input>>,
    control: SubscriberId,
    output: TopicAccessor<S::Output>,
    candidate: bool,
    health: Health,
    health_sent_ms: Option<u64>,
    difference_sent_ms: u64,
}

impl<S: SlotProcessor> Worker<S> {
    fn poll(&mut self, context: &mut PollContext<'_>) -> bool {
        let owned_next_tick = self.service.owns_next_tick();
        let mut report_now = self.health_sent_ms.is_none();
        if !self.process_inputs(context) {
            return false;
        }
        (self.output)(context.bus).deliver_history(self.health.incarnation);
        if !self.apply_decisions(context, &mut report_now) {
            return false;
        }
        // The stages of a simulation do not fail.
        if let Ok(Some(checkpoint)) = self.service.checkpoint()
            && !context.bus.checkpoint.send(self.health.incarnation, *checkpoint, &mut context.deliveries_left)
        {
            return false;
        }
        // The previous owner confirms the hand-over with a health message, which is therefore sent
        // immediately.
        report_now |= owned_next_tick && !self.service.owns_next_tick();
        self.publish_health(context, report_now);
        context.deliveries_left.is_none()
    }

    fn process_inputs(&mut self, context: &mut PollContext<'_>) -> bool {
        let Self { service, inputs, output, health, .. } = self;
        let (count, mut skipped) = (inputs.len(), vec![false; inputs.len()]);
        let poll = |service: &mut SlotService<S>, input: usize| -> Result<bool, Killed> {
            // Simulates a message that arrives just after its input was polled. It is read by the
            // next poll.
            if context.random.chance(50) && !std::mem::replace(&mut skipped[input], true) {
                return Ok(false);
            }
            let (mut messages, mut outputs) = (Vec::new(), Vec::new());
            inputs[input](context.bus, context.random, &mut messages);
            let has_more = !messages.is_empty();
            for message in messages {
                service.offer(message, &mut |_| {}, &mut |output| outputs.push(output));
            }
            let is_alive = publish(output(context.bus), health.incarnation, outputs, &mut context.deliveries_left);
            if is_alive { Ok(has_more) } else { Err(Killed) }
        };
        poll_fairly(service, count, |_| true, SlotService::awaited_input, poll).is_ok()
    }

    fn apply_decisions(&mut self, context: &mut PollContext<'_>, report_now: &mut bool) -> bool {
        while let Some(control) = context.bus.control.receive(self.control, context.random) {
            let mut outputs = Vec::new();
            *report_now |= self.service.apply_decision(&control, &mut |output| outputs.push(output));
            let topic = (self.output)(context.bus);
            if !publish(topic, self.health.incarnation, outputs, &mut context.deliveries_left) {
                return false;
            }
        }
        true
    }

    fn publish_health(&mut self, context: &mut PollContext<'_>, report_now: bool) {
        let state = if self.service.ticks() > 0 { State::RUNNING } else { State::READY };
        let interval_ms = if self.candidate { CANDIDATE_HEALTH_MS } else { HEALTH_MS };
        let due = self.health_sent_ms.is_none_or(|health_sent_ms| context.now_ms >= health_sent_ms + interval_ms);
        if due || report_now || state != self.health.state {
            self.health.state = state;
            self.health_sent_ms = Some(context.now_ms);
            self.service.fill_health(&mut self.health);
            let next_tick = self.health.next_tick;
            self.health.invalid_outputs += u64::from(context.invalid_from_tick.is_some_and(|from| next_tick > from));
            if !context.random.chance(context.lost_report_per_mille) {
                context.bus.health.send(self.health.incarnation, self.health, &mut None);
            }
        }
        if self.candidate && !self.service.owns_next_tick() && context.now_ms >= self.difference_sent_ms + DIFFERENCE_MS
        {
            self.difference_sent_ms = context.now_ms;
            let difference = Difference {
                tick: self.health.next_tick,
                ticks: 1,
                now_rad: [context.random.between(0, 100) as f64 * 1e-3; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                service: self.health.service,
                incarnation: self.health.incarnation,
                ..bytemuck::Zeroable::zeroed()
            };
            if !context.random.chance(context.lost_report_per_mille) {
                context.bus.difference.send(self.health.incarnation, difference, &mut None);
            }
        }
    }
}

/// Error that indicates that the process was killed while it published.
struct Killed;

/// Publishes outputs in order. Returns `false` if the process is killed.
fn publish<O: Ticked>(
    topic: &mut Topic<O>,
    incarnation: u32,
    outputs: Vec<O>,
    deliveries_left: &mut Option<u32>,
) -> bool {
    outputs.into_iter().all(|output| topic.publish(incarnation, output, deliveries_left))
}
