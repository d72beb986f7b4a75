//! The loop of a service over the bus.

use std::{
    cell::RefCell,
    io::{self, Read},
    os::unix::net::UnixStream,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use attitude::parameters::ParameterError;
use bus::{Bus, BusError, Domain, Publisher, Subscriber, Woken};
use launch::Service;
use messages::{Checkpoint, Control, Flags, Header, Health, Message, State, Ticked};
use swap::{Inlet, Standing, Tenure};

use crate::{
    checkpoint::{self, ResumeError, Resumed},
    clock::monotonic_ns,
    orders::{BUFFER_BESIDE, Orders, Resume, Role},
    shadow::{Comparable, Shadowing},
    slot::{Sequence, Slot},
};

/// Longest sleep: after it a service looks for work, and whether it is to end, by itself.
const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// Signals that ask it to end.
const HANDLERS: usize = 2;
/// From being asked to end until it has ended.
const END_LIMIT: Duration = Duration::from_secs(1);
/// How often a service says how it is.
const HEALTH_INTERVAL_NS: u64 = 100_000_000;

/// The same for one that is to take over, or has.
const CANDIDATE_INTERVAL_NS: u64 = 10_000_000;

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
    /// A program of the user's, where there are no processes.
    #[error(
        "filling the slot `{slot}`: `{stage}` is a program of its own and runs only as a process; leave out --in-process"
    )]
    Program {
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
    /// It ends in order when it is asked to; before that a signal ends it at once, wherever it waits.
    heeds: bool,
    health: Publisher<Health>,
    said: Health,
    said_at_ns: u64,
}

impl Member {
    /// Reads the orders from standard input and joins the bus. The service ends with its supervisor.
    pub fn join(service: Service) -> Result<Self, RuntimeError> {
        let system = |doing| move |cause| RuntimeError::System { doing, cause };
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
        let ends = Arc::new(AtomicBool::new(false));
        Ok(Self { service, orders, bus, ends, heeds: false, health, said, said_at_ns: 0 })
    }

    /// A publisher on the path.
    pub fn publisher<M: Ticked>(&self) -> Result<Publisher<M>, RuntimeError> {
        Ok(self.bus.publisher(self.orders.buffer_ticks())?)
    }

    /// A reader on the path. In a later life of the service it begins with what its topic still holds.
    pub fn subscriber<M: Message>(&self) -> Result<Subscriber<M>, RuntimeError> {
        let buffer = self.orders.buffer_ticks();
        Ok(if self.orders.resume.is_some() {
            self.bus.late_subscriber(buffer)?
        } else {
            self.bus.subscriber(buffer)?
        })
    }

    /// A reader of what a slot publishes: each tick once, in order, whoever fills the slot.
    pub fn reader<M: Ticked>(&self) -> Result<Reader<M>, RuntimeError> {
        let next_tick = match &self.orders.resume {
            Some(Resume::Checkpoint(record)) => record.checkpoint().map_or(0, |checkpoint| checkpoint.next_tick),
            _ => 0,
        };
        Ok(Reader::new(self.subscriber()?, next_tick, &self.orders))
    }

    /// The decisions about slots.
    pub fn control(&self) -> Result<Subscriber<Control>, RuntimeError> {
        Ok(self.bus.late_subscriber(BUFFER_BESIDE)?)
    }

    /// The service is to end.
    pub fn ends(&self) -> bool {
        self.ends.load(Ordering::SeqCst)
    }

    /// Says how the service is: at once when its state is another, else as often as is of use.
    pub fn say(&mut self, state: State, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        if !std::mem::replace(&mut self.heeds, true) {
            for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
                signal_hook::flag::register(signal, self.ends.clone())
                    .map_err(|cause| RuntimeError::System { doing: "catching signals", cause })?;
            }
            end_in_any_case(Arc::downgrade(&self.ends))
                .map_err(|cause| RuntimeError::System { doing: "catching signals", cause })?;
        }
        let now_ns = monotonic_ns();
        let candidate = self.orders.role == Role::Candidate;
        let interval_ns = if candidate { CANDIDATE_INTERVAL_NS } else { HEALTH_INTERVAL_NS };
        if self.said.state == state && now_ns.saturating_sub(self.said_at_ns) < interval_ns {
            return Ok(());
        }
        self.said.state = state;
        change(&mut self.said);
        self.said_at_ns = now_ns;
        Ok(self.health.send(&self.said)?)
    }

    /// The next word is said at once.
    pub(crate) fn say_at_once(&mut self) {
        self.said_at_ns = 0;
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
        header.epoch = self.orders.epoch;
        header.incarnation = self.orders.incarnation;
    }
}

/// A service that is asked to end and is in a step that never does is ended all the same: its supervisor may be no more.
fn end_in_any_case(at_work: Weak<AtomicBool>) -> io::Result<()> {
    let (asked, mut heard) = UnixStream::pair()?;
    signal_hook::low_level::pipe::register(signal_hook::consts::SIGTERM, asked)?;
    std::thread::Builder::new().name("end".into()).spawn(move || {
        if heard.read_exact(&mut [0]).is_ok() {
            std::thread::sleep(END_LIMIT);
        }
        // The handlers of the two signals hold it too.
        if at_work.strong_count() > HANDLERS {
            signal_hook::low_level::exit(1);
        }
    })?;
    Ok(())
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
    /// The tick after the newest one that was ever about to be published.
    fn next_tick(&self) -> u64;
    /// Messages left out because they came again: by fault, and because another life said them again.
    fn repeated(&self) -> [u64; 2] {
        [0; 2]
    }
}

/// One stream out of all that fill a slot.
#[derive(Debug)]
pub struct Reader<M: Ticked> {
    subscriber: Subscriber<M>,
    inlet: RefCell<Inlet<M>>,
}

impl<M: Ticked> Reader<M> {
    /// Begins with `next_tick`.
    pub fn new(subscriber: Subscriber<M>, next_tick: u64, orders: &Orders) -> Self {
        let inlet = Inlet::starting(next_tick, FIRST_EPOCH, orders.lateness_ticks() / 2);
        Self { subscriber, inlet: RefCell::new(inlet) }
    }

    /// Hands over what still waits for ticks before it: nothing more comes.
    pub fn finish(&self, take: &mut dyn FnMut(M)) {
        self.inlet.borrow_mut().finish(&mut |message, _| take(message));
    }
}

impl<I: From<M>, M: Ticked> Input<I> for Reader<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        let mut inlet = self.inlet.borrow_mut();
        self.subscriber.drain(limit, |message| inlet.offer(message, &mut |message, _| take(message.into())))
    }

    fn wait(&self, limit: Duration) -> Woken {
        self.subscriber.wait(limit)
    }

    fn next_tick(&self) -> u64 {
        self.subscriber.next_tick()
    }

    fn repeated(&self) -> [u64; 2] {
        let counts = *self.inlet.borrow().counts();
        [counts.duplicated, counts.repeated + counts.superseded]
    }
}

impl<I: From<M>, M: Message> Input<I> for Subscriber<M> {
    fn drain(&self, limit: usize, take: &mut dyn FnMut(I)) -> Result<(), BusError> {
        Subscriber::drain(self, limit, |message| take(message.into()))
    }

    fn wait(&self, limit: Duration) -> Woken {
        Subscriber::wait(self, limit)
    }

    fn next_tick(&self) -> u64 {
        Subscriber::next_tick(self)
    }
}

/// Messages of one input taken before the others have their turn: a join must not think that one of them is silent.
const TURN: usize = 32;
/// However much there is to do, after so long a service says how it is and looks at the decisions.
const TURN_LIMIT_NS: u64 = 50_000_000;

/// Runs a slot until the service is to end. `inputs` are in the slot's own order.
pub fn serve<S: Slot + Clone>(
    member: Member,
    mut slot: S,
    inputs: &[&dyn Input<S::Input>],
) -> Result<(), RuntimeError> {
    let mut resumed = None;
    if member.orders.resume.is_some() {
        resumed = resume(&member, &mut slot);
        slot.expect_until(inputs.iter().map(|input| input.next_tick()).max().unwrap_or(0));
    }
    let Orders { incarnation, epoch, role, .. } = member.orders;
    let capacity = member.orders.lateness_ticks() as usize;
    let mut service = Serving {
        output: member.publisher()?,
        checkpoints: member.bus.publisher(BUFFER_BESIDE)?,
        control: member.control()?,
        tenure: match role {
            Role::Owner { from_tick } => Tenure::owner(incarnation, epoch, from_tick, capacity),
            Role::Candidate => Tenure::candidate(incarnation, epoch, capacity),
        },
        exchanged: role == Role::Candidate && resumed != Some(Resumed::Whole),
        shadow: match role {
            Role::Owner { .. } => None,
            Role::Candidate => Some(Shadowing::begin(&member)?),
        },
        next_checkpoint: 0,
        flags: Flags::NONE,
        flawed: 0,
        member,
    };
    service.say(&slot, inputs, State::READY)?;
    service.member.bus.wake_all();
    while !service.member.ends() {
        service.turn(&mut slot, inputs)?;
        service.heed()?;
        service.note(&mut slot)?;
        let state = if slot.sequence().ticks > 0 { State::RUNNING } else { State::READY };
        service.say(&slot, inputs, state)?;
        if let Some(lacking) = inputs.get(slot.lacks()) {
            service.member.wait(*lacking);
        }
    }
    Ok(())
}

/// Goes on from what the orders hold. What cannot be taken over is said; the service then begins with what its inputs hold.
fn resume<S: Slot + Clone>(member: &Member, slot: &mut S) -> Option<Resumed> {
    let Some(Resume::Checkpoint(record)) = &member.orders.resume else { return None };
    let resumed = record
        .checkpoint()
        .ok_or(ResumeError::Damaged)
        .and_then(|checkpoint| checkpoint::resume(slot, member.service, &checkpoint));
    match resumed {
        Ok(resumed) => Some(resumed),
        Err(error) => {
            eprintln!("the service {} does not go on from its checkpoint: {error}; it begins anew", member.service);
            None
        }
    }
}

/// A slot's service at work.
struct Serving<O: Ticked + Comparable> {
    member: Member,
    output: Publisher<O>,
    checkpoints: Publisher<Checkpoint>,
    control: Subscriber<Control>,
    tenure: Tenure<O>,
    /// The first output that is published is the first of another stage.
    exchanged: bool,
    shadow: Option<Shadowing<O>>,
    next_checkpoint: u64,
    flags: Flags,
    flawed: u64,
}

impl<O: Ticked + Comparable> Serving<O> {
    /// Takes what the inputs hold and publishes what follows from it, as far as the slot is owned.
    fn turn<S: Slot<Output = O>>(&mut self, slot: &mut S, inputs: &[&dyn Input<S::Input>]) -> Result<(), RuntimeError> {
        self.output.greet()?;
        let (before, begun_ns) = (slot.sequence().ticks, monotonic_ns());
        let Self { member, output, tenure, exchanged, shadow, flags, flawed, .. } = self;
        let mut failed = None;
        for _ in 0..member.orders.buffer_ticks() / TURN + 1 {
            let mut taken = 0;
            for input in inputs {
                input.drain(TURN, &mut |message| {
                    taken += 1;
                    slot.offer(message, &mut |out| {
                        *flags |= out.header().flags;
                        *flawed += u64::from(out.attitude().is_none());
                        shadow.iter_mut().for_each(|shadow| shadow.computed(&out));
                        tenure.take(out, &mut |out| {
                            failed = failed.take().or(publish(output, out, exchanged).err());
                        });
                    });
                })?;
            }
            if taken == 0 {
                break;
            }
            if slot.sequence().ticks != before {
                output.wake();
            }
            if monotonic_ns() - begun_ns > TURN_LIMIT_NS {
                break;
            }
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Follows the decisions about the slot.
    fn heed(&mut self) -> Result<(), RuntimeError> {
        let Self { member, output, control, tenure, exchanged, .. } = self;
        let (mut failed, mut decided) = (None, false);
        control.drain(BUFFER_BESIDE, |control| {
            if control.service == member.service as u32 {
                let Control { epoch, owner, from_tick, .. } = control;
                decided |= tenure
                    .decide(swap::Control { epoch, owner, from_tick }, &mut |out| {
                        failed = failed.take().or(publish(output, out, exchanged).err());
                    })
                    .is_some();
            }
        })?;
        if decided {
            output.wake();
            member.say_at_once();
        }
        // Who owns the slot is no shadow.
        self.shadow.take_if(|_| tenure.publishes());
        if let Some(shadow) = &mut self.shadow {
            shadow.compare()?;
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Publishes the state every so many ticks.
    fn note<S: Slot<Output = O>>(&mut self, slot: &mut S) -> Result<(), RuntimeError> {
        let next_tick = slot.sequence().next_tick;
        if next_tick < self.next_checkpoint {
            return Ok(());
        }
        let Member { service, orders, .. } = &self.member;
        self.next_checkpoint = next_tick + orders.checkpoint_ticks();
        Ok(self.checkpoints.send(&checkpoint::checkpoint(slot, *service, orders.incarnation))?)
    }

    fn say<S: Slot>(&mut self, slot: &S, inputs: &[&dyn Input<S::Input>], state: State) -> Result<(), RuntimeError> {
        let Sequence { ticks, lost, mut duplicated, mut repeated, next_tick, .. } = *slot.sequence();
        for input in inputs {
            let [again, said_again] = input.repeated();
            (duplicated, repeated) = (duplicated + again, repeated + said_again);
        }
        let Standing { decided_epoch, missed, published_from, .. } = self.tenure.standing();
        let (flags, flawed) = (self.flags, self.flawed);
        self.member.say(state, |health| {
            *health = Health {
                ticks,
                lost,
                duplicated,
                repeated,
                next_tick,
                flags,
                epoch: decided_epoch,
                missed: missed.into(),
                published_from: published_from.unwrap_or(u64::MAX),
                flawed,
                ..*health
            };
        })
    }
}

/// Sends an output that the service owns.
fn publish<O: Ticked>(output: &Publisher<O>, mut out: O, exchanged: &mut bool) -> Result<(), BusError> {
    let header = out.header_mut();
    header.flags |= Flags::EXCHANGED.when(std::mem::take(exchanged));
    header.t_sent_ns = monotonic_ns();
    output.note(header.tick);
    output.send(&out)
}
