//! State shared by the threads of the gateway.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use control::ControlRequest;
use launch::Service;
use messages::Health;
use wire::DecodeErrorCounts;

use crate::{idempotent_swaps::IdempotentSwaps, locked::locked, queue::Queue};

/// Time without a health message after which a service no longer counts as live.
const HEALTH_TIMEOUT: Duration = Duration::from_millis(1000);

/// State shared by the threads of the gateway.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) system: String,
    pub(crate) vehicle: String,
    pub(crate) queue: Queue,
    pub(crate) swaps: Arc<IdempotentSwaps>,
    /// Counts of invalid messages from the network.
    pub(crate) decode_errors: Mutex<DecodeErrorCounts>,
    /// Number of queries rejected because too many were in progress.
    pub(crate) rejected_queries: Arc<AtomicU64>,
    /// Time of the last health message of each service.
    pub(crate) last_health: Mutex<[Option<Instant>; Service::ALL.len()]>,
    /// Total number of dropped samples, as reported in the health message.
    pub(crate) dropped: AtomicU64,
    pub(crate) stopping: AtomicBool,
}

impl Shared {
    pub(crate) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::SeqCst)
    }

    /// Returns the services that have published a health message recently.
    pub(crate) fn live_services(&self) -> Vec<Service> {
        let last_health = locked(&self.last_health);
        let is_live = |at: &Option<Instant>| at.is_some_and(|at| at.elapsed() < HEALTH_TIMEOUT);
        Service::ALL
            .into_iter()
            .zip(last_health.iter())
            .filter(|(_, at)| is_live(at))
            .map(|(service, _)| service)
            .collect()
    }

    pub(crate) fn on_health(&self, health: &Health) {
        if let Some(at) = locked(&self.last_health).get_mut(health.service as usize) {
            *at = Some(Instant::now());
        }
    }
}

/// Sends a request to the supervisor in the background, retrying until it responds.
pub(crate) fn notify_supervisor(shared: Arc<Shared>, request: ControlRequest) {
    thread::spawn(move || control::notify(&shared.system, &request, || shared.is_stopping()));
}
