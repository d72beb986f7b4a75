//! A slot's process on the simulated bus.

use std::convert::Infallible;

use accel::AccelProcessor;
use course::{CourseMessage, CourseSlot};
use fuser::{FuserMessage, FuserSlot};
use gyro::GyroProcessor;
use launch::Service;
use messages::{Difference, Health, State, Ticked};
use runtime::{
    SingleInputSlot, ServiceConfig, Slot, ordered_subscriber::OrderedStream, service_config::Resume, slot_service::SlotService, input_scheduling::poll_fairly,
};
use swap::Role;

use crate::{
    bus::{Bus, ReaderId, Topic},
    random::Random,
};

/// How often a service says how it is, ms; and one that is to take over, or has.
const HEALTH_MS: u64 = 100;
const CANDIDATE_HEALTH_MS: u64 = 10;
/// How often a shadow says how far it is, ms.
const DIFFERENCE_MS: u64 = 100;

/// A process of one of the slots.
pub(crate) enum SlotProcess {
    Gyro(Box<Worker<SingleInputSlot<GyroProcessor>>>),
    Accel(Box<Worker<SingleInputSlot<AccelProcessor>>>),
    Fuser(Box<Worker<FuserSlot>>),
    Course(Box<Worker<CourseSlot>>),
}

impl SlotProcess {
    /// It has opened its topics and takes over what it goes on from.
    pub(crate) fn begin(service: Service, config: &ServiceConfig, bus: &mut Bus) -> Result<Self, String> {
        let text = |error: runtime::RuntimeError| error.to_string();
        let mut ports = Ports::new(config, bus);
        Ok(match service {
            Service::Gyro => {
                let inputs = vec![ports.plain(|bus| &mut bus.imu)];
                Self::Gyro(ports.begin(gyro::slot(config).map_err(text)?, service, inputs, |bus| &mut bus.gyro))
            }
            Service::Accel => {
                let inputs = vec![ports.plain(|bus| &mut bus.imu)];
                Self::Accel(ports.begin(accel::slot(config).map_err(text)?, service, inputs, |bus| &mut bus.accel))
            }
            Service::Fuser => {
                let inputs: Vec<Input<FuserMessage>> = vec![
                    ports.ordered(|bus| &mut bus.gyro),
                    ports.ordered(|bus| &mut bus.accel),
                    ports.plain(|bus| &mut bus.mag),
                    ports.plain(|bus| &mut bus.gnss),
                    ports.control(),
                ];
                Self::Fuser(ports.begin(fuser::slot(config).map_err(text)?, service, inputs, |bus| &mut bus.fused))
            }
            Service::Course => {
                let inputs: Vec<Input<CourseMessage>> =
                    vec![ports.ordered(|bus| &mut bus.fused), ports.plain(|bus| &mut bus.gnss)];
                Self::Course(ports.begin(course::slot(config).map_err(text)?, service, inputs, |bus| &mut bus.attitude))
            }
            Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => return Err("no slot".into()),
        })
    }

    /// One turn of its loop; whether it lives to its end.
    pub(crate) fn poll(&mut self, world: &mut Turn<'_>) -> bool {
        match self {
            Self::Gyro(worker) => worker.poll(world),
            Self::Accel(worker) => worker.poll(world),
            Self::Fuser(worker) => worker.poll(world),
            Self::Course(worker) => worker.poll(world),
        }
    }
}

/// What a process has for one turn of its loop.
pub(crate) struct Turn<'a> {
    pub(crate) now_ms: u64,
    pub(crate) bus: &'a mut Bus,
    pub(crate) random: &'a mut Random,
    /// How many deliveries it lives for, if it dies in this turn.
    pub(crate) deliveries: Option<u32>,
    /// Health and differences are lost so often in a thousand times.
    pub(crate) drop_per_mille: u64,
    /// What it gives out is not an attitude from this tick on.
    pub(crate) flawed_from: Option<u64>,
}

/// Takes messages of one input and turns them into those of the slot.
type Input<I> = Box<dyn FnMut(&mut Bus, &mut Random, &mut Vec<I>)>;
/// A topic of the bus.
type Of<M> = fn(&mut Bus) -> &mut Topic<M>;

/// What a process opens on the bus.
struct Ports<'a> {
    config: &'a ServiceConfig,
    bus: &'a mut Bus,
    late: bool,
    next_tick: u64,
}

impl<'a> Ports<'a> {
    fn new(config: &'a ServiceConfig, bus: &'a mut Bus) -> Self {
        let next_tick = match &config.resume {
            Some(Resume::Checkpoint(record)) => record.checkpoint().map_or(0, |checkpoint| checkpoint.next_tick),
            _ => 0,
        };
        Self { config, bus, late: config.resume.is_some(), next_tick }
    }

    fn open<M: Copy>(&mut self, of: Of<M>, late: bool) -> ReaderId {
        let id = self.bus.next_reader();
        of(self.bus).read_as(id, self.config.incarnation, late);
        id
    }

    fn plain<I: From<M> + 'static, M: Copy + 'static>(&mut self, of: Of<M>) -> Input<I> {
        let (id, limit) = (self.open(of, self.late), self.config.batch_size());
        Box::new(move |bus, random, taken| {
            for _ in 0..limit {
                let Some(message) = of(bus).receive(id, random) else { return };
                taken.push(message.into());
            }
        })
    }

    fn ordered<I: From<M> + 'static, M: Ticked>(&mut self, of: Of<M>) -> Input<I> {
        let (id, limit) = (self.open(of, self.late), self.config.batch_size());
        let mut stream = OrderedStream::new(self.next_tick, of(self.bus).next_tick, self.config);
        Box::new(move |bus, random, taken| {
            let read = |stage: &mut dyn FnMut(M)| -> Result<(), Infallible> {
                std::iter::from_fn(|| of(bus).receive(id, random)).for_each(stage);
                Ok(())
            };
            let Ok(()) = stream.advance(limit, read, &mut |message| taken.push(message.into()));
        })
    }

    fn control(&mut self) -> Input<FuserMessage> {
        let id = self.open(|bus| &mut bus.control, true);
        Box::new(move |bus, random, taken| {
            while let Some(control) = bus.control.receive(id, random) {
                taken.push(control.into());
            }
        })
    }

    fn begin<S: Slot>(
        mut self,
        slot: S,
        service: Service,
        inputs: Vec<Input<S::Input>>,
        output: Of<S::Output>,
    ) -> Box<Worker<S>> {
        let control = self.open(|bus| &mut bus.control, true);
        let Self { config, bus, .. } = self;
        let incarnation = config.incarnation;
        output(bus).publish_as(incarnation);
        bus.health.publish_as(incarnation);
        bus.checkpoint.publish_as(incarnation);
        bus.difference.publish_as(incarnation);
        let newest = [bus.imu.next_tick, bus.gyro.next_tick, bus.accel.next_tick, bus.fused.next_tick];
        let input_tick = match service {
            Service::Fuser => newest[1].max(newest[2]),
            Service::Course => newest[3],
            _ => newest[0],
        };
        let output_tick = output(bus).next_tick;
        let (slot_service, _) = SlotService::new(slot, service, config, input_tick, output_tick);
        let health = Health { service: service as u32, incarnation, ..bytemuck::Zeroable::zeroed() };
        Box::new(Worker {
            service: slot_service,
            inputs,
            control,
            output,
            candidate: config.role == Role::Candidate,
            health,
            said_ms: None,
            compared_ms: 0,
        })
    }
}

/// A slot's service at work.
pub(crate) struct Worker<S: Slot> {
    service: SlotService<S>,
    inputs: Vec<Input<S::Input>>,
    control: ReaderId,
    output: Of<S::Output>,
    candidate: bool,
    health: Health,
    said_ms: Option<u64>,
    compared_ms: u64,
}

impl<S: Slot> Worker<S> {
    fn poll(&mut self, turn: &mut Turn<'_>) -> bool {
        let published = self.service.owns_next_tick();
        let mut say_at_once = self.said_ms.is_none();
        (self.output)(turn.bus).deliver_history(self.health.incarnation);
        let lives = self.take_inputs(turn) && self.follow_decisions(turn, &mut say_at_once);
        if !lives {
            return false;
        }
        if let Some(checkpoint) = self.service.checkpoint()
            && !turn.bus.checkpoint.send(self.health.incarnation, checkpoint, &mut turn.deliveries)
        {
            return false;
        }
        // Whoever takes over is confirmed by that.
        say_at_once |= published && !self.service.owns_next_tick();
        self.publish_health(turn, say_at_once);
        turn.deliveries.is_none()
    }

    fn take_inputs(&mut self, turn: &mut Turn<'_>) -> bool {
        let Self { service, inputs, output, health, .. } = self;
        let (count, mut missed) = (inputs.len(), vec![false; inputs.len()]);
        let look = |service: &mut SlotService<S>, input: usize| -> Result<usize, Dead> {
            // It looks at its inputs one after the other, so something may come in between. It is seen at the next look.
            if turn.random.happens(50) && !std::mem::replace(&mut missed[input], true) {
                return Ok(0);
            }
            let (mut messages, mut outputs) = (Vec::new(), Vec::new());
            inputs[input](turn.bus, turn.random, &mut messages);
            let taken = messages.len();
            for message in messages {
                service.offer(message, &mut |_| {}, &mut |output| outputs.push(output));
            }
            let lives = publish(output(turn.bus), health.incarnation, outputs, &mut turn.deliveries);
            if lives { Ok(taken) } else { Err(Dead) }
        };
        poll_fairly(service, count, |_| true, SlotService::awaited_input, look).is_ok()
    }

    fn follow_decisions(&mut self, turn: &mut Turn<'_>, say_at_once: &mut bool) -> bool {
        while let Some(control) = turn.bus.control.receive(self.control, turn.random) {
            let mut outputs = Vec::new();
            *say_at_once |= self.service.apply_decision(&control, &mut |output| outputs.push(output));
            let topic = (self.output)(turn.bus);
            if !publish(topic, self.health.incarnation, outputs, &mut turn.deliveries) {
                return false;
            }
        }
        true
    }

    fn publish_health(&mut self, turn: &mut Turn<'_>, at_once: bool) {
        let state = if self.service.ticks() > 0 { State::RUNNING } else { State::READY };
        let interval_ms = if self.candidate { CANDIDATE_HEALTH_MS } else { HEALTH_MS };
        let due = self.said_ms.is_none_or(|said_ms| turn.now_ms >= said_ms + interval_ms);
        if due || at_once || state != self.health.state {
            self.health.state = state;
            self.said_ms = Some(turn.now_ms);
            self.service.fill_health(&mut self.health);
            let next_tick = self.health.next_tick;
            self.health.flawed += u64::from(turn.flawed_from.is_some_and(|from| next_tick > from));
            if !turn.random.happens(turn.drop_per_mille) {
                turn.bus.health.send(self.health.incarnation, self.health, &mut None);
            }
        }
        if self.candidate && !self.service.owns_next_tick() && turn.now_ms >= self.compared_ms + DIFFERENCE_MS {
            self.compared_ms = turn.now_ms;
            let difference = Difference {
                tick: self.health.next_tick,
                ticks: 1,
                now_rad: [turn.random.between(0, 100) as f64 * 1e-3; 3],
                turn: [1.0, 0.0, 0.0, 0.0],
                service: self.health.service,
                incarnation: self.health.incarnation,
                ..bytemuck::Zeroable::zeroed()
            };
            if !turn.random.happens(turn.drop_per_mille) {
                turn.bus.difference.send(self.health.incarnation, difference, &mut None);
            }
        }
    }
}

/// The process was killed.
struct Dead;

/// Publishes them one after the other; whether the process lives on.
fn publish<O: Ticked>(topic: &mut Topic<O>, incarnation: u32, outputs: Vec<O>, deliveries: &mut Option<u32>) -> bool {
    outputs.into_iter().all(|output| topic.publish(incarnation, output, deliveries))
}
