//! Documentation: examples run, links resolve, and generated chapters match the program.

mod examples;
mod exceptions;
mod launch_file;
mod links;
mod markdown;
mod reference;

use std::path::Path;

/// Root of the source tree.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
