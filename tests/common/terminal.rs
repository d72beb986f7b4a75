//! A terminal of a test: a pseudo-terminal whose screen is read back.
use std::{
    fs::{File, OpenOptions},
    io::{Read, Write},
    os::fd::OwnedFd,
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rustix::{
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize},
};
use vt100::Parser;

/// Sets the title of the terminal, and changes nothing on the screen.
const END: &[u8] = b"\x1b]0;end\x07";

/// A program on a terminal. It ends with the test.
pub(crate) struct OnTerminal {
    pub(crate) child: Child,
    keys: File,
    /// The program's side, which stays open so that what is left of it can be read.
    side: File,
    screen: Arc<Mutex<Parser>>,
    was_taken_over: Arc<AtomicBool>,
    /// What the program wrote last is on the screen.
    is_all_shown: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl OnTerminal {
    /// Starts it on a terminal of so many lines and columns.
    pub(crate) fn start(mut command: Command, size: (u16, u16)) -> Self {
        command.env("TERM", "xterm-256color").env_remove("NO_COLOR");
        Self::start_as_it_is(command, size)
    }

    /// The same in the environment of the command.
    pub(crate) fn start_as_it_is(mut command: Command, (lines, columns): (u16, u16)) -> Self {
        let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&near).unwrap();
        unlockpt(&near).unwrap();
        let path = ptsname(&near, Vec::new()).unwrap();
        let side = OpenOptions::new().read(true).write(true).open(path.to_str().unwrap()).unwrap();
        tcsetwinsize(&near, size(lines, columns)).unwrap();
        let end = || Stdio::from(OwnedFd::from(side.try_clone().unwrap()));
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        let screen = Arc::new(Mutex::new(Parser::new(lines.try_into().unwrap(), columns.try_into().unwrap(), 0)));
        let keys = File::from(near);
        let (mut from, to) = (keys.try_clone().unwrap(), screen.clone());
        let was_taken_over = Arc::new(AtomicBool::new(false));
        let is_all_shown = Arc::new(AtomicBool::new(false));
        let (was, all) = (was_taken_over.clone(), is_all_shown.clone());
        let reader = thread::spawn(move || {
            let (mut bytes, mut last) = ([0; 4096], Vec::new());
            while let Ok(count @ 1..) = from.read(&mut bytes) {
                let mut parser = to.lock().unwrap();
                parser.process(&bytes[..count]);
                was.fetch_or(parser.screen().alternate_screen(), Ordering::SeqCst);
                last.extend_from_slice(&bytes[..count]);
                all.fetch_or(last.windows(END.len()).any(|bytes| bytes == END), Ordering::SeqCst);
                last.drain(..last.len().saturating_sub(END.len()));
            }
        });
        Self { child, keys, side, screen, was_taken_over, is_all_shown, reader: Some(reader) }
    }

    /// What is on the screen, line by line.
    pub(crate) fn text(&self) -> String {
        self.screen.lock().unwrap().screen().contents()
    }

    /// Waits until what is on the screen holds all the words.
    pub(crate) fn shows(&self, words: &[&str]) -> String {
        self.shows_that(&format!("{words:?}"), |text| words.iter().all(|word| text.contains(word)))
    }

    /// The same of whatever must hold of it.
    pub(crate) fn shows_that(&self, what: &str, holds: impl Fn(&str) -> bool) -> String {
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            let text = self.text();
            if holds(&text) {
                return text;
            }
            assert!(Instant::now() < deadline, "waited in vain for {what}:\n{text}");
            thread::sleep(Duration::from_millis(5));
        }
    }

    pub(crate) fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
    }

    pub(crate) fn resize(&self, lines: u16, columns: u16) {
        self.screen.lock().unwrap().screen_mut().set_size(lines.try_into().unwrap(), columns.try_into().unwrap());
        tcsetwinsize(&self.keys, size(lines, columns)).unwrap();
    }

    /// A view has taken the terminal over.
    pub(crate) fn is_taken_over(&self) -> bool {
        self.screen.lock().unwrap().screen().alternate_screen() && !self.reads_lines()
    }

    /// A view took it over at any time.
    pub(crate) fn was_taken_over(&self) -> bool {
        self.was_taken_over.load(Ordering::SeqCst)
    }

    /// The terminal is as a shell wants it: its own screen, a visible cursor, and what is typed is seen and comes line by line.
    pub(crate) fn is_given_back(&self) -> bool {
        let screen = self.screen.lock().unwrap();
        !screen.screen().alternate_screen() && !screen.screen().hide_cursor() && self.reads_lines()
    }

    fn reads_lines(&self) -> bool {
        let modes = tcgetattr(&self.side).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
    }

    /// Waits for its end and until all that it wrote is on the screen.
    pub(crate) fn ends(&mut self) -> ExitStatus {
        let deadline = Instant::now() + Duration::from_secs(60);
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < deadline, "it does not end:\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        };
        // What the program wrote last comes before this.
        self.side.write_all(END).unwrap();
        while !self.is_all_shown.load(Ordering::SeqCst) {
            assert!(Instant::now() < deadline, "what it wrote last does not come:\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        }
        status
    }
}

impl Drop for OnTerminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.reader.take();
    }
}

fn size(ws_row: u16, ws_col: u16) -> Winsize {
    Winsize { ws_row, ws_col, ws_xpixel: 0, ws_ypixel: 0 }
}
