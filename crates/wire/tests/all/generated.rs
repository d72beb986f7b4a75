//! Compares `src/generated` with the code generated from the schemas in `proto`, and the schema's
//! services with the service table.
//!
//! The generated files are kept in the repository, so that a build does not have to compile a
//! schema compiler first. If a file is out of date, the test updates it and fails. If `CI` is set,
//! it fails without updating it.
use std::{
    env, fs,
    path::{Path, PathBuf},
};

use protox::prost::Message as _;

/// Protobuf packages with their files: the project's own schema and the schema of third-party
/// viewers.
const PACKAGES: [(&str, &[&str]); 2] = [
    ("plumbline/v1", &["common", "sensing", "estimate", "operation", "telemetry", "command", "cockpit"]),
    ("foxglove", &["FrameTransform", "PoseInFrame", "LocationFix"]),
];

#[test]
fn generated_files_match_schemas() {
    let crate_dir = Path::new(env!("CARGO_MANIFEST_DIR"));
    let proto = crate_dir.join("../../proto");
    let mut stale = Vec::new();
    update(&proto.join("plumbline/v1/common.proto"), with_services, &mut stale);
    let fresh = tempfile::tempdir().unwrap();
    generate(&proto, fresh.path());
    let stored = crate_dir.join("src/generated");
    for file in fs::read_dir(fresh.path()).unwrap().map(|file| file.unwrap()) {
        update(&stored.join(file.file_name()), |_| fs::read(file.path()).unwrap(), &mut stale);
    }
    assert!(
        stale.is_empty(),
        "files are out of date: {stale:?}; run `cargo test -p wire generated` without CI to update them"
    );
    let count = |folder: &Path| fs::read_dir(folder).unwrap().count();
    assert_eq!((count(&stored), count(fresh.path())), (4, 4), "types and descriptors of two packages");
}

/// Adds a file to `stale` if `generate` returns other contents for it, and updates it unless `CI`
/// is set. `generate` receives the present contents, which are empty if the file is missing.
fn update(path: &Path, generate: impl FnOnce(&[u8]) -> Vec<u8>, stale: &mut Vec<PathBuf>) {
    let old = fs::read(path).unwrap_or_default();
    let new = generate(&old);
    if old != new {
        if env::var_os("CI").is_none() {
            fs::write(path, new).unwrap();
        }
        stale.push(path.to_owned());
    }
}

/// Replaces the values of `enum Service` in a schema by the services of the service table.
fn with_services(schema: &[u8]) -> Vec<u8> {
    let schema = std::str::from_utf8(schema).unwrap();
    let (before, rest) = schema.split_once("enum Service {\n").unwrap();
    let (_, after) = rest.split_once("}\n").unwrap();
    let services: String = (1..)
        .zip(graph::Service::ALL)
        .map(|(number, service)| format!("  SERVICE_{} = {number};\n", service.name().to_uppercase()))
        .collect();
    format!("{before}enum Service {{\n  SERVICE_UNSPECIFIED = 0;\n{services}}}\n{after}").into_bytes()
}

/// Generates types and descriptors of every package.
fn generate(proto: &Path, out: &Path) {
    for (package, files) in PACKAGES {
        let schemas = files.iter().map(|file| proto.join(format!("{package}/{file}.proto")));
        let mut set = protox::compile(schemas, [proto]).unwrap();
        for file in fs::read_dir(proto.join(package)).unwrap() {
            let name = format!("{package}/{}", file.unwrap().file_name().to_str().unwrap());
            assert!(set.file.iter().any(|file| file.name() == name), "{name} is neither listed nor imported");
        }
        // Descriptors are sent to clients, which have no use for comments and source positions.
        set.file.iter_mut().for_each(|file| file.source_code_info = None);
        let name = package.replace('/', ".");
        fs::write(out.join(format!("{name}.bin")), set.encode_to_vec()).unwrap();
        // `wire::batch` encodes and decodes batches field by field, so they need no types.
        set.file.iter_mut().for_each(|file| file.message_type.retain(|message| !message.name().ends_with("Batch")));
        prost_build::Config::new().btree_map(["."]).out_dir(out).compile_fds(set).unwrap();
        let types = out.join(format!("{name}.rs"));
        fs::write(&types, without_functions(&fs::read_to_string(&types).unwrap())).unwrap();
    }
}

/// Removes the functions that convert enum values to and from their names, because nothing uses
/// them. The descriptors contain the names.
fn without_functions(code: &str) -> String {
    let (mut kept, mut end) = (String::new(), None);
    for line in code.lines() {
        let unindented = line.trim_start();
        if unindented.starts_with("impl ") {
            end = Some(format!("{}}}", &line[..line.len() - unindented.len()]));
        }
        match &end {
            None => kept += &format!("{line}\n"),
            Some(last) if last == line => end = None,
            Some(_) => {}
        }
    }
    kept
}
