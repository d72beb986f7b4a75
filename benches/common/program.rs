//! Entry point of a benchmark that starts copies of itself and measures them.

use std::process::ExitCode;

use serde::de::DeserializeOwned;

use crate::Failure;

/// Runs one measured process if `settings` (JSON) is given, otherwise runs the whole benchmark.
///
/// An error is printed to standard error.
pub(crate) fn run<P: DeserializeOwned>(
    settings: Option<&str>,
    run_process: impl FnOnce(&P) -> Result<(), Failure>,
    measure: impl FnOnce() -> Result<(), Failure>,
) -> ExitCode {
    let result = match settings {
        Some(settings) => {
            serde_json::from_str(settings).map_err(Failure::from).and_then(|settings| run_process(&settings))
        }
        None => measure(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
