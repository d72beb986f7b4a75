//! Observed topics of a system on this machine or of a remote vehicle.
//!
//! `observe` displays bytes with their layout and is independent of the source.

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
use mapping::names::UnknownName;
use messages::Layout;
use observe::{flow::FlowMonitor, topics};
use runtime::clock::monotonic_ns;

use crate::{
    failure::Failure,
    remote::{RemoteTopic, RemoteVehicle},
    system::SystemArgs,
};
pub(crate) use observe::{late_topic::LateTopic, system_recording::POLL_INTERVAL};

/// Interval between two checks that the system is running.
const LIVENESS_INTERVAL: Duration = Duration::from_millis(200);

/// Callback for a message and, if known, the frame of its attitude. Returns `false` to stop.
pub(crate) type OnMessage<'a> = dyn FnMut(&Layout, &[u8], Option<Output>) -> bool + 'a;

/// Attaches an observer to a system.
pub(crate) fn observer(system: &str, observer_name: &str) -> Result<Observer, BusError> {
    Observer::attach(&SystemName::new(system)?, observer_name)
}

/// Source of observed topics.
pub(crate) enum TopicSource {
    /// A system on this machine.
    Local { name: String, observer: Observer },
    /// A vehicle on the network.
    Remote(RemoteVehicle),
}

impl TopicSource {
    /// Attaches to the selected system.
    pub(crate) fn open(system: &SystemArgs, observer_name: &str) -> Result<Self, Failure> {
        Ok(match system.remote() {
            Some((vehicle, endpoint)) => Self::Remote(RemoteVehicle::find(endpoint.open()?, vehicle)?),
            None => {
                let name = system.name()?;
                Self::Local { observer: observer(&name, observer_name)?, name }
            }
        })
    }

    /// Opens the topic of this name.
    pub(crate) fn open_topic(&self, topic: &str) -> Result<TopicView, Failure> {
        let unknown = || UnknownName::new("topic", topic, Topic::ALL.iter().map(|topic| topic.name()));
        let topic = Topic::from_name(topic).ok_or_else(unknown)?;
        let source = match self {
            Self::Local { observer, .. } => ViewSource::Local(observer.tap(topic)?),
            Self::Remote(vehicle) => ViewSource::Remote(Box::new(vehicle.subscribe(topic)?)),
        };
        Ok(TopicView::new(topic, source))
    }

    /// Opens all topics that are available.
    pub(crate) fn open_all(&self) -> Result<Vec<TopicView>, Failure> {
        let mut views = Vec::new();
        for topic in Topic::ALL.iter().copied() {
            let source = match self {
                Self::Local { observer, .. } => match observer.tap(topic) {
                    Err(BusError::TopicNotOpen { .. }) => continue,
                    tap => ViewSource::Local(tap?),
                },
                Self::Remote(vehicle) if !vehicle.publishes(topic) => continue,
                Self::Remote(vehicle) => ViewSource::Remote(Box::new(vehicle.subscribe(topic)?)),
            };
            views.push(TopicView::new(topic, source));
        }
        Ok(views)
    }

    /// Returns `true` while the system is running or the vehicle is reachable.
    pub(crate) fn is_running(&self) -> bool {
        match self {
            Self::Local { observer, .. } => observer.is_running(),
            Self::Remote(vehicle) => vehicle.is_reachable(),
        }
    }

    /// Returns the message printed when the system has ended or is unreachable.
    pub(crate) fn end_message(&self) -> String {
        match self {
            Self::Local { name, .. } => format!("system {name:?} has ended"),
            Self::Remote(vehicle) => vehicle.unreachable_message(),
        }
    }
}

/// Stop condition of a command: a timeout, SIGINT or SIGTERM, or the end of the system.
pub(crate) struct StopCondition<'a> {
    is_running: Box<dyn Fn() -> bool + 'a>,
    timeout: Option<Duration>,
    started: Instant,
    stop_requested: Arc<AtomicBool>,
    checked_at: Instant,
    system_runs: bool,
}

impl<'a> StopCondition<'a> {
    pub(crate) fn new(is_running: impl Fn() -> bool + 'a, timeout: Option<Duration>) -> Self {
        let stop_requested = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            // If the handler cannot be installed, the signal ends the process immediately. That is
            // acceptable, because nothing has to be cleaned up.
            let _ = signal_hook::flag::register(signal, stop_requested.clone());
        }
        let is_running = Box::new(is_running);
        let now = Instant::now();
        Self { is_running, timeout, started: now, stop_requested, checked_at: now, system_runs: true }
    }

    pub(crate) fn is_met(&mut self) -> bool {
        if self.checked_at.elapsed() > LIVENESS_INTERVAL {
            self.checked_at = Instant::now();
            self.system_runs = (self.is_running)();
        }
        let is_timed_out = self.timeout.is_some_and(|timeout| self.started.elapsed() > timeout);
        !self.system_runs || self.stop_requested.load(Ordering::SeqCst) || is_timed_out
    }

    /// Returns `true` if the system has ended or was replaced by another system with the same name.
    pub(crate) fn system_ended(&self) -> bool {
        !self.system_runs
    }
}

/// Open topic with its layout and flow statistics.
pub(crate) struct TopicView {
    pub(crate) name: &'static str,
    pub(crate) layout: Layout,
    pub(crate) flow: FlowMonitor,
    source: ViewSource,
}

enum ViewSource {
    Local(Tap),
    Remote(Box<RemoteTopic>),
}

impl TopicView {
    fn new(topic: Topic, source: ViewSource) -> Self {
        let layout = messages::layout(topic);
        Self { flow: FlowMonitor::new(topic, &layout), name: topic.name(), layout, source }
    }

    /// Receives all available messages and passes them to `on_message` until it returns `false`.
    pub(crate) fn poll(&mut self, on_message: &mut OnMessage<'_>) -> Result<(), Failure> {
        let Self { layout, flow, source, .. } = self;
        let arrived_ns = monotonic_ns();
        match source {
            ViewSource::Local(tap) => {
                let mut wanted = true;
                let full = tap.drain(&mut |bytes| {
                    if wanted {
                        flow.record(bytes, arrived_ns);
                        wanted = on_message(layout, bytes, None);
                    }
                })?;
                if full {
                    flow.mark_buffer_full();
                }
            }
            ViewSource::Remote(topic) => topic.poll(layout.size, &mut |delivery, bytes| {
                flow.set_delivery(delivery);
                bytes.is_none_or(|(bytes, reported)| {
                    flow.record(bytes, arrived_ns);
                    on_message(layout, bytes, reported)
                })
            }),
        }
        Ok(())
    }

    /// Returns the topic's description, with its publishers and subscribers except this process.
    pub(crate) fn into_topic(self) -> Result<topics::TopicInfo, Failure> {
        let ports = match &self.source {
            ViewSource::Local(tap) => Some(tap.ports()?),
            ViewSource::Remote(_) => None,
        };
        let ports = ports.map(|mut ports| {
            ports.subscribers.retain(|port| port.pid != std::process::id());
            ports
        });
        Ok(topics::TopicInfo { name: self.name.into(), layout: self.layout, ports, flow: self.flow.report() })
    }
}
