//! The terminal: full-screen mode, keys and restoration.

use std::{
    io::{self, IsTerminal},
    time::Duration,
};

use ratatui::{
    DefaultTerminal,
    crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers},
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::{Snapshot, drawing};

/// Terminal in full-screen mode. It is restored on drop and on a panic.
#[derive(Debug)]
pub struct Screen(DefaultTerminal);

/// Key that has a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Quit: q, Ctrl-C.
    Quit,
    /// Select the previous item: up, k.
    Previous,
    /// Select the next item: down, j.
    Next,
}

impl Screen {
    /// Returns `true` if standard input and output are a terminal that can be drawn on.
    pub fn is_available() -> bool {
        let has_terminal_type = std::env::var_os("TERM").is_some_and(|name| name != "dumb");
        has_terminal_type && io::stdout().is_terminal() && io::stdin().is_terminal()
    }

    /// Switches the terminal to full-screen mode.
    ///
    /// # Errors
    ///
    /// Returns an error if the terminal cannot be switched. In this case, the terminal is restored.
    pub fn open() -> io::Result<Self> {
        ratatui::try_init().map(Self).inspect_err(|_| ratatui::restore())
    }

    /// Returns the width of the terminal in columns.
    ///
    /// # Errors
    ///
    /// Returns an error if the size cannot be read.
    pub fn columns(&self) -> io::Result<usize> {
        Ok(self.0.size()?.width.into())
    }

    /// Draws a snapshot over the whole terminal.
    ///
    /// # Errors
    ///
    /// Returns an error if the terminal cannot be written.
    pub fn draw(&mut self, snapshot: &Snapshot) -> io::Result<()> {
        self.0.draw(|frame| drawing::draw(frame, snapshot)).map(drop)
    }

    /// Returns the next pressed key that has a function, if any, without waiting.
    ///
    /// # Errors
    ///
    /// Returns an error if the terminal is closed or cannot be read.
    pub fn poll_key(&self) -> io::Result<Option<Key>> {
        // A closed terminal must be detected here, because crossterm would read from it forever.
        let stdin = io::stdin();
        let mut fd = [PollFd::new(&stdin, PollFlags::IN)];
        poll(&mut fd, Some(&Timespec::default()))?;
        if fd[0].revents().intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        while event::poll(Duration::ZERO)? {
            if let Some(key) = to_key(&event::read()?) {
                return Ok(Some(key));
            }
        }
        Ok(None)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

fn to_key(event: &Event) -> Option<Key> {
    let Event::Key(key) = event else { return None };
    if key.kind == KeyEventKind::Release {
        return None;
    }
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(Key::Quit),
        KeyCode::Char('q') => Some(Key::Quit),
        KeyCode::Up | KeyCode::Char('k') => Some(Key::Previous),
        KeyCode::Down | KeyCode::Char('j') => Some(Key::Next),
        _ => None,
    }
}
