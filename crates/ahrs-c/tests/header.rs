//! The committed header matches the source.
//!
//! If the header is stale, the test updates it and fails. If `CI` is set, it only fails.

use std::{env, fs, path::Path};

#[test]
fn header_is_current() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).unwrap();
    let mut header = Vec::new();
    cbindgen::Builder::new().with_crate(root).with_config(config).generate().unwrap().write(&mut header);
    // Comments that address Rust callers are left out of the header.
    let header = without_safety(&String::from_utf8(header).unwrap());
    let file = root.join("include/plumbline_ahrs.h");
    if fs::read_to_string(&file).ok().as_deref() != Some(&header) {
        if env::var_os("CI").is_none() {
            fs::write(&file, header).unwrap();
        }
        panic!("{} was not current; run `cargo test --release -p plumbline-ahrs-c`", file.display());
    }
}

/// Removes the `# Safety` sections. A section extends to the end of its comment.
fn without_safety(header: &str) -> String {
    let (mut kept, mut is_safety) = (Vec::new(), false);
    for line in header.lines() {
        is_safety |= line == " # Safety";
        if is_safety && line == " */" {
            is_safety = false;
            // The empty line before the section is removed, too.
            if kept.last() == Some(&"") {
                kept.pop();
            }
        }
        if !is_safety {
            kept.push(line);
        }
    }
    kept.join("\n") + "\n"
}
