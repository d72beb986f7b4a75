//! `src/generated` is what the schemas in `proto` make. It is kept there so that no build compiles a compiler of schemas first.
//!
//! Where a schema has changed the test writes the files anew and fails; where `CI` is set it only fails.
use std::{env, fs, path::Path};

use protox::prost::Message as _;

/// Ours, and those that viewers know: each package with its files.
const PACKAGES: [(&str, &[&str]); 2] = [
    ("plumbline/v1", &["common", "sensing", "estimate", "operation", "telemetry", "command", "cockpit"]),
    ("foxglove", &["FrameTransform", "PoseInFrame", "LocationFix"]),
];

#[test]
fn the_types_and_the_descriptors_are_those_of_the_schemas() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let made = tempfile::tempdir().unwrap();
    make(&here.join("../../proto"), made.path());
    let kept = here.join("src/generated");
    let mut stale = Vec::new();
    for file in fs::read_dir(made.path()).unwrap().map(|file| file.unwrap()) {
        let (new, old) = (fs::read(file.path()).unwrap(), kept.join(file.file_name()));
        if fs::read(&old).ok().as_ref() != Some(&new) {
            if env::var_os("CI").is_none() {
                fs::write(&old, new).unwrap();
            }
            stale.push(old);
        }
    }
    assert!(
        stale.is_empty(),
        "not what the schemas make: {stale:?}; `cargo test -p wire generated` without CI writes them"
    );
    let count = |folder: &Path| fs::read_dir(folder).unwrap().count();
    assert_eq!((count(&kept), count(made.path())), (4, 4), "types and descriptors of two packages");
}

/// The types, and the descriptors that go to whoever asks for them, of every package.
fn make(proto: &Path, out: &Path) {
    for (package, files) in PACKAGES {
        let schemas = files.iter().map(|file| proto.join(format!("{package}/{file}.proto")));
        let mut set = protox::compile(schemas, [proto]).unwrap();
        for file in fs::read_dir(proto.join(package)).unwrap() {
            let name = format!("{package}/{}", file.unwrap().file_name().to_str().unwrap());
            assert!(set.file.iter().any(|file| file.name() == name), "{name} is neither named nor imported");
        }
        let mut config = prost_build::Config::new();
        config.disable_comments(["."]).btree_map(["."]).out_dir(out).compile_fds(set.clone()).unwrap();
        // Comments are in the files; on the wire they only cost.
        set.file.iter_mut().for_each(|file| file.source_code_info = None);
        fs::write(out.join(format!("{}.bin", package.replace('/', "."))), set.encode_to_vec()).unwrap();
    }
}
