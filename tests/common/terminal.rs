//! Pseudo-terminals with a screen that tests can read.
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

/// Escape sequence that sets the terminal's title. It marks the end of the output and does not
/// change the screen.
const END: &[u8] = b"\x1b]0;end\x07";

/// Program running in a terminal. It is killed when dropped.
pub(crate) struct TerminalProgram {
    pub(crate) child: Child,
    keys: File,
    /// Side of the terminal that the program uses. It stays open, so that remaining output can be
    /// read.
    program_side: File,
    screen: Arc<Mutex<Parser>>,
    was_full_screen: Arc<AtomicBool>,
    /// `true` once [`END`] has been read.
    has_read_end: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl TerminalProgram {
    /// Starts a command in a terminal of this size, in lines and columns.
    pub(crate) fn start(mut command: Command, size: (u16, u16)) -> Self {
        command.env("TERM", "xterm-256color").env_remove("NO_COLOR");
        Self::start_unmodified(command, size)
    }

    /// Starts a command with its environment unchanged.
    pub(crate) fn start_unmodified(mut command: Command, (lines, columns): (u16, u16)) -> Self {
        let controller = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&controller).unwrap();
        unlockpt(&controller).unwrap();
        let path = ptsname(&controller, Vec::new()).unwrap();
        let program_side = OpenOptions::new().read(true).write(true).open(path.to_str().unwrap()).unwrap();
        tcsetwinsize(&controller, size(lines, columns)).unwrap();
        let end = || Stdio::from(OwnedFd::from(program_side.try_clone().unwrap()));
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        let screen = Arc::new(Mutex::new(Parser::new(lines.try_into().unwrap(), columns.try_into().unwrap(), 0)));
        let keys = File::from(controller);
        let (mut from, to) = (keys.try_clone().unwrap(), screen.clone());
        let was_full_screen = Arc::new(AtomicBool::new(false));
        let has_read_end = Arc::new(AtomicBool::new(false));
        let (full_screen_seen, end_read) = (was_full_screen.clone(), has_read_end.clone());
        let reader = thread::spawn(move || {
            let (mut bytes, mut last) = ([0; 4096], Vec::new());
            while let Ok(count @ 1..) = from.read(&mut bytes) {
                let mut parser = to.lock().unwrap();
                parser.process(&bytes[..count]);
                full_screen_seen.fetch_or(parser.screen().alternate_screen(), Ordering::SeqCst);
                last.extend_from_slice(&bytes[..count]);
                end_read.fetch_or(last.windows(END.len()).any(|bytes| bytes == END), Ordering::SeqCst);
                last.drain(..last.len().saturating_sub(END.len()));
            }
        });
        Self { child, keys, program_side, screen, was_full_screen, has_read_end, reader: Some(reader) }
    }

    /// Returns the text on the screen, line by line.
    pub(crate) fn text(&self) -> String {
        self.screen.lock().unwrap().screen().contents()
    }

    /// Waits until the screen contains all the words and returns its text.
    pub(crate) fn wait_for_text(&self, words: &[&str]) -> String {
        self.wait_for_screen(&format!("{words:?}"), |text| words.iter().all(|word| text.contains(word)))
    }

    /// Waits until the text on the screen satisfies `holds`, and returns the text.
    pub(crate) fn wait_for_screen(&self, what: &str, holds: impl Fn(&str) -> bool) -> String {
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            let text = self.text();
            if holds(&text) {
                return text;
            }
            assert!(Instant::now() < deadline, "timed out waiting for {what}:\n{text}");
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

    /// Returns `true` while the program shows the alternate screen and reads single keys.
    pub(crate) fn is_full_screen(&self) -> bool {
        self.screen.lock().unwrap().screen().alternate_screen() && !self.is_in_line_mode()
    }

    /// Returns `true` if the program has ever shown the alternate screen.
    pub(crate) fn was_full_screen(&self) -> bool {
        self.was_full_screen.load(Ordering::SeqCst)
    }

    /// Returns `true` if the terminal is in the state that a shell needs.
    ///
    /// This means the main screen, a visible cursor, echo and line mode.
    pub(crate) fn is_restored(&self) -> bool {
        let screen = self.screen.lock().unwrap();
        !screen.screen().alternate_screen() && !screen.screen().hide_cursor() && self.is_in_line_mode()
    }

    fn is_in_line_mode(&self) -> bool {
        let modes = tcgetattr(&self.program_side).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
    }

    /// Waits until the program has exited and all its output is on the screen.
    pub(crate) fn wait_for_exit(&mut self) -> ExitStatus {
        let deadline = Instant::now() + Duration::from_secs(60);
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < deadline, "timed out waiting for the program to exit:\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        };
        // The program's last output arrives before this mark.
        self.program_side.write_all(END).unwrap();
        while !self.has_read_end.load(Ordering::SeqCst) {
            assert!(Instant::now() < deadline, "timed out waiting for the last output:\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        }
        status
    }
}

impl Drop for TerminalProgram {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.reader.take();
    }
}

fn size(ws_row: u16, ws_col: u16) -> Winsize {
    Winsize { ws_row, ws_col, ws_xpixel: 0, ws_ypixel: 0 }
}
