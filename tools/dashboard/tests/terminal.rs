//! Restoration of the terminal after a panic, on a real pseudo-terminal.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../../../tests/common/terminal.rs"]
#[allow(dead_code, reason = "each executable uses its part")]
mod terminal;

use std::{env, process::Command, thread, time::Duration};

use dashboard::{Screen, Snapshot};
use terminal::TerminalProgram;

/// Environment variable that makes the test process panic.
const PANIC_VARIABLE: &str = "PLUMBLINE_PANIC_WHILE_DRAWING";

/// Draws a frame, then panics. Runs in a child process.
fn draw_and_panic() {
    let mut screen = Screen::open().unwrap();
    screen.draw(&Snapshot { name: "boat".into(), ..Snapshot::default() }).unwrap();
    // A key press shows that the parent has seen the frame.
    while screen.poll_key().unwrap().is_none() {
        thread::sleep(Duration::from_millis(5));
    }
    panic!("the hull leaks");
}

#[test]
fn panic_restores_terminal_and_is_printed() {
    if env::var_os(PANIC_VARIABLE).is_some() {
        return draw_and_panic();
    }
    let mut command = Command::new(env::current_exe().unwrap());
    command.args(["--exact", "panic_restores_terminal_and_is_printed", "--nocapture"]).env(PANIC_VARIABLE, "");
    let mut terminal = TerminalProgram::start(command, (24, 80));
    terminal.wait_for_text(&["boat  connecting"]);
    assert!(terminal.is_full_screen());
    terminal.press("q");
    assert!(!terminal.wait_for_exit().success());
    let text = terminal.wait_for_text(&["the hull leaks"]);
    assert!(terminal.is_restored(), "{text}");
    assert!(!text.contains("connecting"), "the frame is removed with the full-screen mode: {text}");
}
