//! The terminal is given back by a panic, too: on a real pseudo-terminal.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../../../tests/common/terminal.rs"]
#[allow(dead_code, reason = "each executable uses its part")]
mod terminal;

use std::{env, process::Command, thread, time::Duration};

use dashboard::{Picture, Screen};
use terminal::OnTerminal;

/// In the environment of the process that panics.
const PANICS: &str = "PLUMBLINE_PANICS_WHILE_IT_DRAWS";

/// Of the process that the test starts.
fn panic_while_it_draws() {
    let mut screen = Screen::open().unwrap();
    screen.draw(&Picture { name: "boat".into(), ..Picture::default() }).unwrap();
    // Until the picture has been seen.
    while screen.key().unwrap().is_none() {
        thread::sleep(Duration::from_millis(5));
    }
    panic!("the hull leaks");
}

#[test]
fn a_panic_gives_the_terminal_back_and_is_read_there() {
    if env::var_os(PANICS).is_some() {
        return panic_while_it_draws();
    }
    let mut command = Command::new(env::current_exe().unwrap());
    command.args(["--exact", "a_panic_gives_the_terminal_back_and_is_read_there", "--nocapture"]).env(PANICS, "");
    let mut terminal = OnTerminal::start(command, (24, 80));
    terminal.shows(&["boat  connecting"]);
    assert!(terminal.is_taken_over());
    terminal.press("q");
    assert!(!terminal.ends().success());
    let text = terminal.shows(&["the hull leaks"]);
    assert!(terminal.is_given_back(), "{text}");
    assert!(!text.contains("connecting"), "the picture has gone with the view: {text}");
}
