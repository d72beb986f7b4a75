//! `plumb top` in a terminal, and the width of tables in a terminal.
use rustix::process::Signal;

use crate::common::{
    Running, System, is_alive, output_on_terminal, plumb, signal, terminal::TerminalProgram, wait_for,
};

fn start_system(system: &System) -> Running {
    let running = system.start(&[]);
    system.wait_until_running();
    running
}

fn top(system: &System, more: &[&str], size: (u16, u16)) -> TerminalProgram {
    let arguments = [&["top", "--system", &system.name, "--interval", "0.2"], more].concat();
    let terminal = TerminalProgram::start(plumb(&arguments), size);
    wait_for("the view", || terminal.is_full_screen());
    terminal
}

/// Frozen processes. They are resumed when this value is dropped.
struct Frozen([u32; 2]);

impl Frozen {
    fn freeze(pids: [u32; 2]) -> Self {
        pids.iter().for_each(|pid| signal(*pid, Signal::STOP));
        Self(pids)
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        self.0.iter().for_each(|pid| signal(*pid, Signal::CONT));
    }
}

#[test]
fn top_adapts_to_terminal_size() {
    let system = System::new("");
    let running = start_system(&system);
    let mut terminal = top(&system, &[], (24, 80));
    let text = terminal.wait_for_text(&[
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
    // The horizon is drawn in braille dots.
    terminal.wait_for_screen("a horizon", |text| text.chars().any(|dot| ('\u{2801}'..='\u{28ff}').contains(&dot)));

    terminal.resize(40, 120);
    terminal.wait_for_text(&["restarts", "epoch", "cpu %"]);
    terminal.resize(40, 140);
    terminal.wait_for_screen("the stages, which 140 columns have room for", |text| text.contains(" stage "));
    terminal.resize(12, 60);
    terminal.wait_for_screen("no horizon", |text| text.contains("roll ") && !text.contains("horizon"));
    terminal.resize(5, 30);
    terminal.wait_for_text(&["30×5 is too small"]);
    terminal.resize(24, 80);
    terminal.wait_for_text(&["horizon", "end to end"]);

    terminal.press("q");
    assert_eq!(terminal.wait_for_exit().code(), Some(0));
    wait_for("the terminal to be restored", || terminal.is_restored());
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn top_marks_data_as_stale_until_they_resume() {
    let system = System::new("");
    let running = start_system(&system);
    let mut terminal = top(&system, &[], (24, 80));
    terminal.wait_for_text(&["  live  "]);
    // The supervisor is frozen as well, because it would otherwise replace the frozen service.
    let frozen = Frozen::freeze([running.pid(), running.service("course")]);
    terminal.wait_for_screen("stale data", |text| text.lines().next().is_some_and(|bar| bar.contains("  stale ")));
    terminal.wait_for_text(&["the supervisor does not respond"]);
    drop(frozen);
    terminal.wait_for_screen("live data", |text| text.contains("  live  ") && !text.contains("does not respond"));
    terminal.press("q");
    assert_eq!(terminal.wait_for_exit().code(), Some(0));
    running.interrupt();
    running.wait();
}

#[test]
fn top_reconnects_to_restarted_system() {
    let system = System::new("");
    let running = start_system(&system);
    let mut terminal = top(&system, &[], (24, 80));
    terminal.wait_for_text(&["  live  "]);
    running.interrupt();
    running.wait().assert_complete();
    let text = terminal.wait_for_text(&["  ended: "]);
    assert!(text.contains("roll "), "the last attitude stays visible: {text}");
    let restarted = start_system(&system);
    terminal.wait_for_text(&["  live  ", "gyro       running"]);
    terminal.press("\u{3}");
    assert_eq!(terminal.wait_for_exit().code(), Some(0));
    wait_for("the terminal to be restored", || terminal.is_restored());
    restarted.interrupt();
    restarted.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn top_restores_terminal_after_signal() {
    let system = System::new("");
    let running = start_system(&system);
    for name in [Signal::TERM, Signal::INT] {
        let mut terminal = top(&system, &[], (24, 80));
        signal(terminal.child.id(), name);
        assert_eq!(terminal.wait_for_exit().code(), Some(0));
        wait_for("the terminal to be restored", || terminal.is_restored());
        assert!(!is_alive(terminal.child.id()));
    }
    let mut terminal = top(&system, &["--for", "0.5"], (24, 80));
    assert_eq!(terminal.wait_for_exit().code(), Some(0));
    wait_for("the terminal to be restored", || terminal.is_restored());
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn top_prints_lines_on_request_or_dumb_terminal() {
    let system = System::new("");
    let running = start_system(&system);
    let arguments = ["top", "--system", &system.name, "--interval", "0.2", "--for", "1.5"];
    let mut dumb = plumb(&arguments);
    dumb.env("TERM", "dumb");
    let with_lines = plumb(&[&arguments[..], &["--lines"]].concat());
    for command in [with_lines, dumb] {
        let mut terminal = TerminalProgram::start_unmodified(command, (24, 80));
        assert_eq!(terminal.wait_for_exit().code(), Some(0));
        let text = terminal.wait_for_text(&["fuser      running", "end to end"]);
        assert!(!text.contains("stage"), "the column does not fit into 80 columns: {text}");
        assert!(!terminal.was_full_screen(), "{}", terminal.text());
    }
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn tables_fit_80_columns_of_terminal() {
    let system = System::new("");
    let running = start_system(&system);
    for arguments in [&["ps"][..], &["topic", "list"], &["doctor", "--for", "200ms"]] {
        let output = output_on_terminal(&[arguments, &["--color", "never", "--system", &system.name]].concat());
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("course") || text.contains("attitude"), "{text}");
        // Remedies are not wrapped, so that their commands can be pasted.
        let long = text.lines().map(str::trim_end).find(|line| line.chars().count() > 80 && !line.contains('→'));
        assert_eq!(long, None, "{text}");
    }
    drop(running);
}
