//! Where what is shown comes from: the bus of a running system on this machine, or a vehicle elsewhere.
//!
//! What is shown (`observe`) takes bytes with their layout and does not know whence they come.

pub(crate) mod elsewhere;
pub(crate) mod frame;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{BusError, Observer, SystemName, Tap};
use graph::Topic;
use launch::Output;
use messages::Layout;
use observe::{flow::Flow, topics};
use runtime::clock::monotonic_ns;

use crate::{remote::RemoteError, system::System};
use elsewhere::{Crossing, Vehicle};

/// Between two looks at a topic: far shorter than what an observer's buffer holds, and it costs the system nothing.
pub(crate) const LOOK: Duration = Duration::from_millis(5);
/// Between two looks whether the system still runs.
const RUNS_INTERVAL: Duration = Duration::from_millis(200);

/// Takes a message, with its frame where it came with that; whether it wants more.
pub(crate) type TakeMessage<'a> = dyn FnMut(&Layout, &[u8], Option<Output>) -> bool + 'a;

/// Why nothing is seen.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SeeError {
    /// The system on this machine cannot be looked at.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The network cannot be used.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// There is no such topic.
    #[error("opening the topic `{topic}`: there is none of that name; there are {}", names(Topic::ALL))]
    NoTopic { topic: String },
    /// Nobody of that name is found.
    #[error(
        "looking for the vehicle {vehicle:?}: it did not answer within {limit_s:.0} s; `plumb station` with the same --connect shows the vehicles there are"
    )]
    NoVehicle { vehicle: String, limit_s: f64 },
    /// It is found, and does not send this.
    #[error(
        "looking at {vehicle:?}: it does not send `{topic}`, but {sent}; [gateway.rates] of its launch file says what it sends"
    )]
    NotSent { vehicle: String, topic: String, sent: String },
}

impl SeeError {
    /// The exit code of `plumb`: 2 when there can be no such topic or the command line is wrong, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::NoTopic { .. } => 2,
            Self::Remote(error) => error.exit_code(),
            _ => 1,
        }
    }
}

/// Takes a seat in a system.
pub(crate) fn observer(system: &str, who: &str) -> Result<Observer, BusError> {
    Observer::attach(&SystemName::new(system)?, who)
}

/// Where one looks from.
pub(crate) enum Viewpoint {
    /// On board.
    Board(Observer),
    /// Beyond it.
    Elsewhere(Vehicle),
}

impl Viewpoint {
    /// A place from which the system is seen.
    pub(crate) fn of(system: &System, who: &str) -> Result<Self, SeeError> {
        Ok(match system.remote() {
            Some((vehicle, way)) => Self::Elsewhere(Vehicle::find(vehicle, way)?),
            None => Self::Board(observer(&system.name(), who)?),
        })
    }

    /// A topic to look at.
    pub(crate) fn watch(&self, topic: &str) -> Result<Watched, SeeError> {
        let topic = Topic::from_name(topic).ok_or_else(|| SeeError::NoTopic { topic: topic.into() })?;
        self.watch_known(topic)
    }

    fn watch_known(&self, topic: Topic) -> Result<Watched, SeeError> {
        let layout = messages::layout(topic);
        let source = match self {
            Self::Board(observer) => Source::Board(observer.tap(topic)?),
            Self::Elsewhere(vehicle) => Source::Elsewhere(Box::new(vehicle.crossing(topic)?)),
        };
        Ok(Watched { flow: Flow::new(topic, &layout), name: topic.name(), layout, source })
    }

    /// Every topic there is to look at.
    pub(crate) fn watch_all(&self) -> Result<Vec<Watched>, SeeError> {
        let mut watched = Vec::new();
        for topic in Topic::ALL {
            match self.watch_known(*topic) {
                Ok(topic) => watched.push(topic),
                Err(SeeError::Bus(BusError::TopicNotOpen { .. }) | SeeError::NotSent { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(watched)
    }

    /// The system still runs, as far as can be seen.
    pub(crate) fn is_running(&self) -> bool {
        match self {
            Self::Board(observer) => observer.is_running(),
            Self::Elsewhere(vehicle) => vehicle.is_in_reach(),
        }
    }

    /// What people are told when it runs no more.
    pub(crate) fn ended(&self, system: &System) -> String {
        match self {
            Self::Board(_) => format!("the system {:?} has ended", system.name()),
            Self::Elsewhere(vehicle) => vehicle.out_of_reach(),
        }
    }
}

/// When an observation ends: after a time, by Ctrl-C, or with the system.
pub(crate) struct Until<'a> {
    is_running: Box<dyn Fn() -> bool + 'a>,
    limit: Option<Duration>,
    since: Instant,
    asked: Arc<AtomicBool>,
    looked: Instant,
    runs: bool,
}

impl<'a> Until<'a> {
    pub(crate) fn new(is_running: impl Fn() -> bool + 'a, limit: Option<Duration>) -> Self {
        let asked = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            // Where a signal cannot be caught it ends the process, which leaves nothing that hurts.
            let _ = signal_hook::flag::register(signal, asked.clone());
        }
        let is_running = Box::new(is_running);
        Self { is_running, limit, since: Instant::now(), asked, looked: Instant::now(), runs: true }
    }

    pub(crate) fn is_over(&mut self) -> bool {
        if self.looked.elapsed() > RUNS_INTERVAL {
            self.looked = Instant::now();
            self.runs = (self.is_running)();
        }
        !self.runs || self.asked.load(Ordering::SeqCst) || self.limit.is_some_and(|limit| self.since.elapsed() > limit)
    }

    /// The system has ended, or another one has its name.
    pub(crate) fn system_ended(&self) -> bool {
        !self.runs
    }
}

/// A topic that is looked at.
pub(crate) struct Watched {
    pub(crate) name: &'static str,
    pub(crate) layout: Layout,
    pub(crate) flow: Flow,
    source: Source,
}

enum Source {
    Board(Tap),
    Elsewhere(Box<Crossing>),
}

impl Watched {
    /// Takes what has come, and shows each message to `take` as long as it wants any, with its frame where it came with that.
    pub(crate) fn look(&mut self, take: &mut TakeMessage<'_>) -> Result<(), SeeError> {
        let Self { layout, flow, source, .. } = self;
        let arrived_ns = monotonic_ns();
        match source {
            Source::Board(tap) => {
                let mut wanted = true;
                let full = tap.drain(&mut |bytes| {
                    if wanted {
                        flow.take(bytes, arrived_ns);
                        wanted = take(layout, bytes, None);
                    }
                })?;
                if full {
                    flow.was_full();
                }
            }
            Source::Elsewhere(crossing) => crossing.look(layout.size, &mut |delivery, bytes| {
                flow.passed(delivery);
                bytes.is_none_or(|(bytes, said)| {
                    flow.take(bytes, arrived_ns);
                    take(layout, bytes, said)
                })
            }),
        }
        Ok(())
    }

    /// The topic with who is at it beside this process.
    pub(crate) fn topic(self) -> Result<topics::Topic, SeeError> {
        let ports = match &self.source {
            Source::Board(tap) => Some(tap.ports()?),
            Source::Elsewhere(_) => None,
        };
        let ports = ports.map(|mut ports| {
            ports.subscribers.retain(|port| port.pid != std::process::id());
            ports
        });
        Ok(topics::Topic { name: self.name.into(), layout: self.layout, ports, flow: self.flow.report() })
    }
}

fn names(topics: &[Topic]) -> String {
    topics.iter().map(|topic| topic.name()).collect::<Vec<_>>().join(", ")
}

/// Seconds on the command line.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (1e-3..=1e8).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "expected a number of seconds from 0.001 to 100000000".into())
}
