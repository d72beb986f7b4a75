//! Entry point of the `plumb` executable.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    plumbline::main()
}
