//! Program of the stage. Plumbline starts it for `[stages.@name@]` in a launch file.

use std::process::ExitCode;

use @module@::@Class@;

fn main() -> ExitCode {
    sdk::@slot@(@Class@::default())
}
