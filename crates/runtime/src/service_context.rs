//! Connection of a service to a running system: configuration, topics, health reports and shutdown.
//!
//! - Input: the configuration on standard input, and signals.
//! - Output: health reports, and publishers and subscribers for the service.
//! - Failure: the process exits if it does not stop within a second of a stop request.

use std::{
    io::{self, Read},
    os::unix::net::UnixStream,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{Bus, Publisher, Subscriber, SystemName, WaitOutcome};
use launch::Service;
use messages::{Control, Header, Health, Message, State, Ticked};
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    flag,
    low_level::{exit, pipe},
};

use crate::{
    RuntimeError,
    clock::monotonic_ns,
    ordered_subscriber::{OrderedSubscriber, SlotInput},
    service_config::{CONTROL_BUFFER, Resume, Role, ServiceConfig},
};

/// Maximum size of the configuration, bytes. A configuration holds a launch file and a few numbers.
const MAX_CONFIG_BYTES: u64 = 1 << 20;
/// Longest time for which a service without a supervisor sleeps. After that it checks for input
/// even if nothing has woken it.
const MAX_WAIT: Duration = Duration::from_millis(50);
/// Interval at which a service that was requested to stop is woken. A single wake-up could come
/// just before the service starts to wait.
const STOP_WAKE_INTERVAL: Duration = Duration::from_millis(20);
/// Time after a stop request at which the process is terminated forcibly.
const STOP_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval between health reports of an owner.
const HEALTH_INTERVAL_NS: u64 = 100_000_000;
/// Interval between health reports of a candidate. It is shorter than for an owner, because swaps
/// wait for these reports.
const CANDIDATE_HEALTH_INTERVAL_NS: u64 = 10_000_000;

/// Connection of a service to a running system.
#[derive(Debug)]
pub struct ServiceContext {
    /// Service that this process runs.
    pub service: Service,
    /// Configuration that the service received when it started.
    pub config: ServiceConfig,
    /// Bus that the service has joined.
    pub bus: Bus,
    stop_flag: Arc<AtomicBool>,
    /// Token that exists as long as the connection; `None` until the first health report. Until
    /// then, a stop request ends the process immediately, even if the process is blocked.
    liveness: Option<Arc<()>>,
    health: Publisher<Health>,
    last_health: Health,
    last_health_ns: u64,
    /// Longest time for which the service sleeps; `None` if a supervisor wakes services that wait
    /// for an idle topic.
    max_wait: Option<Duration>,
}

impl ServiceContext {
    /// Reads the configuration from standard input and joins the bus.
    ///
    /// From then on, the service receives a signal to stop when its supervisor exits.
    ///
    /// # Errors
    ///
    /// Fails if the configuration is invalid, the supervisor has already exited, or the bus cannot
    /// be joined.
    pub fn join(service: Service) -> Result<Self, RuntimeError> {
        let system = |doing| move |cause| RuntimeError::System { doing, cause };
        let invalid = |cause: String| RuntimeError::ServiceConfig { service, cause };
        let mut text = String::new();
        io::stdin().take(MAX_CONFIG_BYTES).read_to_string(&mut text).map_err(|cause| invalid(cause.to_string()))?;
        let config: ServiceConfig = serde_json::from_str(&text).map_err(|cause| invalid(cause.to_string()))?;
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::HUP))
            .map_err(|cause| system("requesting a signal at the supervisor's exit")(cause.into()))?;
        // The supervisor may have exited before this process requested a signal for that exit.
        if rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get() as u32) != Some(config.supervisor_pid) {
            return Err(invalid("the supervisor has exited".into()));
        }
        Ok(Self { max_wait: None, ..Self::with_config(service, config)? })
    }

    /// Joins the bus with the given configuration, without a supervisor.
    ///
    /// # Errors
    ///
    /// Fails if the bus cannot be joined.
    pub fn with_config(service: Service, config: ServiceConfig) -> Result<Self, RuntimeError> {
        let bus = Bus::join(&SystemName::new(&config.launch.name)?, service.name())?;
        let health = bus.publisher(CONTROL_BUFFER)?;
        let last_health = Health {
            service: service as u32,
            incarnation: config.incarnation,
            pid: std::process::id(),
            ..bytemuck::Zeroable::zeroed()
        };
        let stop_flag = Arc::new(AtomicBool::new(false));
        Ok(Self {
            service,
            config,
            bus,
            stop_flag,
            liveness: None,
            health,
            last_health,
            last_health_ns: 0,
            max_wait: Some(MAX_WAIT),
        })
    }

    /// Opens a publisher with the buffer size of its topic.
    pub fn publisher<M: Message>(&self) -> Result<Publisher<M>, RuntimeError> {
        Ok(self.bus.publisher(self.config.buffer_size(M::TOPIC))?)
    }

    /// Opens a subscriber. In a restarted service it first receives the messages that the topic
    /// still holds.
    pub fn subscriber<M: Message>(&self) -> Result<Subscriber<M>, RuntimeError> {
        let buffer = self.config.buffer_size(M::TOPIC);
        Ok(if self.config.resume.is_some() {
            self.bus.late_subscriber(buffer)?
        } else {
            self.bus.subscriber(buffer)?
        })
    }

    /// Opens a subscriber to a slot's topic. It delivers each tick once and in order, even if the
    /// owner of the slot changes.
    pub fn ordered_subscriber<M: Ticked>(&self) -> Result<OrderedSubscriber<M>, RuntimeError> {
        let checkpoint = self.config.resume.as_ref().and_then(Resume::checkpoint);
        let next_tick = checkpoint.map_or(0, |checkpoint| checkpoint.next_tick);
        Ok(OrderedSubscriber::new(self.subscriber()?, next_tick, &self.config))
    }

    /// Opens a subscriber to the decisions about slots.
    pub fn control(&self) -> Result<Subscriber<Control>, RuntimeError> {
        Ok(self.bus.late_subscriber(CONTROL_BUFFER)?)
    }

    /// Returns `true` once the service has received a stop request.
    pub fn should_stop(&self) -> bool {
        self.stop_flag.load(Ordering::SeqCst)
    }

    /// Publishes the health of the service, updated by `change`.
    ///
    /// A report with a changed state is published immediately. Other reports are published at a
    /// fixed interval.
    pub fn publish_health(&mut self, state: State, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        if self.liveness.is_none() {
            let liveness = Arc::new(());
            install_signal_handlers(&self.stop_flag, &self.bus, Arc::downgrade(&liveness))
                .map_err(|cause| RuntimeError::System { doing: "installing signal handlers", cause })?;
            self.liveness = Some(liveness);
        }
        let now_ns = monotonic_ns();
        let is_candidate = self.config.role == Role::Candidate;
        let interval_ns = if is_candidate { CANDIDATE_HEALTH_INTERVAL_NS } else { HEALTH_INTERVAL_NS };
        if self.last_health.state == state && now_ns.saturating_sub(self.last_health_ns) < interval_ns {
            return Ok(());
        }
        self.last_health.state = state;
        change(&mut self.last_health);
        self.last_health_ns = now_ns;
        Ok(self.health.send(&self.last_health)?)
    }

    /// Publishes the health of a service that is about to stop, without changing its state.
    ///
    /// The state is kept, because `FINISHED` applies only to a source at the end of its data.
    pub fn publish_final_health(&mut self, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        change(&mut self.last_health);
        Ok(self.health.send(&self.last_health)?)
    }

    /// Makes the next call of [`Self::publish_health`] publish without waiting for the interval.
    pub(crate) fn make_health_due(&mut self) {
        self.last_health_ns = 0;
    }

    /// Sleeps until a message arrives, a stop is requested, the supervisor wakes the service, or
    /// the maximum sleep time has passed. Counts lost wake-ups.
    pub fn wait<I>(&mut self, topic: &dyn SlotInput<I>) {
        if topic.wait(self.max_wait) == WaitOutcome::LateWake {
            self.last_health.late_wakes += 1;
        }
    }

    /// Writes the current time, and the epoch and incarnation of this service, to a header.
    pub fn stamp(&self, header: &mut Header) {
        header.t_sent_ns = monotonic_ns();
        header.epoch = self.config.epoch;
        header.incarnation = self.config.incarnation;
    }
}

/// Sets `stop_flag` and wakes the service on a stop signal and when the supervisor exits.
///
/// If the process has not stopped after [`STOP_TIMEOUT`], for example because its stage does not
/// return, a thread ends it. This is necessary, because there may be no supervisor left to kill it.
fn install_signal_handlers(stop_flag: &Arc<AtomicBool>, bus: &Bus, liveness: Weak<()>) -> io::Result<()> {
    flag::register(SIGHUP, bus.owner_exited())?;
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        flag::register(signal, stop_flag.clone())?;
    }
    let (signal_end, mut waiting_end) = UnixStream::pair()?;
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        pipe::register(signal, signal_end.try_clone()?)?;
    }
    let wake_handle = bus.wake_handle();
    std::thread::Builder::new().name("stop".into()).spawn(move || {
        if waiting_end.read_exact(&mut [0]).is_ok() {
            let deadline = Instant::now() + STOP_TIMEOUT;
            while liveness.strong_count() > 0 && Instant::now() < deadline {
                wake_handle.wake_all();
                std::thread::sleep(STOP_WAKE_INTERVAL);
            }
        }
        if liveness.upgrade().is_some() {
            exit(1);
        }
    })?;
    Ok(())
}
