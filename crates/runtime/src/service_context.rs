//! A service's place in a running system: its configuration, its topics, what it says of itself, and how it is asked to end.

use std::{
    io::{self, Read},
    os::unix::net::UnixStream,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use bus::{Bus, Publisher, Subscriber, SystemName, Woken};
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
    reader::{Input, Reader},
    service_config::{BUFFER_BESIDE, Resume, Role, ServiceConfig},
};

/// It is a launch file and a few numbers.
const CONFIG_BYTES_MAX: u64 = 1 << 20;
/// Longest sleep: after it a service looks for work, and whether it is to end, by itself.
const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// From being asked to end until it has ended.
const END_LIMIT: Duration = Duration::from_secs(1);
/// How often a service says how it is.
const HEALTH_INTERVAL_NS: u64 = 100_000_000;
/// The same for one that is to take over, or has.
const CANDIDATE_INTERVAL_NS: u64 = 10_000_000;

/// A service in a running system.
#[derive(Debug)]
pub struct ServiceContext {
    /// Which one it is.
    pub service: Service,
    /// What it was told.
    pub config: ServiceConfig,
    /// Its place on the bus.
    pub bus: Bus,
    ends: Arc<AtomicBool>,
    /// From its first word on it ends in order when it is asked to; before that a signal ends it at once, wherever it waits.
    at_work: Option<Arc<()>>,
    health: Publisher<Health>,
    said: Health,
    said_at_ns: u64,
}

impl ServiceContext {
    /// Reads its configuration from standard input and joins the bus. The service ends with its supervisor.
    pub fn join(service: Service) -> Result<Self, RuntimeError> {
        let system = |doing| move |cause| RuntimeError::System { doing, cause };
        let wrong = |cause: String| RuntimeError::ServiceConfig { service, cause };
        let mut text = String::new();
        io::stdin().take(CONFIG_BYTES_MAX).read_to_string(&mut text).map_err(|cause| wrong(cause.to_string()))?;
        let config: ServiceConfig = serde_json::from_str(&text).map_err(|cause| wrong(cause.to_string()))?;
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::HUP))
            .map_err(|cause| system("tying the service to its supervisor")(cause.into()))?;
        // The supervisor may have died before that took hold.
        if rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get() as u32) != Some(config.supervisor_pid) {
            return Err(wrong("the supervisor that wrote them has ended".into()));
        }
        let bus = Bus::join(&SystemName::new(&config.launch.name)?, service.name())?;
        let health = bus.publisher(BUFFER_BESIDE)?;
        let said = Health {
            service: service as u32,
            incarnation: config.incarnation,
            pid: std::process::id(),
            ..bytemuck::Zeroable::zeroed()
        };
        let ends = Arc::new(AtomicBool::new(false));
        Ok(Self { service, config, bus, ends, at_work: None, health, said, said_at_ns: 0 })
    }

    /// A publisher.
    pub fn publisher<M: Message>(&self) -> Result<Publisher<M>, RuntimeError> {
        Ok(self.bus.publisher(self.config.buffer(M::TOPIC))?)
    }

    /// A reader. In a later incarnation of the service it begins with what its topic still holds.
    pub fn subscriber<M: Message>(&self) -> Result<Subscriber<M>, RuntimeError> {
        let buffer = self.config.buffer(M::TOPIC);
        Ok(if self.config.resume.is_some() {
            self.bus.late_subscriber(buffer)?
        } else {
            self.bus.subscriber(buffer)?
        })
    }

    /// A reader of what a slot publishes: each tick once, in order, whoever fills the slot.
    pub fn reader<M: Ticked>(&self) -> Result<Reader<M>, RuntimeError> {
        let next_tick = match &self.config.resume {
            Some(Resume::Checkpoint(record)) => record.checkpoint().map_or(0, |checkpoint| checkpoint.next_tick),
            _ => 0,
        };
        Ok(Reader::new(self.subscriber()?, next_tick, &self.config))
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
    pub fn publish_health(&mut self, state: State, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        if self.at_work.is_none() {
            let at_work = Arc::new(());
            heed_signals(&self.ends, self.bus.owner_has_died(), Arc::downgrade(&at_work))
                .map_err(|cause| RuntimeError::System { doing: "catching signals", cause })?;
            self.at_work = Some(at_work);
        }
        let now_ns = monotonic_ns();
        let candidate = self.config.role == Role::Candidate;
        let interval_ns = if candidate { CANDIDATE_INTERVAL_NS } else { HEALTH_INTERVAL_NS };
        if self.said.state == state && now_ns.saturating_sub(self.said_at_ns) < interval_ns {
            return Ok(());
        }
        self.said.state = state;
        change(&mut self.said);
        self.said_at_ns = now_ns;
        Ok(self.health.send(&self.said)?)
    }

    /// The last word of a service that was asked to end. Its state stays: only a source at its own end is finished.
    pub fn publish_last_health(&mut self, change: impl FnOnce(&mut Health)) -> Result<(), RuntimeError> {
        change(&mut self.said);
        Ok(self.health.send(&self.said)?)
    }

    /// The next word is said at once.
    pub(crate) fn publish_health_at_once(&mut self) {
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
        header.epoch = self.config.epoch;
        header.incarnation = self.config.incarnation;
    }
}

/// `ends` becomes true when the service is asked to end or its supervisor has died. In a step that never does it is ended all the same: there may be
/// nobody who would do it.
fn heed_signals(ends: &Arc<AtomicBool>, supervisor_has_died: Arc<AtomicBool>, at_work: Weak<()>) -> io::Result<()> {
    flag::register(SIGHUP, supervisor_has_died)?;
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        flag::register(signal, ends.clone())?;
    }
    let (asked, mut heard) = UnixStream::pair()?;
    pipe::register(SIGHUP, asked.try_clone()?)?;
    pipe::register(SIGTERM, asked)?;
    std::thread::Builder::new().name("end".into()).spawn(move || {
        if heard.read_exact(&mut [0]).is_ok() {
            std::thread::sleep(END_LIMIT);
        }
        if at_work.upgrade().is_some() {
            exit(1);
        }
    })?;
    Ok(())
}
