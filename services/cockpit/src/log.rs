//! Log of the running system, for operators.
//!
//! Input: the file to which the supervisor of the system writes its messages and those of the
//! services, as with `plumb up --detach`.
//! Output: the last lines, with control characters escaped and without tokens.
//! Failure: if the messages go elsewhere, the error names the destination.

use std::{
    fs::{self, File},
    io::{self, Read as _, Seek as _, SeekFrom},
    os::unix::fs::FileTypeExt as _,
};

use foreign::ForeignText;

use crate::token::{Role, Tokens};

/// Maximum number of bytes read, from the end of the file.
const MAX_BYTES: u64 = 64 << 10;
/// Maximum number of lines.
const MAX_LINES: usize = 200;
/// Text that replaces a token.
const HIDDEN: &str = "(token)";

/// Error when reading the log.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LogError {
    /// The messages do not go to a file.
    #[error("the messages of this system go to {target}; only `plumb up --detach` writes a log")]
    NoFile { target: &'static str },
    /// The file cannot be read.
    #[error("cannot read the log of the system: {0}")]
    Read(#[from] io::Error),
}

/// Returns the last lines that the supervisor and the services have written, oldest first.
///
/// # Errors
///
/// Returns an error if the messages do not go to a file, or the file cannot be read.
pub(crate) fn last_lines(supervisor_pid: u32) -> Result<Vec<String>, LogError> {
    let path = format!("/proc/{supervisor_pid}/fd/2");
    let kind = fs::metadata(&path)?.file_type();
    if !kind.is_file() {
        let target = match kind {
            _ if kind.is_char_device() => "a terminal",
            _ if kind.is_socket() => "the system journal: run `journalctl -u plumbline`",
            _ => "another program",
        };
        return Err(LogError::NoFile { target });
    }
    let mut file = File::open(&path)?;
    let start = file.metadata()?.len().saturating_sub(MAX_BYTES);
    file.seek(SeekFrom::Start(start))?;
    let mut bytes = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut bytes)?;
    // The first line may be incomplete.
    let from = if start > 0 { bytes.iter().position(|byte| *byte == b'\n').map_or(0, |at| at + 1) } else { 0 };
    let lines: Vec<_> = bytes[from..].split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).collect();
    let last = &lines[lines.len().saturating_sub(MAX_LINES)..];
    Ok(last.iter().map(|line| ForeignText::from_bytes(line).to_string()).collect())
}

/// Replaces the tokens in a line.
pub(crate) fn without_tokens(line: &str, tokens: &Tokens) -> String {
    let roles = [Role::Operator, Role::Viewer];
    roles.iter().fold(line.to_owned(), |line, role| line.replace(tokens.get(*role).text(), HIDDEN))
}

#[cfg(test)]
mod tests {
    use std::{
        fmt::Write as _,
        process::{Child, Command, Stdio},
    };

    use super::*;

    /// Starts a process with this standard error.
    fn start(stderr: impl Into<Stdio>) -> Child {
        Command::new("sleep").arg("60").stderr(stderr).spawn().unwrap()
    }

    #[test]
    fn last_lines_are_bounded_and_escaped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut text = String::new();
        (0..20_000).for_each(|number| writeln!(text, "line {number}").unwrap());
        fs::write(&path, text + "\x1b[2Jforged\r\n\nlast").unwrap();
        let mut child = start(File::options().append(true).open(&path).unwrap());
        let lines = last_lines(child.id()).unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!((lines.len(), &*lines[0]), (MAX_LINES, "line 19802"));
        assert_eq!(lines[MAX_LINES - 2..], [r"\u{1b}[2Jforged\r", "last"]);
    }

    #[test]
    fn missing_log_is_reported_with_its_place() {
        let mut child = start(Stdio::piped());
        let error = last_lines(child.id()).unwrap_err().to_string();
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(error.contains("another program") && error.contains("plumb up --detach"), "{error}");
    }

    #[test]
    fn tokens_are_hidden() {
        let tokens = Tokens::create().unwrap();
        let [operator, viewer] = [Role::Operator, Role::Viewer].map(|role| tokens.get(role).text().to_owned());
        let line = format!("cockpit: http://127.0.0.1:8088/#{operator} {viewer}");
        assert_eq!(without_tokens(&line, &tokens), "cockpit: http://127.0.0.1:8088/#(token) (token)");
    }
}
