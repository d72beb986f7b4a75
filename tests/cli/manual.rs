//! Version, shell completions and manual pages.

use std::fs;

use crate::common::plumb;

fn stdout(arguments: &[&str]) -> String {
    let output = plumb(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn version_names_commit_profile_and_features() {
    let short = stdout(&["-V"]);
    assert_eq!(short, format!("plumb {}\n", env!("CARGO_PKG_VERSION")));
    let long = stdout(&["--version"]);
    let value = |key: &str| {
        let line = long.lines().find_map(|line| line.strip_prefix(key));
        line.unwrap_or_else(|| panic!("no {key} in {long}")).trim().to_owned()
    };
    let commit = value("commit:");
    assert!(commit == "unknown" || commit.chars().all(|c| c.is_ascii_hexdigit()), "{long}");
    assert_eq!(value("features:"), "cockpit foxglove network tui");
    assert!(!value("profile:").is_empty());
}

#[test]
fn completions_know_the_commands_in_every_shell() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = stdout(&["completions", shell]);
        for word in ["shadow", "rate-hz", "doctor"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
}

#[test]
fn manual_has_a_page_for_each_command() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    stdout(&["man", pages.to_str().unwrap()]);
    for (page, word) in [("plumb.1", "SUBCOMMANDS"), ("plumb-up.1", "replay"), ("plumb-topic-echo.1", "EVERY")] {
        let text = fs::read_to_string(pages.join(page)).unwrap_or_else(|error| panic!("{page}: {error}"));
        assert!(text.to_uppercase().contains(&word.to_uppercase()), "{page}: {text}");
    }
    assert!(!pages.join("plumb-service.1").exists(), "the command is hidden");
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let output = plumb(&["man", file.to_str().unwrap()]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write manual pages"));
}
