//! Attribute for tests that read recordings.
//!
//! Input: the folder in the environment variable `PLUMBLINE_DATA`, else `../shared/data` relative
//! to the workspace, when the test is compiled.
//!
//! Output: a test. If the folder is missing, `cargo test` ignores and counts the test, and prints
//! the reason.
#![forbid(unsafe_code)]

use std::{
    env,
    path::{Path, PathBuf},
};

use proc_macro::TokenStream;

/// Reason that `cargo test` prints for an ignored test.
const REASON: &str = "needs recordings; see Suites in CONTRIBUTING.md";
/// Number of parent folders of a package that are searched for the recordings. The third folder
/// above `crates/NAME` is the one that contains the workspace.
const MAX_LEVELS: usize = 3;

/// Marks a function as a test that needs recordings. If they are missing, the test is ignored.
#[proc_macro_attribute]
pub fn test(arguments: TokenStream, function: TokenStream) -> TokenStream {
    let attributes: String = if !arguments.is_empty() {
        "::core::compile_error!(\"recorded::test has no arguments\");".into()
    } else if has_recordings() {
        "#[::core::prelude::v1::test]".into()
    } else {
        format!("#[::core::prelude::v1::test] #[ignore = \"{REASON}\"]")
    };
    // Because of this constant, Cargo compiles the test again if the environment variable changes.
    let tracked = "const _: ::core::option::Option<&str> = ::core::option_env!(\"PLUMBLINE_DATA\");";
    let prefix: TokenStream = format!("{tracked} {attributes}").parse().unwrap_or_default();
    prefix.into_iter().chain(function).collect()
}

fn has_recordings() -> bool {
    if let Some(folder) = env::var_os("PLUMBLINE_DATA") {
        return PathBuf::from(folder).is_dir();
    }
    let package = env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default();
    Path::new(&package).ancestors().skip(1).take(MAX_LEVELS).any(|folder| folder.join("shared/data").is_dir())
}
