//! Where what is shown comes from: the bus of a running system on this machine.
//!
//! What is shown (`observe`) takes bytes with their layout and does not know whence they come.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{BusError, Domain, Observer, Tap};
use messages::{Layout, Message, Visitor};
use observe::{flow::Flow, topics::Topic};
use runtime::clock::monotonic_ns;

/// Between two looks at a topic: far shorter than what an observer's buffer holds, and it costs the system nothing.
pub(crate) const LOOK: Duration = Duration::from_millis(5);
/// Between two looks whether the system still runs.
const RUNS_INTERVAL: Duration = Duration::from_millis(200);

/// Takes a seat in a system.
pub(crate) fn observer(system: &str, who: &str) -> Result<Observer, BusError> {
    Observer::sit(&Domain::new(system)?, who)
}

/// When an observation ends: after a time, by Ctrl-C, or with the system.
pub(crate) struct Until<'a> {
    observer: &'a Observer,
    limit: Option<Duration>,
    since: Instant,
    asked: Arc<AtomicBool>,
    looked: Instant,
    runs: bool,
}

impl<'a> Until<'a> {
    pub(crate) fn new(observer: &'a Observer, limit: Option<Duration>) -> Self {
        let asked = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            // Where a signal cannot be caught it ends the process, which leaves nothing that hurts.
            let _ = signal_hook::flag::register(signal, asked.clone());
        }
        Self { observer, limit, since: Instant::now(), asked, looked: Instant::now(), runs: true }
    }

    pub(crate) fn is_over(&mut self) -> bool {
        if self.looked.elapsed() > RUNS_INTERVAL {
            self.looked = Instant::now();
            self.runs = self.observer.is_running();
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
    tap: Tap,
}

impl Watched {
    pub(crate) fn new(observer: &Observer, topic: &str) -> Result<Self, BusError> {
        let tap = observer.tap(topic)?;
        let (name, layout) =
            messages::with_type(topic, Described).ok_or_else(|| BusError::NoTopic { topic: topic.into() })?;
        Ok(Self { flow: Flow::new(topic, &layout), name, layout, tap })
    }

    /// Takes what has come, and shows each message to `take` as long as it wants any.
    pub(crate) fn look(&mut self, take: &mut dyn FnMut(&Layout, &[u8]) -> bool) -> Result<(), BusError> {
        let Self { layout, flow, tap, .. } = self;
        let arrived_ns = monotonic_ns();
        let mut wanted = true;
        let full = tap.drain(&mut |bytes| {
            if wanted {
                flow.take(bytes, arrived_ns);
                wanted = take(layout, bytes);
            }
        })?;
        if full {
            flow.was_full();
        }
        Ok(())
    }

    /// The topic with who is at it beside this process.
    pub(crate) fn topic(self) -> Result<Topic, BusError> {
        let mut ports = self.tap.ports()?;
        ports.subscribers.retain(|port| port.pid != std::process::id());
        Ok(Topic { name: self.name.into(), layout: self.layout, ports, flow: self.flow.report() })
    }
}

struct Described;

impl Visitor for Described {
    type Output = (&'static str, Layout);

    fn visit<M: Message>(self) -> Self::Output {
        (M::TOPIC, M::layout())
    }
}

/// Seconds on the command line.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (1e-3..=1e8).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "expected a number of seconds from 0.001 to 100000000".into())
}
