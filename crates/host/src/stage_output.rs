//! Output of a stage program, printed so that it cannot control the terminal.
//!
//! Input: what the program writes to standard output and standard error.
//!
//! Output: the same text on the standard error of this process. Control characters are escaped, and
//! every line begins with a mark.
//!
//! Failure: if standard error is closed, the output is discarded.

use std::{
    io::{self, BufRead, BufReader, PipeReader, PipeWriter, Read, Write},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::Duration,
};

use foreign::ForeignText;

/// Maximum length of a line, bytes. A longer line is split.
const MAX_LINE_BYTES: u64 = 4096;
/// Mark of a line that a stage program has printed.
const MARK: &str = "  | ";

/// Thread that prints the output of a program.
#[derive(Debug)]
pub(crate) struct StageOutput {
    /// Channel that is disconnected once the output has ended.
    end: Receiver<()>,
}

impl StageOutput {
    /// Starts the thread and returns it with the pipe for the program.
    pub(crate) fn start() -> io::Result<(Self, PipeWriter)> {
        let (reader, writer) = io::pipe()?;
        let (sender, end) = channel();
        let forward = move || {
            forward(reader, &mut io::stderr());
            drop(sender);
        };
        thread::Builder::new().name("stage output".into()).spawn(forward)?;
        Ok((Self { end }, writer))
    }

    /// Waits until all output is printed, for at most `timeout`. A process that outlives the
    /// program can keep the output open.
    pub(crate) fn wait(&self, timeout: Duration) {
        let ended: Result<(), RecvTimeoutError> = self.end.recv_timeout(timeout);
        debug_assert!(ended.is_err(), "nothing is sent");
    }
}

/// Prints lines until the input ends.
fn forward(pipe: PipeReader, to: &mut dyn Write) {
    let mut pipe = BufReader::new(pipe);
    let mut line = Vec::new();
    // A read error means that there is no more output.
    while pipe.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let text = line.strip_suffix(b"\n").unwrap_or(&line);
        let text = text.strip_suffix(b"\r").unwrap_or(text);
        // The program must not block on a closed terminal, so reading continues after an error.
        let _ = to.write_all(format!("{MARK}{}\n", ForeignText::from_bytes(text)).as_bytes());
        line.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forwarded(input: &[u8]) -> String {
        let (reader, mut writer) = io::pipe().unwrap();
        let mut printed = Vec::new();
        thread::scope(|scope| {
            scope.spawn(|| {
                writer.write_all(input).unwrap();
                drop(writer);
            });
            forward(reader, &mut printed);
        });
        String::from_utf8(printed).unwrap()
    }

    #[test]
    fn output_of_program_is_escaped_and_marked() {
        let text = forwarded(b"plain\r\n\x1b]0;owned\x07\x1b[2J\nFAKE: all is well\r\x1b[1Aforged\n\xff");
        let expected =
            "  | plain\n  | \\u{1b}]0;owned\\u{7}\\u{1b}[2J\n  | FAKE: all is well\\r\\u{1b}[1Aforged\n  | \u{fffd}\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn line_without_end_is_printed_in_parts() {
        let text = forwarded(&[b'x'; 10_000]);
        assert_eq!(text.lines().map(str::len).collect::<Vec<_>>(), [4100, 4100, 1812]);
    }
}
