//! The loop of a service over the bus.

use std::{
    io::{self, Read},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use attitude::parameters::ParameterError;
use bus::{Bus, BusError, Domain, Publisher, Subscriber, Woken};
use launch::Service;
use messages::{Flags, Header, Health, Message, State, Ticked};

use crate::{
    clock::monotonic_ns,
    orders::{BUFFER_BESIDE, Orders},
    slot::{Sequence, Slot},
};

/// Longest sleep: after it a service looks for work, and whether it is to end, by itself.
const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// How often a service says how it is.
const HEALTH_INTERVAL_NS: u64 = 100_000_000;

/// Why a service ended.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The orders on standard input were not those of a supervisor.
    #[error("reading the orders of service {service}: {cause}; services are started by `plumb up`")]
    Orders {
        /// Who was to read them.
        service: Service,
        /// What is wrong with them.
        cause: String,
    },
    /// The system could not be asked for something.
    #[error("{doing}: {cause}")]
    System {
        /// What was being done.
        doing: &'static str,
        /// What the system answered.
        cause: io::Error,
    },
    /// A stage that is not there.
    #[error("filling the slot `{slot}`: there is no stage `{stage}`")]
    Stage {
        /// The slot.
        slot: Service,
        /// The name asked for.
        stage: String,
    },
    /// A parameter that the stage does not take.
    #[error("setting `{name}` of the stage `{stage}` in the slot `{slot}`: {cause}")]
    Parameter {
        /// The slot.
        slot: Service,
        /// The stage.
        stage: String,
        /// The parameter.
        name: String,
        /// What is wrong with it.
        cause: ParameterError,
    },
}

/// A service as a member of a running system.
#[derive(Debug)]
pub struct Member {
    /// Which one it is.
    pub service: Service,
    /// What it was told.
    pub orders: Orders,
    /// Its place on the bus.
    pub bus: Bus,
    ends: Arc<AtomicBool>,
    health: Publisher<Health>,
    said: Health,
    said_at_ns: u64,
}

impl Member {
    /// Reads the orders from standard input and joins the bus. The service ends with its supervisor.
    pub fn join(service: Service) -> Result<Self, RuntimeError> {
        let ends = Arc::new(AtomicBool::new(false));
        let system = |doing| move |cause| RuntimeError::System { doing, cause };
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, ends.clone()).map_err(system("catching signals"))?;
        }
        let wrong = |cause: String| RuntimeError::Orders { service, cause };
        let mut text = String::new();
        io::stdin().take(ORDERS_BYTES_MAX).read_to_string(&mut text).map_err(|cause| wrong(cause.to_string()))?;
        let orders: Orders = serde_json::from_str(&text).map_err(|cause| wrong(cause.to_string()))?;
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))
            .map_err(|cause| system("tying the service to its supervisor")(cause.into()))?;
        // The supervisor may have died before that took hold.
        if rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get() as u32) != Some(orders.supervisor_pid) {
            return Err(wrong("the supervisor that wrote them has ended".into()));
        }
        let bus = Bus::join(&Domain::new(&orders.launch.name)?, service.name())?;
        let health = bus.publisher(BUFFER_BESIDE)?;
        let said = Health {
            service: service as u32,
            incarnation: orders.incarnation,
            pid: std::process::id(),
            ..bytemuck::Zeroable::zeroed()
        };
        Ok(Self { service, orders, bus, ends, health, said, said_at_ns: 0 })
    }

    /// A publisher on the path.
    pub fn publisher<M: Ticked>(&self) -> Result<Publisher<M>, RuntimeError> {
        Ok(self.bus.publisher(self.orders.buffer_ticks())?)
    }

    /// A reader on the path.
    pub fn subscriber<M: Message>(&self) -> Result<Subscriber<M>, RuntimeError> {
        Ok(self.bus.subscriber(self.orders.buffer_ticks())?)
    }

    /// The service is to end.
    pub fn ends(&self) -> bool {
        self.ends.load(Ordering::SeqCst)
    }

    /// Says how the service is: at once when its state is another, else as often as is of use.
    pub fn say(&mut self, state: State, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        let now_ns = monotonic_ns();
        if self.said.state == state && now_ns.saturating_sub(self.said_at_ns) < HEALTH_INTERVAL_NS {
            return Ok(());
        }
        self.said.state = state;
        change(&mut self.said);
        self.said_at_ns = now_ns;
        Ok(self.health.send(&self.said)?)
    }

    /// Sleeps until something comes on a topic or the limit has passed, and keeps count of wake-ups that were lost.
    pub fn wait<I>(&mut self, topic: &dyn Input<I>) {
        if topic.wait(WAIT_LIMIT) == Woken::Late {
            self.said.late_wakes += 1;
        }
    }

    /// Stamps a message as sent by this service now.
    pub fn stamp(&self, header: &mut Header) {
        header.t_sent_ns = monotonic_ns();
        header.epoch = FIRST_EPOCH;
        header.incarnation = self.orders.incarnation;
    }
}

/// The supervisor's first decision: every slot belongs to whom `launch.toml` names.
pub const FIRST_EPOCH: u32 = 1;
/// Orders are a launch file and a few numbers.
const ORDERS_BYTES_MAX: u64 = 1 << 20;

/// A topic that a slot reads.
pub trait Input<I> {
    /// Hands what is there to `take`, at most `limit` messages.
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError>;
    /// Sleeps until something is published, no longer than `limit`.
    fn wait(&self, limit: Duration) -> Woken;
}

impl<I: From<M>, M: Message> Input<I> for Subscriber<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        Subscriber::drain(self, limit, |message| take(message.into()))
    }

    fn wait(&self, limit: Duration) -> Woken {
        Subscriber::wait(self, limit)
    }
}

/// Runs a slot until the service is to end. `inputs` are in the slot's own order.
pub fn serve<S: Slot>(mut member: Member, mut slot: S, inputs: &[&dyn Input<S::Input>]) -> Result<(), RuntimeError> {
    let output = member.publisher::<S::Output>()?;
    let limit = member.orders.buffer_ticks();
    let mut flags = Flags::NONE;
    member.say(State::READY, |_| ())?;
    while !member.ends() {
        let mut failed = None;
        let before = slot.sequence().ticks;
        for input in inputs {
            input.drain(limit, &mut |message| {
                slot.offer(message, &mut |mut out| {
                    flags |= out.header().flags;
                    member.stamp(out.header_mut());
                    if let Err(error) = output.send(&out) {
                        failed.get_or_insert(error);
                    }
                });
            })?;
        }
        if let Some(error) = failed {
            return Err(error.into());
        }
        if slot.sequence().ticks != before {
            output.wake();
        }
        let Sequence { ticks, lost, duplicated, .. } = *slot.sequence();
        let state = if ticks > 0 { State::RUNNING } else { State::READY };
        member.say(state, |health| {
            *health = Health { ticks, lost, duplicated, flags, ..*health };
        })?;
        if let Some(lacking) = inputs.get(slot.lacks()) {
            member.wait(*lacking);
        }
    }
    Ok(())
}
