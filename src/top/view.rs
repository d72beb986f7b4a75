//! Full-screen view of `plumb top`.

use std::{
    io,
    process::ExitCode,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread,
    time::{Duration, Instant},
};

use control::{ControlError, ControlRequest, ServiceStatus, send_request};
use dashboard::{Attitude, DataState, Figures, Key, Panel, Row, RowStyle, Screen, Snapshot, trend};
use observe::top::SystemSnapshot;
use runtime::{clock::monotonic_ns, frames::attitude_to_frame};

use super::observed_system::{ObservedSystem, TopCommand};
use crate::{
    failure::{Failure, Outcome},
    topics::{POLL_INTERVAL, StopCondition, frame::DisplayFrame},
};

/// Interval between two frames.
const FRAME_INTERVAL: Duration = Duration::from_millis(100);
/// Interval between two attempts to attach to the system after it has ended.
const REATTACH_INTERVAL: Duration = Duration::from_secs(1);
const KEYS: &str = "q: quit   latencies in µs, of each service from its last input";

/// Draws the system until the user quits. After the system has ended, waits for it to restart.
pub(super) fn run(command: &TopCommand, observed: ObservedSystem) -> Outcome {
    let no_terminal = |cause: io::Error| {
        Failure::new(format_args!("cannot draw on the terminal: {cause}; use --lines to print lines"), 1)
    };
    let mut stop = StopCondition::new(|| true, command.duration);
    let mut view = View::new(&observed.name);
    let mut poller = StatusPoller::start(&observed.name);
    let mut observed = Some(observed);
    let mut screen = Screen::open().map_err(no_terminal)?;
    let (mut drawn_at, mut requested_at, mut reattached_at) = (Instant::now(), Instant::now(), Instant::now());
    let mut stepped_at = Instant::now();
    while !stop.is_met() && screen.poll_key().map_err(no_terminal)? != Some(Key::Quit) {
        thread::sleep(POLL_INTERVAL.min(command.interval));
        if let Some(ObservedSystem { monitor, .. }) = &mut observed {
            monitor.poll()?;
        }
        if requested_at.elapsed() >= command.interval {
            requested_at = Instant::now();
            poller.request();
        }
        match (poller.reply(), &mut observed) {
            (Some(Ok(statuses)), Some(ObservedSystem { monitor, name, .. })) => {
                view.snapshot = Some(monitor.snapshot(name, &statuses));
                view.is_silent = false;
            }
            (Some(Err(_)), Some(_)) => view.is_silent = true,
            _ => {}
        }
        if observed.is_none() && reattached_at.elapsed() >= REATTACH_INTERVAL {
            reattached_at = Instant::now();
            // If the system is not back yet, another attempt follows.
            observed = ObservedSystem::attach(&view.display.name).ok();
            if observed.is_some() {
                view = View::new(&view.display.name);
            }
        }
        if drawn_at.elapsed() >= FRAME_INTERVAL {
            drawn_at = Instant::now();
            if let Some(system) = &observed {
                view.update(system);
            }
            // A system that has ended is no longer read, and its last frame stays on the screen.
            observed = observed.filter(|_| !matches!(view.display.state, DataState::Ended(_)));
            let step = stepped_at.elapsed() >= trend::SAMPLE_INTERVAL && observed.is_some();
            if step {
                stepped_at = Instant::now();
            }
            view.draw(&mut screen, step).map_err(no_terminal)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Queries the supervisor in a separate thread, because it may be slow or stopped.
struct StatusPoller {
    requests: SyncSender<()>,
    replies: Receiver<Result<Vec<ServiceStatus>, ControlError>>,
}

impl StatusPoller {
    fn start(name: &str) -> Self {
        let (requests, received) = sync_channel(1);
        let (reply, replies) = sync_channel(1);
        let name = name.to_owned();
        thread::spawn(move || {
            // The loop ends when the poller is dropped.
            while received.recv().is_ok() && reply.send(send_request(&name, &ControlRequest::Status)).is_ok() {}
        });
        Self { requests, replies }
    }

    /// Requests the status of the services, unless a request is pending.
    fn request(&mut self) {
        let _ = self.requests.try_send(());
    }

    fn reply(&mut self) -> Option<Result<Vec<ServiceStatus>, ControlError>> {
        self.replies.try_recv().ok()
    }
}

/// Displayed state of the system.
struct View {
    display: Snapshot,
    frame: DisplayFrame,
    snapshot: Option<SystemSnapshot>,
    /// `true` if the supervisor failed to respond to the last request.
    is_silent: bool,
}

impl View {
    fn new(name: &str) -> Self {
        let display = Snapshot { name: name.into(), key_help: KEYS, ..Snapshot::default() };
        Self { display, frame: DisplayFrame::from_local_system(name), snapshot: None, is_silent: false }
    }

    /// Updates attitude and system state.
    fn update(&mut self, observed: &ObservedSystem) {
        let ObservedSystem { observer, monitor, .. } = observed;
        let frame = self.frame.frame();
        let attitude = monitor.attitude();
        let age = attitude.map(|it| Duration::from_nanos(monotonic_ns().saturating_sub(it.header.t_sent_ns)));
        self.display.attitude =
            attitude.map(|attitude| Attitude::from_output(&attitude_to_frame(frame, *attitude), frame));
        self.display.figures.tick = attitude.map(|attitude| attitude.header.tick);
        self.display.state = match observer.is_running() {
            true => DataState::from_age(age),
            false => DataState::Ended(monitor.end_reason().unwrap_or("its supervisor is gone").into()),
        };
    }

    fn draw(&mut self, screen: &mut Screen, step: bool) -> io::Result<()> {
        let Self { display, snapshot, is_silent, .. } = self;
        // The border of the panel takes one column on each side.
        display.panels = vec![services(snapshot.as_ref(), screen.columns()?.saturating_sub(2), *is_silent)];
        if let Some(snapshot) = snapshot {
            display.figures = Figures { tick: display.figures.tick, ..figures(snapshot) };
        }
        if step {
            // For a system that is not live no attitude is added, so its trend shows a gap.
            let attitude = display.attitude.as_ref().filter(|_| display.state == DataState::Live);
            display.trends.push(&display.figures, attitude);
        }
        screen.draw(display)
    }
}

fn figures(snapshot: &SystemSnapshot) -> Figures {
    let course = snapshot.services.iter().find(|row| row.service == graph::Service::Course.name());
    Figures {
        tick: snapshot.tick,
        rate_hz: course.and_then(|row| row.rate_hz),
        latency_us: snapshot.latency_us.map(|latency| [latency.p50, latency.p99]),
        lost: Some(snapshot.services.iter().map(|row| row.lost).sum()),
    }
}

/// Returns the table of services. Services that are not running are marked.
fn services(snapshot: Option<&SystemSnapshot>, columns: usize, is_silent: bool) -> Panel {
    let title = match (is_silent, snapshot) {
        (true, _) => "services (outdated): the supervisor does not respond",
        (false, None) => "services: waiting for the supervisor",
        (false, Some(_)) => "services",
    };
    let Some(snapshot) = snapshot else { return Panel { title: title.into(), rows: Vec::new() } };
    let table = snapshot.table(Some(columns));
    // The table's own title is skipped, because the display already has one.
    let mut lines = table.lines().skip(1);
    let head = lines.next().map(|text| Row::new(RowStyle::Header, text));
    let marks =
        snapshot.services.iter().map(|row| if row.state == "running" { RowStyle::Normal } else { RowStyle::Alert });
    let marks = marks.chain(std::iter::repeat(RowStyle::Normal));
    let rows = lines.zip(marks).map(|(text, mark)| Row::new(mark, text));
    Panel { title: title.into(), rows: head.into_iter().chain(rows).collect() }
}
