//! A benchmark as a program: it measures, or is one process of what is measured.

use std::process::ExitCode;

use serde::de::DeserializeOwned;

use crate::Failure;

/// Is the part that is given as JSON, or measures; people read what went wrong.
pub(crate) fn run<P: DeserializeOwned>(
    part: Option<&str>,
    be: impl FnOnce(&P) -> Result<(), Failure>,
    measure: impl FnOnce() -> Result<(), Failure>,
) -> ExitCode {
    let ended = match part {
        Some(part) => serde_json::from_str(part).map_err(Failure::from).and_then(|part| be(&part)),
        None => measure(),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
