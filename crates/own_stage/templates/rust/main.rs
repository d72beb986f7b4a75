//! `@name@` as a service: a supervisor starts it, `[stages.@name@]` in the launch file names it.

use std::process::ExitCode;

use @module@::{@Class@, NAME};

fn main() -> ExitCode {
    match @slot@::run_with(|name| (name == NAME).then(@Class@::default)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
