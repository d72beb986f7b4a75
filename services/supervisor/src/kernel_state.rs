//! State of a process as reported by the kernel. It explains why the process does not respond.
//!
//! - Input: the entry in `/proc` of a process that this user owns.
//! - Output: a short text with a part for each thread: name, state letter and the kernel function
//!   in which the thread waits.
//! - Failure: a thread or value that cannot be read is left out.

use std::{fs, path::Path};

/// Maximum number of threads described.
const MAX_THREADS: usize = 8;
/// Maximum length of the text, in characters.
const MAX_CHARACTERS: usize = 160;

/// Describes the threads of a process, such as `fuser T in do_signal_stop`.
pub(crate) fn describe(pid: u32) -> String {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let mut paths: Vec<_> = tasks.take(MAX_THREADS).map(|task| task.path()).collect();
    paths.sort();
    let threads: Vec<_> = paths.iter().filter_map(|path| describe_thread(path)).collect();
    threads.join(", ").chars().take(MAX_CHARACTERS).collect()
}

fn describe_thread(task: &Path) -> Option<String> {
    let stat = fs::read_to_string(task.join("stat")).ok()?;
    // The name is in parentheses and may itself contain parentheses. The state letter follows.
    let (name, rest) = stat.split_once('(')?.1.rsplit_once(')')?;
    let state = rest.trim_start().chars().next()?;
    // A running thread, or a kernel that hides the function, yields "0".
    let function = fs::read_to_string(task.join("wchan")).unwrap_or_default();
    let function: String = function.chars().filter(char::is_ascii_graphic).collect();
    let place = if matches!(&*function, "" | "0") { String::new() } else { format!(" in {function}") };
    Some(format!("{} {state}{place}", foreign::ForeignText::from(name)))
}
