//! Program of the stage, which Plumbline starts for `[stages.@name@]` of a launch file.

use std::process::ExitCode;

use @module@::@Class@;

fn main() -> ExitCode {
    sdk::@slot@(@Class@::default())
}
