//! The gateway: what goes beyond the board, and what comes from there.
//!
//! Input: the topics of the bus, and questions from the network. Output: protobuf under the keys of [`wire::keys`], and answers. Time:
//! the clock or the ticks of a slow path say when it looks at the bus; nobody waits for it. Failure: what the network does not
//! take is dropped, oldest first, and counted; a network that is dead, slow or blocked is not noticed on board.
//!
//! Two threads: one looks at the bus, puts what is to go out into a queue that has an end, and takes it to the network; while the other
//! is at the network, with signs of life or a report, it takes along what is in the queue. Each question has a thread of its own, up to a
//! limit.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `tap` | a topic of the bus, thinned out to its rate |
//! | `pace` | when to look at the bus again |
//! | `queue` | between bus and network; newest wins |
//! | `sender` | to the network, each message in its envelope |
//! | `answers` | last values, schema, services |
//! | `worker_pool` | who answers, so that the network waits for no reader |
//! | `memory` | how much memory it may take |
//! | `idempotent_swaps` | requests for a swap, each carried out once |
//! | [`split`] | one system on several hosts: ticks from one gateway to another |
#![forbid(unsafe_code)]

mod answers;
pub mod decimator;
pub mod idempotent_swaps;
mod memory;
mod pace;
pub mod queue;
mod sender;
pub mod split;
mod tap;
mod worker_pool;

use std::{
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use bus::BusError;
use control::ControlRequest;
use graph::Topic;
use keys::access::AccessList;
use launch::{Launch, Service};
use link::LinkError;
use messages::{Health, State};
use runtime::{RuntimeError, ServiceContext, service_config::BUFFER_BESIDE};
use wire::Refusals;

use crate::{
    idempotent_swaps::IdempotentSwaps,
    memory::Memory,
    pace::Pace,
    queue::Queue,
    sender::Sender,
    split::{End, Split},
    tap::Taps,
};

/// Messages between bus and network: a second and more of every topic.
const QUEUE_MAX: usize = 512;
/// How much more than the services of the path the gateway lets others have the machine.
const NICENESS: i32 = 5;
/// How long the supervisor is sought for, to be told where the gateway listens.
const DOOR_LIMIT: Duration = Duration::from_secs(30);
/// How often one's own certificates are looked at.
const CERTIFICATES_INTERVAL: Duration = Duration::from_secs(60);
/// A service that has said nothing for so long does not live.
const ALIVE_LIMIT: Duration = Duration::from_millis(1000);

/// Why the gateway ended.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// The system could not be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The network could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// It has taken too much memory.
    #[error(
        "keeping what comes from the network: {has_mib} MiB, and {limit_mib} MiB is the limit; somebody sends or asks for too much. It begins anew, and whoever is connected connects again"
    )]
    Memory {
        /// What it has, MiB.
        has_mib: u64,
        /// What it may have, MiB.
        limit_mib: u64,
    },
    /// A thread ended that was not to.
    #[error("sending to the network: the thread ended by itself")]
    Sender,
}

/// What both threads know.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) system: String,
    pub(crate) vehicle: String,
    pub(crate) queue: Queue,
    pub(crate) swaps: Arc<IdempotentSwaps>,
    /// Messages from outside that were none.
    pub(crate) refusals: Mutex<Refusals>,
    /// Questions beyond those that were being seen to.
    pub(crate) turned_away: Arc<AtomicU64>,
    /// When each service was heard last.
    heard: Mutex<[Option<Instant>; Service::ALL.len()]>,
    /// Samples dropped in all, for the health.
    pub(crate) dropped: AtomicU64,
    ends: AtomicBool,
}

impl Shared {
    pub(crate) fn ends(&self) -> bool {
        self.ends.load(Ordering::SeqCst)
    }

    /// The services that live.
    pub(crate) fn living(&self) -> Vec<Service> {
        let heard = locked(&self.heard);
        let lives = |at: &Option<Instant>| at.is_some_and(|at| at.elapsed() < ALIVE_LIMIT);
        Service::ALL.into_iter().zip(heard.iter()).filter(|(_, at)| lives(at)).map(|(service, _)| service).collect()
    }

    fn on_health(&self, health: &Health) {
        if let Some(at) = locked(&self.heard).get_mut(health.service as usize) {
            *at = Some(Instant::now());
        }
    }
}

/// The network's end of the queue, once the network is open: of whoever has something to send.
type Sending = Arc<OnceLock<Mutex<Sender>>>;

/// What another thread left, even if it panicked: there are only counts and queues in it.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The service.
pub fn run() -> Result<(), GatewayError> {
    let mut context = ServiceContext::join(Service::Gateway)?;
    let launch = context.config.launch.clone();
    let is_split = launch.gateway.is_split();
    if !is_split {
        // A machine that has too little for everybody has it for the data path. Where that cannot be had it is not needed.
        let _ = rustix::process::nice(NICENESS);
    }
    let mut taps = Taps::open(&context)?;
    let health = context.bus.subscriber::<Health>(BUFFER_BESIDE)?;
    let shared = Arc::new(Shared {
        system: launch.name.clone(),
        vehicle: launch.gateway.vehicle.clone().unwrap_or_else(|| launch.name.clone()),
        queue: Queue::new(QUEUE_MAX, Topic::ALL.len()),
        swaps: Arc::new(IdempotentSwaps::new(ask_for_swap(launch.name.clone()))),
        refusals: Mutex::default(),
        turned_away: Arc::default(),
        heard: Mutex::default(),
        dropped: AtomicU64::new(0),
        ends: AtomicBool::new(false),
    });
    let mut split = Split::open(&context, &shared)?;
    let sending = Sending::default();
    let network = thread::spawn({
        let (shared, end, start_ns) = (shared.clone(), split.end(), runtime::clock::monotonic_ns());
        let sending = sending.clone();
        move || send(&shared, &sending, &end, &launch, start_ns)
    });
    let mut pace = Pace::of(&context.config);
    let mut memory = Memory::new(is_split);
    while !context.ends() && !network.is_finished() {
        memory.check()?;
        taps.look(&shared.queue)?;
        match sending.get().map(Mutex::try_lock) {
            Some(Ok(mut sender)) => sender.empty(),
            _ => shared.queue.wake(),
        }
        health.drain(BUFFER_BESIDE * Service::ALL.len(), |health| shared.on_health(&health))?;
        split.poll(&context)?;
        let (ticks, lost) =
            split.ticks_and_lost().unwrap_or_else(|| (taps.samples(), shared.dropped.load(Ordering::Relaxed)));
        let refused = locked(&shared.refusals).total() + shared.turned_away.load(Ordering::Relaxed);
        let state = if split.is_finished() { State::FINISHED } else { State::RUNNING };
        context.publish_health(state, |health| (health.ticks, health.lost, health.refused) = (ticks, lost, refused))?;
        pace.rest(|limit| split.wait(&taps, limit));
    }
    if let Some((ticks, lost)) = split.ticks_and_lost() {
        split.poll(&context)?;
        context.publish_last_health(|health| (health.ticks, health.lost) = (ticks, lost))?;
    }
    shared.ends.store(true, Ordering::SeqCst);
    network.join().unwrap_or(Err(GatewayError::Sender))
}

/// The network's side, to the end.
fn send(
    shared: &Arc<Shared>,
    sending: &Sending,
    end: &End,
    launch: &Launch,
    start_ns: u64,
) -> Result<(), GatewayError> {
    let gateway = &launch.gateway;
    let tls = gateway.tls.clone().map(|tls| link::endpoints::Tls { ca: tls.ca, cert: tls.cert, key: tls.key });
    let endpoints = link::Endpoints {
        listen: gateway.listen.clone(),
        connect: gateway.connect.clone(),
        tls,
        access: gateway.access.clone(),
        plain: Some(AccessList::of_gateway(&shared.vehicle, !gateway.export.is_empty(), gateway.access.is_none())),
        client: false,
    };
    let endpoints = endpoints.with_free_ports()?;
    let link = link::Link::open(&endpoints)?;
    let at = endpoints.listen.join(" ");
    notify_supervisor(shared.clone(), ControlRequest::At { service: Service::Gateway.name().into(), at });
    let carrying = end.carry(&link, &endpoints, shared)?;
    let sender = Sender::open(&link, shared.clone(), launch, start_ns)?;
    let _answering = answers::open(&link, shared, sender.last())?;
    let sender = sending.get_or_init(|| Mutex::new(sender));
    let (mut checked, mut flaw) = (None::<Instant>, None);
    while !shared.ends() {
        shared.queue.wait(sender::TURN_LIMIT);
        locked(sender).poll()?;
        if checked.is_none_or(|checked| checked.elapsed() > CERTIFICATES_INTERVAL) {
            checked = Some(Instant::now());
            // Whoever is shown a certificate that has ended closes the door without a word.
            let found = endpoints.check().err().map(|error| error.to_string());
            if let Some(what) = found.clone().filter(|_| found != flaw) {
                notify_supervisor(
                    shared.clone(),
                    ControlRequest::Tell { service: Service::Gateway.name().into(), what },
                );
            }
            flaw = found;
        }
    }
    // It ends with the rest; one that panicked has nothing more to send.
    let _ = carrying.map(thread::JoinHandle::join);
    link.close();
    Ok(())
}

/// Tells the supervisor something, once it answers.
pub(crate) fn notify_supervisor(shared: Arc<Shared>, news: ControlRequest) {
    thread::spawn(move || {
        let deadline = Instant::now() + DOOR_LIMIT;
        while control::ask::<()>(&shared.system, &news).is_err() && Instant::now() < deadline && !shared.ends() {
            thread::sleep(Duration::from_millis(100));
        }
    });
}

/// How the supervisor is asked for a swap.
fn ask_for_swap(system: String) -> idempotent_swaps::Asking {
    Box::new(move |wish| {
        control::ask::<control::SwapReport>(&system, &ControlRequest::Swap(wish)).map_err(|error| error.to_string())
    })
}
