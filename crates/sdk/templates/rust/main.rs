//! `@name@` as a program: Plumbline starts it where a launch file has `[stages.@name@]`.

use std::process::ExitCode;

use @module@::@Class@;

fn main() -> ExitCode {
    sdk::@slot@(@Class@::default())
}
