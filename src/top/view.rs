//! The view of the whole terminal.

use std::{
    io,
    process::ExitCode,
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread,
    time::{Duration, Instant},
};

use control::{ControlError, ControlRequest, ServiceStatus, send_request};
use dashboard::{Attitude, Facts, Key, Mark, Panel, Picture, Row, Screen, State, trend};
use observe::top::Moment;
use runtime::{clock::monotonic_ns, frames::attitude_to_frame};

use super::{Observed, TopCommand};
use crate::{
    fail,
    seeing::{LOOK, Until, frame::Shown},
};

/// Between two pictures.
const PICTURE_INTERVAL: Duration = Duration::from_millis(100);
/// Between two looks for a system that has ended, or another of its name.
const RETURN_INTERVAL: Duration = Duration::from_secs(1);
const KEYS: &str = "q ends; latencies in µs, of each service from its last input on";

/// Why a view came to its end.
#[derive(Debug, thiserror::Error)]
enum ViewError {
    #[error("drawing on the terminal: {0}; --lines prints lines in place of it")]
    Terminal(#[from] io::Error),
    #[error(transparent)]
    Bus(#[from] bus::BusError),
}

/// Draws the system until somebody ends it; one that ends is waited for, as it may be started again.
pub(super) fn run(command: &TopCommand, observed: Observed) -> ExitCode {
    match watch(command, observed) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error, 1),
    }
}

fn watch(command: &TopCommand, observed: Observed) -> Result<(), ViewError> {
    let mut until = Until::new(|| true, command.seconds);
    let mut view = View::new(&observed.name);
    let mut supervisor = Supervisor::of(&observed.name);
    let mut observed = Some(observed);
    let mut screen = Screen::open()?;
    let (mut drawn_at, mut asked_at, mut returned_at) = (Instant::now(), Instant::now(), Instant::now());
    let mut stepped_at = Instant::now();
    while !until.is_over() && screen.key()? != Some(Key::End) {
        thread::sleep(LOOK.min(command.interval));
        if let Some(Observed { top, .. }) = &mut observed {
            top.look()?;
        }
        if asked_at.elapsed() >= command.interval {
            asked_at = Instant::now();
            supervisor.ask();
        }
        match (supervisor.answer(), &mut observed) {
            (Some(Ok(statuses)), Some(Observed { top, name, .. })) => {
                view.moment = Some(top.moment(name, &statuses));
                view.is_silent = false;
            }
            (Some(Err(_)), Some(_)) => view.is_silent = true,
            _ => {}
        }
        if observed.is_none() && returned_at.elapsed() >= RETURN_INTERVAL {
            returned_at = Instant::now();
            // Where it is not back yet, the next look finds it.
            observed = Observed::begin(&view.picture.name).ok();
            if observed.is_some() {
                view = View::new(&view.picture.name);
            }
        }
        if drawn_at.elapsed() >= PICTURE_INTERVAL {
            drawn_at = Instant::now();
            if let Some(of) = &observed {
                view.see(of);
            }
            // What has ended is read no more; its last picture stays.
            observed = observed.filter(|_| !matches!(view.picture.state, State::Ended(_)));
            let step = stepped_at.elapsed() >= trend::STEP && observed.is_some();
            if step {
                stepped_at = Instant::now();
            }
            view.draw(&mut screen, step)?;
        }
    }
    Ok(())
}

/// The supervisor, asked by a thread of its own: it may take its time, or be frozen.
struct Supervisor {
    questions: SyncSender<()>,
    answers: Receiver<Result<Vec<ServiceStatus>, ControlError>>,
}

impl Supervisor {
    fn of(name: &str) -> Self {
        let (questions, asked) = sync_channel(1);
        let (answer, answers) = sync_channel(1);
        let name = name.to_owned();
        thread::spawn(move || {
            // Ends with whoever asks.
            while asked.recv().is_ok() && answer.send(send_request(&name, &ControlRequest::Status)).is_ok() {}
        });
        Self { questions, answers }
    }

    /// Asks how the services are, unless a question is open.
    fn ask(&mut self) {
        let _ = self.questions.try_send(());
    }

    fn answer(&mut self) -> Option<Result<Vec<ServiceStatus>, ControlError>> {
        self.answers.try_recv().ok()
    }
}

/// What is known of the system.
struct View {
    picture: Picture,
    shown: Shown,
    moment: Option<Moment>,
    /// The supervisor does not answer.
    is_silent: bool,
}

impl View {
    fn new(name: &str) -> Self {
        let picture = Picture { name: name.into(), keys: KEYS, ..Picture::default() };
        Self { picture, shown: Shown::on_board(name), moment: None, is_silent: false }
    }

    /// Takes the attitude and the state.
    fn see(&mut self, observed: &Observed) {
        let Observed { observer, top, .. } = observed;
        let frame = self.shown.frame();
        let attitude = top.attitude();
        let age = attitude.map(|it| Duration::from_nanos(monotonic_ns().saturating_sub(it.header.t_sent_ns)));
        self.picture.attitude = attitude.map(|attitude| Attitude::of(&attitude_to_frame(frame, *attitude), frame));
        self.picture.facts.tick = attitude.map(|attitude| attitude.header.tick);
        self.picture.state = match observer.is_running() {
            true => State::of_age(age),
            false => State::Ended(top.end().unwrap_or("its supervisor is gone").into()),
        };
    }

    fn draw(&mut self, screen: &mut Screen, step: bool) -> io::Result<()> {
        let Self { picture, moment, is_silent, .. } = self;
        // The frame of the panel takes a column at either side.
        picture.panels = vec![services(moment.as_ref(), screen.columns()?.saturating_sub(2), *is_silent)];
        if let Some(moment) = moment {
            picture.facts = Facts { tick: picture.facts.tick, ..facts(moment) };
        }
        if step {
            // What stands still has no trend: a gap says so.
            let attitude = picture.attitude.as_ref().filter(|_| picture.state == State::Live);
            picture.trends.step(&picture.facts, attitude);
        }
        screen.draw(picture)
    }
}

fn facts(moment: &Moment) -> Facts {
    let course = moment.services.iter().find(|row| row.service == graph::Service::Course.name());
    Facts {
        tick: moment.tick,
        rate_hz: course.and_then(|row| row.rate_hz),
        latency_us: moment.latency_us.map(|latency| [latency.p50, latency.p99]),
        lost: Some(moment.services.iter().map(|row| row.lost).sum()),
    }
}

/// The table of the services; a line of one that does not run is marked.
fn services(moment: Option<&Moment>, columns: usize, is_silent: bool) -> Panel {
    let title = match (is_silent, moment) {
        (true, _) => "services, as last told: the supervisor does not answer",
        (false, None) => "services: the supervisor is asked",
        (false, Some(_)) => "services",
    };
    let Some(moment) = moment else { return Panel { title: title.into(), rows: Vec::new() } };
    let table = moment.table(Some(columns));
    // Its title is in the picture already.
    let mut lines = table.lines().skip(1);
    let head = lines.next().map(|text| Row::new(Mark::Head, text));
    let marks = moment.services.iter().map(|row| if row.state == "running" { Mark::Usual } else { Mark::Bad });
    let marks = marks.chain(std::iter::repeat(Mark::Usual));
    let rows = lines.zip(marks).map(|(text, mark)| Row::new(mark, text));
    Panel { title: title.into(), rows: head.into_iter().chain(rows).collect() }
}
