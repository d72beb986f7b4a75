//! Thread that writes to standard error, so that a blocked terminal never blocks the supervisor.
//!
//! - Input: permanent lines, and frames that replace each other.
//! - Output: live lines on a terminal, plain lines elsewhere.
//! - Failure: while the terminal is blocked, a limited number of lines and the newest frame wait.
//!   Further lines are dropped and counted.

use std::{
    collections::VecDeque,
    io::IsTerminal,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::{error::UpError, terminal};

/// Maximum redraw rate of the terminal, Hz.
const MAX_FRAMES_HZ: u8 = 10;
/// Maximum number of lines that wait to be written.
const MAX_LINES: usize = 256;
/// Time limit for writing the remaining lines at shutdown.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Content of the live lines.
#[derive(Debug, Default)]
pub(super) struct Frame {
    pub(super) lines: Vec<String>,
    /// Progress in ticks and its label; `None` if the number of ticks is unknown.
    pub(super) progress: Option<(u64, String)>,
}

/// Content that waits to be written.
#[derive(Debug, Default)]
struct PaintQueue {
    lines: VecDeque<String>,
    /// Number of lines dropped because the queue was full.
    dropped_lines: u64,
    frame: Option<Frame>,
    stop: bool,
}

/// Writer thread and its queue.
pub(super) struct Painter {
    queue: Arc<(Mutex<PaintQueue>, Condvar)>,
    thread: JoinHandle<()>,
    is_terminal: bool,
}

impl Painter {
    /// Starts the thread, for frames of `lines` lines and a progress bar up to `ticks`. If `quiet`
    /// is `true`, only lines are written, even on a terminal.
    pub(super) fn new(lines: usize, ticks: Option<u64>, quiet: bool) -> Result<Self, UpError> {
        let is_terminal = std::io::stderr().is_terminal() && !quiet;
        let screen = is_terminal.then(|| Screen::new(lines, ticks));
        let queue = Arc::new((Mutex::default(), Condvar::new()));
        let shared = queue.clone();
        let thread = thread::Builder::new()
            .name("view".into())
            .spawn(move || {
                paint(&shared, |line| print_line(screen.as_ref(), line), |frame| draw_frame(screen.as_ref(), frame))
            })
            .map_err(|cause| UpError::System { action: "starting the display thread".into(), cause })?;
        Ok(Self { queue, thread, is_terminal })
    }

    /// Returns `true` if standard error is a terminal that shows frames.
    pub(super) fn is_terminal(&self) -> bool {
        self.is_terminal
    }

    /// Prints a permanent line.
    pub(super) fn print_line(&self, line: String) {
        self.update(|queue| {
            if queue.lines.len() < MAX_LINES {
                queue.lines.push_back(line);
            } else {
                queue.dropped_lines += 1;
            }
        });
    }

    /// Replaces the frame.
    pub(super) fn show_frame(&self, frame: Frame) {
        self.update(|queue| queue.frame = Some(frame));
    }

    /// Waits until everything is written, within a time limit. The last frame stays on the
    /// terminal.
    pub(super) fn finish(&self) {
        self.update(|queue| queue.stop = true);
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn update(&self, update: impl FnOnce(&mut PaintQueue)) {
        update(&mut lock(&self.queue.0));
        self.queue.1.notify_one();
    }
}

/// Writes queued content until shutdown.
fn paint(queue: &(Mutex<PaintQueue>, Condvar), mut show: impl FnMut(&str), mut draw: impl FnMut(&Frame)) {
    loop {
        let idle = |queue: &mut PaintQueue| queue.lines.is_empty() && queue.frame.is_none() && !queue.stop;
        let mut pending = queue.1.wait_while(lock(&queue.0), idle).unwrap_or_else(PoisonError::into_inner);
        let (lines, frame) = (std::mem::take(&mut pending.lines), pending.frame.take());
        let (dropped_lines, stop) = (std::mem::take(&mut pending.dropped_lines), pending.stop);
        drop(pending);
        lines.iter().for_each(|line| show(line));
        if dropped_lines > 0 {
            show(&format!("{dropped_lines} more lines are not shown: the terminal is blocked"));
        }
        if let Some(frame) = frame {
            draw(&frame);
        }
        if stop {
            return;
        }
    }
}

fn lock(queue: &Mutex<PaintQueue>) -> MutexGuard<'_, PaintQueue> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

fn print_line(screen: Option<&Screen>, line: &str) {
    match screen {
        // An error is ignored, because there is no other place to report it.
        Some(screen) => drop(screen.all.println(line)),
        None => terminal::write_line(line, terminal::NO_TIMEOUT),
    }
}

fn draw_frame(screen: Option<&Screen>, frame: &Frame) {
    let Some(Screen { lines, bar, .. }) = screen else { return };
    for (line, text) in lines.iter().zip(&frame.lines) {
        line.set_message(text.clone());
    }
    if let Some((bar, (ticks, text))) = bar.as_ref().zip(frame.progress.as_ref()) {
        bar.set_position(*ticks);
        bar.set_message(text.clone());
    }
}

/// Live lines of a terminal.
struct Screen {
    all: MultiProgress,
    lines: Vec<ProgressBar>,
    bar: Option<ProgressBar>,
}

impl Screen {
    fn new(lines: usize, ticks: Option<u64>) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(MAX_FRAMES_HZ));
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
    fn blocked_terminal_keeps_bounded_lines_and_newest_frame() {
        let queue = Arc::new((Mutex::default(), Condvar::new()));
        let (unblock, unblocked) = mpsc::channel::<()>();
        let (shared, (written, output)) = (queue.clone(), mpsc::channel::<String>());
        let thread = thread::spawn(move || {
            let show = |line: &str| {
                written.send(line.into()).unwrap();
                // The terminal blocks after the first line.
                let _ = unblocked.recv();
            };
            let written = written.clone();
            paint(&shared, show, |frame| written.send(frame.lines.concat()).unwrap());
        });
        let painter = Painter { queue, thread, is_terminal: false };
        painter.print_line("first".into());
        assert_eq!(output.recv().unwrap(), "first");
        for one in 0..MAX_LINES + 7 {
            painter.print_line(format!("line {one}"));
            painter.show_frame(Frame { lines: vec![format!("frame {one}")], progress: None });
        }
        drop(unblock);
        painter.finish();
        let rest: Vec<_> = output.iter().collect();
        assert_eq!(rest.len(), MAX_LINES + 2);
        assert_eq!(rest[MAX_LINES - 1], format!("line {}", MAX_LINES - 1));
        assert!(rest[MAX_LINES].starts_with("7 more lines"), "{}", rest[MAX_LINES]);
        assert_eq!(rest[MAX_LINES + 1], format!("frame {}", MAX_LINES + 6));
    }
}
