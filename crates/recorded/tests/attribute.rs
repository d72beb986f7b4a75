//! Tests that a function marked with `recorded::test` runs only if the recordings exist.
use std::{env, path::PathBuf};

#[recorded::test]
fn marked_test_runs_only_with_recordings() {
    let folder = env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    assert!(folder.is_dir(), "no recordings in {}", folder.display());
}
