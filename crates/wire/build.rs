//! Compiles the schema without `protoc`: the types, and the descriptors that go to whoever asks for them.

use std::{env, error::Error, fs, path::PathBuf};

use protox::prost::Message as _;

const FILES: [&str; 6] = ["common", "sensing", "estimate", "operation", "telemetry", "command"];

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../../proto");
    println!("cargo::rerun-if-changed={}", root.display());
    let files = FILES.map(|file| root.join(format!("plumbline/v1/{file}.proto")));
    let mut set = protox::compile(files, [&root])?;
    prost_build::Config::new().disable_comments(["."]).btree_map(["."]).compile_fds(set.clone())?;
    // Comments are in the files; on the wire they only cost.
    set.file.iter_mut().for_each(|file| file.source_code_info = None);
    fs::write(PathBuf::from(env::var("OUT_DIR")?).join("schema.bin"), set.encode_to_vec())?;
    Ok(())
}
