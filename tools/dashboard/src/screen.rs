//! The terminal: taken over as a whole, given back as it was.

use std::{
    io::{self, IsTerminal},
    time::Duration,
};

use ratatui::{
    DefaultTerminal,
    crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers},
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::{Picture, drawing};

/// A terminal that is drawn upon as a whole. It is given back when this is dropped, and by a panic.
#[derive(Debug)]
pub struct Screen(DefaultTerminal);

/// What somebody asks by a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// To end: q, Ctrl-C.
    End,
    /// The one before: up.
    Before,
    /// The one after: down.
    After,
}

impl Screen {
    /// There is a terminal that can be drawn upon and that keys come from.
    pub fn is_there() -> bool {
        let is_able = std::env::var_os("TERM").is_some_and(|name| name != "dumb");
        is_able && io::stdout().is_terminal() && io::stdin().is_terminal()
    }

    /// Takes the terminal over.
    pub fn open() -> io::Result<Self> {
        ratatui::try_init().map(Self).inspect_err(|_| ratatui::restore())
    }

    /// Columns there are.
    pub fn columns(&self) -> io::Result<usize> {
        Ok(self.0.size()?.width.into())
    }

    /// Draws a picture in the place of the one before, as large as the terminal is now.
    pub fn draw(&mut self, picture: &Picture) -> io::Result<()> {
        self.0.draw(|frame| drawing::draw(frame, picture)).map(drop)
    }

    /// The next key that means something, if there is one.
    pub fn key(&self) -> io::Result<Option<Key>> {
        // Of a terminal that is gone crossterm would read for ever.
        let stdin = io::stdin();
        let mut fd = [PollFd::new(&stdin, PollFlags::IN)];
        poll(&mut fd, Some(&Timespec::default()))?;
        if fd[0].revents().intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        while event::poll(Duration::ZERO)? {
            if let Some(key) = meaning(&event::read()?) {
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

fn meaning(event: &Event) -> Option<Key> {
    let Event::Key(key) = event else { return None };
    if key.kind == KeyEventKind::Release {
        return None;
    }
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(Key::End),
        KeyCode::Char('q') => Some(Key::End),
        KeyCode::Up | KeyCode::Char('k') => Some(Key::Before),
        KeyCode::Down | KeyCode::Char('j') => Some(Key::After),
        _ => None,
    }
}
