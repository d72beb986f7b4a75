//! The thread that writes to standard error: a terminal may stand still, and nobody waits for it.
//!
//! Input: lines that stay, and pictures that replace each other. Output: live lines on a terminal, plain lines elsewhere. Time: none.
//! Failure: of what nobody takes the lines wait up to a limit, then they are counted; of pictures the newest waits.

use std::{
    collections::VecDeque,
    io::IsTerminal,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::{UpError, people};

/// Terminal frames per second at most.
const FRAMES_HZ: u8 = 10;
/// Lines that wait to be taken.
const LINES_MAX: usize = 256;
/// How long the end waits for somebody to take what is left.
const END_LIMIT: Duration = Duration::from_secs(1);

/// What a terminal shows now.
#[derive(Debug, Default)]
pub(super) struct Picture {
    pub(super) lines: Vec<String>,
    /// How far it is, and what is said of that; only where the end is known.
    pub(super) progress: Option<(u64, String)>,
}

/// What is still to be written.
#[derive(Debug, Default)]
struct Waiting {
    lines: VecDeque<String>,
    /// Lines for which there was no room.
    left_out: u64,
    picture: Option<Picture>,
    ends: bool,
}

/// The thread, and what waits for it.
pub(super) struct Painter {
    waiting: Arc<(Mutex<Waiting>, Condvar)>,
    thread: JoinHandle<()>,
    is_terminal: bool,
}

impl Painter {
    /// For pictures of `lines` lines, and a bar up to `ticks` below.
    pub(super) fn new(lines: usize, ticks: Option<u64>) -> Result<Self, UpError> {
        let is_terminal = std::io::stderr().is_terminal();
        let screen = is_terminal.then(|| Screen::new(lines, ticks));
        let waiting = Arc::new((Mutex::default(), Condvar::new()));
        let shared = waiting.clone();
        let thread = thread::Builder::new()
            .name("view".into())
            .spawn(move || paint(&shared, |line| show(screen.as_ref(), line), |picture| draw(screen.as_ref(), picture)))
            .map_err(|cause| UpError::System { doing: "starting the thread that shows how it goes".into(), cause })?;
        Ok(Self { waiting, thread, is_terminal })
    }

    /// Pictures are shown.
    pub(super) fn is_terminal(&self) -> bool {
        self.is_terminal
    }

    /// Shows a line that stays.
    pub(super) fn line(&self, line: String) {
        self.change(|waiting| {
            if waiting.lines.len() < LINES_MAX {
                waiting.lines.push_back(line);
            } else {
                waiting.left_out += 1;
            }
        });
    }

    /// Shows a picture in the place of the one before.
    pub(super) fn picture(&self, picture: Picture) {
        self.change(|waiting| waiting.picture = Some(picture));
    }

    /// Waits until all of it has been taken, as long as that is allowed to take. The last picture stays.
    pub(super) fn end(&self) {
        self.change(|waiting| waiting.ends = true);
        let deadline = Instant::now() + END_LIMIT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn change(&self, change: impl FnOnce(&mut Waiting)) {
        change(&mut lock(&self.waiting.0));
        self.waiting.1.notify_one();
    }
}

/// Shows what waits until the end.
fn paint(waiting: &(Mutex<Waiting>, Condvar), mut show: impl FnMut(&str), mut draw: impl FnMut(&Picture)) {
    loop {
        let idle = |waiting: &mut Waiting| waiting.lines.is_empty() && waiting.picture.is_none() && !waiting.ends;
        let mut now = waiting.1.wait_while(lock(&waiting.0), idle).unwrap_or_else(PoisonError::into_inner);
        let (lines, picture) = (std::mem::take(&mut now.lines), now.picture.take());
        let (left_out, ends) = (std::mem::take(&mut now.left_out), now.ends);
        drop(now);
        lines.iter().for_each(|line| show(line));
        if left_out > 0 {
            show(&format!("{left_out} more lines are not shown: nobody took them"));
        }
        if let Some(picture) = picture {
            draw(&picture);
        }
        if ends {
            return;
        }
    }
}

fn lock(waiting: &Mutex<Waiting>) -> MutexGuard<'_, Waiting> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner)
}

fn show(screen: Option<&Screen>, line: &str) {
    match screen {
        // A terminal that cannot be written to shows nothing.
        Some(screen) => drop(screen.all.println(line)),
        None => people::say(line, people::NO_LIMIT),
    }
}

fn draw(screen: Option<&Screen>, picture: &Picture) {
    let Some(Screen { lines, bar, .. }) = screen else { return };
    for (line, text) in lines.iter().zip(&picture.lines) {
        line.set_message(text.clone());
    }
    if let Some((bar, (ticks, text))) = bar.as_ref().zip(picture.progress.as_ref()) {
        bar.set_position(*ticks);
        bar.set_message(text.clone());
    }
}

/// The live lines of a terminal.
struct Screen {
    all: MultiProgress,
    lines: Vec<ProgressBar>,
    bar: Option<ProgressBar>,
}

impl Screen {
    fn new(lines: usize, ticks: Option<u64>) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(FRAMES_HZ));
        let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        let lines = (0..lines).map(|_| all.add(ProgressBar::new_spinner().with_style(style.clone()))).collect();
        let bar = ticks.map(|ticks| {
            let style = ProgressStyle::with_template("{bar:40} {percent:>3} % of {len} ticks, {msg}, {eta} left")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            all.add(ProgressBar::new(ticks).with_style(style))
        });
        Self { all, lines, bar }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.lines.iter().chain(&self.bar).for_each(ProgressBar::abandon);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn of_what_nobody_takes_a_number_of_lines_and_the_newest_picture_wait() {
        let waiting = Arc::new((Mutex::default(), Condvar::new()));
        let (going, go) = mpsc::channel::<()>();
        let (shared, (taken, seen)) = (waiting.clone(), mpsc::channel::<String>());
        let thread = thread::spawn(move || {
            let show = |line: &str| {
                taken.send(line.into()).unwrap();
                // A terminal that stands still from the first line on.
                let _ = go.recv();
            };
            let taken = taken.clone();
            paint(&shared, show, |picture| taken.send(picture.lines.concat()).unwrap());
        });
        let painter = Painter { waiting, thread, is_terminal: false };
        painter.line("first".into());
        assert_eq!(seen.recv().unwrap(), "first");
        for one in 0..LINES_MAX + 7 {
            painter.line(format!("line {one}"));
            painter.picture(Picture { lines: vec![format!("picture {one}")], progress: None });
        }
        drop(going);
        painter.end();
        let rest: Vec<_> = seen.iter().collect();
        assert_eq!(rest.len(), LINES_MAX + 2);
        assert_eq!(rest[LINES_MAX - 1], format!("line {}", LINES_MAX - 1));
        assert!(rest[LINES_MAX].starts_with("7 more lines"), "{}", rest[LINES_MAX]);
        assert_eq!(rest[LINES_MAX + 1], format!("picture {}", LINES_MAX + 6));
    }
}
