//! Gateway between the bus and the network: telemetry, queries and swap requests.
//!
//! Input: the topics of the bus, and queries from the network.
//!
//! Output: protobuf messages under the keys of [`wire::keys`], and replies.
//!
//! Time: the bus is polled on a timer, or on each tick if ticks are slow enough. No service waits
//! for the gateway.
//!
//! Failure: messages that the network does not accept are dropped, oldest first, and counted. A
//! dead, slow or blocked network does not affect the board.
//!
//! The main thread polls the bus, pushes batches into a bounded queue and sends them itself. While
//! the network thread is using the publisher for liveliness tokens or a report, that thread sends
//! the batches instead. Each query has its own thread, up to a limit.
//!
//! | module | contents |
//! | --- | --- |
//! | `tap` | reads a bus topic, reduced to its configured rate |
//! | `shared`, `locked`, `error` | shared state, and access to it; errors |
//! | `poll_timer` | schedule of polling the bus |
//! | [`queue`] | bounded queue between bus and network, which drops the oldest batch if full |
//! | `network_publisher` | publishes liveliness tokens, the report, and messages in envelopes |
//! | `queries` | replies to queries: last messages, schema, services, swaps |
//! | `worker_pool` | threads that reply, so that the network never waits for a client |
//! | `memory_limit` | memory limit of the gateway |
//! | [`idempotent_swaps`] | swap requests, each executed only once |
//! | [`split`] | split systems, whose ticks are carried from one gateway to another |
#![forbid(unsafe_code)]

mod error;
pub mod idempotent_swaps;
mod locked;
mod memory_limit;
mod network_publisher;
mod poll_timer;
mod queries;
pub mod queue;
mod shared;
pub mod split;
mod tap;
mod worker_pool;

use std::{
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use control::ControlRequest;
use graph::Topic;
use keys::access::AccessList;
use launch::{Launch, Service};
use messages::{Health, State};
use runtime::{ServiceContext, service_config::CONTROL_BUFFER};

pub use error::GatewayError;

use crate::{
    idempotent_swaps::IdempotentSwaps,
    locked::locked,
    memory_limit::MemoryLimit,
    network_publisher::NetworkPublisher,
    poll_timer::PollTimer,
    queue::{MAX_QUEUED_BATCHES, Queue},
    shared::{Shared, notify_supervisor},
    split::{BusSide, NetworkSide},
    tap::Taps,
};

/// Niceness of the gateway. Services of the data path keep the default priority.
const NICENESS: i32 = 5;
/// Interval between checks of the gateway's own certificates.
const CERTIFICATES_INTERVAL: Duration = Duration::from_secs(60);

/// Publisher shared by both threads. It is set once the network is open.
type SharedPublisher = Arc<OnceLock<Mutex<NetworkPublisher>>>;

/// Runs the gateway service until the system stops.
///
/// # Errors
///
/// Returns an error if the system cannot be joined, the bus or the network fails, or the memory
/// limit is exceeded.
pub fn run() -> Result<(), GatewayError> {
    let mut context = ServiceContext::join(Service::Gateway)?;
    let launch = context.config.launch.clone();
    let is_split = launch.gateway.is_split();
    if !is_split {
        // The data path takes precedence on an overloaded machine. If the priority cannot be
        // lowered, the gateway runs at normal priority.
        let _ = rustix::process::nice(NICENESS);
    }
    let mut taps = Taps::open(&context)?;
    let health = context.bus.subscriber::<Health>(CONTROL_BUFFER)?;
    let shared = Arc::new(Shared {
        system: launch.name.clone(),
        vehicle: launch.gateway.vehicle.clone().unwrap_or_else(|| launch.name.clone()),
        queue: Queue::new(MAX_QUEUED_BATCHES, Topic::ALL.len()),
        swaps: Arc::new(IdempotentSwaps::new(swap_client(launch.name.clone()))),
        decode_errors: Mutex::default(),
        rejected_queries: Arc::default(),
        last_health: Mutex::default(),
        dropped: AtomicU64::new(0),
        stopping: AtomicBool::new(false),
    });
    let mut split = BusSide::open(&context, &shared)?;
    let publisher = SharedPublisher::default();
    let network = thread::spawn({
        let (shared, network_side, start_ns) = (shared.clone(), split.network_side(), runtime::clock::monotonic_ns());
        let publisher = publisher.clone();
        move || run_network(&shared, &publisher, &network_side, &launch, start_ns)
    });
    let mut timer = PollTimer::new(&context.config);
    let mut memory = MemoryLimit::new(is_split);
    while !context.should_stop() && !network.is_finished() {
        memory.check()?;
        taps.poll(&shared.queue)?;
        match publisher.get().map(Mutex::try_lock) {
            Some(Ok(mut publisher)) => publisher.send_queued(),
            _ => shared.queue.wake(),
        }
        health.drain(CONTROL_BUFFER * Service::ALL.len(), |health| shared.on_health(&health))?;
        split.poll(&context)?;
        let (ticks, lost) =
            split.ticks_and_lost().unwrap_or_else(|| (taps.samples(), shared.dropped.load(Ordering::Relaxed)));
        let refused = locked(&shared.decode_errors).total() + shared.rejected_queries.load(Ordering::Relaxed);
        let state = if split.is_finished() { State::FINISHED } else { State::RUNNING };
        context.publish_health(state, |health| (health.ticks, health.lost, health.refused) = (ticks, lost, refused))?;
        timer.wait(|limit| split.wait(&taps, limit));
    }
    if let Some((ticks, lost)) = split.ticks_and_lost() {
        split.poll(&context)?;
        context.publish_final_health(|health| (health.ticks, health.lost) = (ticks, lost))?;
    }
    shared.stopping.store(true, Ordering::SeqCst);
    network.join().unwrap_or(Err(GatewayError::NetworkThread))
}

/// Runs the network thread until the gateway stops.
fn run_network(
    shared: &Arc<Shared>,
    publisher: &SharedPublisher,
    network_side: &NetworkSide,
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
        plain_access: Some(AccessList::for_gateway(
            &shared.vehicle,
            !gateway.export.is_empty(),
            gateway.access.is_none(),
        )),
        client: false,
    };
    let endpoints = endpoints.with_free_ports()?;
    let link = link::Link::open(&endpoints)?;
    let at = endpoints.listen.join(" ");
    notify_supervisor(shared.clone(), ControlRequest::Address { service: Service::Gateway.name().into(), address: at });
    let split_thread = network_side.spawn(&link, &endpoints, shared)?;
    let network_publisher = NetworkPublisher::open(&link, shared.clone(), launch, start_ns)?;
    let _queryables = queries::serve(&link, shared, network_publisher.last())?;
    let network_publisher = publisher.get_or_init(|| Mutex::new(network_publisher));
    let (mut checked, mut reported) = (None::<Instant>, None);
    while !shared.is_stopping() {
        shared.queue.wait(network_publisher::LIVELINESS_INTERVAL);
        locked(network_publisher).poll()?;
        if checked.is_none_or(|checked| checked.elapsed() > CERTIFICATES_INTERVAL) {
            checked = Some(Instant::now());
            // Peers drop the connection without giving a reason if a certificate has expired. The
            // gateway therefore checks its own certificates and reports the cause.
            let found = endpoints.check_certificates().err().map(|error| error.to_string());
            if let Some(line) = found.clone().filter(|_| found != reported) {
                notify_supervisor(
                    shared.clone(),
                    ControlRequest::Announce { service: Service::Gateway.name().into(), line },
                );
            }
            reported = found;
        }
    }
    // The split thread stops with the gateway. If it has panicked, there is nothing left to send,
    // so the result of the join is ignored.
    let _ = split_thread.map(thread::JoinHandle::join);
    link.close();
    Ok(())
}

/// Returns a client that forwards swap requests to the supervisor.
fn swap_client(system: String) -> idempotent_swaps::SwapClient {
    Box::new(move |request| {
        control::send_request::<control::SwapReport>(&system, &ControlRequest::Swap(request))
            .map_err(|error| error.to_string())
    })
}
