//! `plumb top` on a terminal: its screen is read back.
use rustix::process::Signal;

use crate::common::{Running, System, lives, plumb, signal, terminal::OnTerminal, until};

fn started(system: &System) -> Running {
    let running = system.start(&[]);
    system.all_run();
    running
}

fn top(system: &System, more: &[&str], size: (u16, u16)) -> OnTerminal {
    let arguments = [&["top", "--system", &system.name, "--interval", "0.2"], more].concat();
    let terminal = OnTerminal::start(plumb(&arguments), size);
    until("the view", || terminal.is_taken_over());
    terminal
}

/// Processes that stand still, until this is dropped.
struct Stopped([u32; 2]);

impl Stopped {
    fn at(pids: [u32; 2]) -> Self {
        pids.iter().for_each(|pid| signal(*pid, Signal::STOP));
        Self(pids)
    }
}

impl Drop for Stopped {
    fn drop(&mut self) {
        self.0.iter().for_each(|pid| signal(*pid, Signal::CONT));
    }
}

#[test]
fn top_shows_a_running_system_at_80_by_24_and_whatever_size_follows() {
    let system = System::new("");
    let running = started(&system);
    let mut terminal = top(&system, &[], (24, 80));
    let text = terminal.shows(&[
        &format!("{}  live  lost 0  latency p50 ", system.name),
        "horizon",
        "attitude, enu-rfu",
        "arb.",
        "last minute",
        "1000 Hz",
        "gyro       running",
        "supervisor running",
        "end to end",
        "q: quit",
    ]);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    // Braille dots: the horizon.
    terminal.shows_that("a horizon", |text| text.chars().any(|dot| ('\u{2801}'..='\u{28ff}').contains(&dot)));

    terminal.resize(40, 120);
    terminal.shows(&["restarts", "epoch", "cpu %"]);
    terminal.resize(40, 140);
    terminal.shows_that("the stages, which 140 columns have room for", |text| text.contains(" stage "));
    terminal.resize(12, 60);
    terminal.shows_that("no horizon", |text| text.contains("roll ") && !text.contains("horizon"));
    terminal.resize(5, 30);
    terminal.shows(&["30×5 is too small"]);
    terminal.resize(24, 80);
    terminal.shows(&["horizon", "end to end"]);

    terminal.press("q");
    assert_eq!(terminal.ends().code(), Some(0));
    until("the terminal to be given back", || terminal.is_given_back());
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn data_that_stop_are_stale_until_they_come_again() {
    let system = System::new("");
    let running = started(&system);
    let mut terminal = top(&system, &[], (24, 80));
    terminal.shows(&["  live  "]);
    // A supervisor that could would put another in the place of the service that stands still.
    let stopped = Stopped::at([running.pid(), running.service("course")]);
    terminal.shows_that("stale data", |text| text.lines().next().is_some_and(|bar| bar.contains("  stale ")));
    terminal.shows(&["the supervisor does not respond"]);
    drop(stopped);
    terminal.shows_that("live data", |text| text.contains("  live  ") && !text.contains("does not respond"));
    terminal.press("q");
    assert_eq!(terminal.ends().code(), Some(0));
    running.interrupt();
    running.wait();
}

#[test]
fn a_view_outlives_its_system_and_finds_the_next_of_its_name() {
    let system = System::new("");
    let running = started(&system);
    let mut terminal = top(&system, &[], (24, 80));
    terminal.shows(&["  live  "]);
    running.interrupt();
    running.wait().assert_whole();
    let text = terminal.shows(&["  ended: "]);
    assert!(text.contains("roll "), "its last attitude stays: {text}");
    let again = started(&system);
    terminal.shows(&["  live  ", "gyro       running"]);
    terminal.press("\u{3}");
    assert_eq!(terminal.ends().code(), Some(0));
    until("the terminal to be given back", || terminal.is_given_back());
    again.interrupt();
    again.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_signal_gives_the_terminal_back() {
    let system = System::new("");
    let running = started(&system);
    for name in [Signal::TERM, Signal::INT] {
        let mut terminal = top(&system, &[], (24, 80));
        signal(terminal.child.id(), name);
        assert_eq!(terminal.ends().code(), Some(0));
        until("the terminal to be given back", || terminal.is_given_back());
        assert!(!lives(terminal.child.id()));
    }
    let mut terminal = top(&system, &["--seconds", "0.5"], (24, 80));
    assert_eq!(terminal.ends().code(), Some(0));
    until("the terminal to be given back", || terminal.is_given_back());
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn lines_are_printed_where_they_are_asked_for_or_nothing_can_be_drawn() {
    let system = System::new("");
    let running = started(&system);
    let arguments = ["top", "--system", &system.name, "--interval", "0.2", "--seconds", "1.5"];
    let mut dumb = plumb(&arguments);
    dumb.env("TERM", "dumb");
    let asked = plumb(&[&arguments[..], &["--lines"]].concat());
    for command in [asked, dumb] {
        let mut terminal = OnTerminal::start_as_it_is(command, (24, 80));
        assert_eq!(terminal.ends().code(), Some(0));
        let text = terminal.shows(&["fuser      running", "end to end"]);
        assert!(!text.contains("stage"), "what 80 columns have no room for: {text}");
        assert!(!terminal.was_taken_over(), "{}", terminal.text());
    }
    running.interrupt();
    running.wait().assert_whole();
}
