//! Passes the commit, the build profile and the features to the program, for `plumb --version`.

use std::{env, path::Path, process::Command};

fn main() {
    println!("cargo::rerun-if-env-changed=PLUMB_COMMIT");
    // Git appends to this file on every commit and checkout.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo::rerun-if-changed={log}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    // A source archive has no repository, so its packager sets `PLUMB_COMMIT`.
    let commit = env::var("PLUMB_COMMIT").ok().or_else(|| git(&["rev-parse", "--short=12", "HEAD"]));
    println!("cargo::rustc-env=PLUMB_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
    // The output folder is target/PROFILE/build/PACKAGE/out, possibly with a target triple.
    let out_dir = env::var("OUT_DIR").unwrap_or_default();
    let profile = Path::new(&out_dir).ancestors().nth(3).and_then(Path::file_name);
    let profile = profile.map_or("unknown".into(), |name| name.to_string_lossy());
    println!("cargo::rustc-env=PLUMB_PROFILE={profile}");
    let features = ["cockpit", "foxglove", "network", "tui"];
    let is_set = |name: &&str| env::var_os(format!("CARGO_FEATURE_{}", name.to_uppercase())).is_some();
    let features: Vec<_> = features.into_iter().filter(is_set).collect();
    let features = if features.is_empty() { "none".into() } else { features.join(" ") };
    println!("cargo::rustc-env=PLUMB_FEATURES={features}");
}

/// Returns the output of a Git command, or `None` without Git or outside a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}
