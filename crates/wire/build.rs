//! Compiles the schemas without `protoc`: the types, and the descriptors that go to whoever asks for them.

use std::{env, error::Error, fs, path::PathBuf};

use protox::prost::Message as _;

/// Ours, and those that viewers know: each package with its files.
const PACKAGES: [(&str, &[&str]); 2] = [
    ("plumbline/v1", &["common", "sensing", "estimate", "operation", "telemetry", "command", "cockpit"]),
    ("foxglove", &["FrameTransform", "PoseInFrame", "LocationFix"]),
];

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../../proto");
    println!("cargo::rerun-if-changed={}", root.display());
    let out = PathBuf::from(env::var("OUT_DIR")?);
    for (package, files) in PACKAGES {
        let files = files.iter().map(|file| root.join(format!("{package}/{file}.proto")));
        let mut set = protox::compile(files, [&root])?;
        prost_build::Config::new().disable_comments(["."]).btree_map(["."]).compile_fds(set.clone())?;
        // Comments are in the files; on the wire they only cost.
        set.file.iter_mut().for_each(|file| file.source_code_info = None);
        fs::write(out.join(format!("{}.bin", package.replace('/', "."))), set.encode_to_vec())?;
    }
    Ok(())
}
