//! The schemas for whoever has no copy of the files.

use prost::Message as _;
use prost_types::{FileDescriptorProto, FileDescriptorSet};

/// A serialised `google.protobuf.FileDescriptorSet` with every file of `proto/plumbline/v1`.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/plumbline.v1.bin"));

/// The type of [`DESCRIPTORS`].
pub const DESCRIPTORS_NAME: &str = "google.protobuf.FileDescriptorSet";

/// The same of `proto/foxglove`, with what it imports.
const VIEWER_DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/foxglove.bin"));

/// A serialised `google.protobuf.FileDescriptorSet` with the file of a message, such as `plumbline.v1.ImuSample`, and the files that
/// it imports, before those that import them; `None` where there is no such message.
pub fn descriptors_of(message: &str) -> Option<Vec<u8>> {
    let (package, name) = message.rsplit_once('.')?;
    let files: Vec<_> = [DESCRIPTORS, VIEWER_DESCRIPTORS]
        .into_iter()
        .filter_map(|bytes| FileDescriptorSet::decode(bytes).ok())
        .flat_map(|set| set.file)
        .collect();
    let holds = |file: &&FileDescriptorProto| {
        file.package() == package && file.message_type.iter().any(|message| message.name() == name)
    };
    let mut chosen = Vec::new();
    gather(&files, files.iter().find(holds)?.name(), &mut chosen);
    Some(FileDescriptorSet { file: chosen }.encode_to_vec())
}

/// Puts a file behind all that it imports; the compiler has refused circles.
fn gather(files: &[FileDescriptorProto], name: &str, chosen: &mut Vec<FileDescriptorProto>) {
    if chosen.iter().any(|file| file.name() == name) {
        return;
    }
    let Some(file) = files.iter().find(|file| file.name() == name) else { return };
    file.dependency.iter().for_each(|import| gather(files, import, chosen));
    chosen.push(file.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(message: &str) -> Option<Vec<String>> {
        let set = FileDescriptorSet::decode(&*descriptors_of(message)?).unwrap();
        Some(set.file.iter().map(|file| file.name().to_owned()).collect())
    }

    #[test]
    fn a_message_brings_its_imports_and_nothing_else() {
        let imu = names("plumbline.v1.ImuSample").unwrap();
        assert_eq!(imu, ["plumbline/v1/common.proto", "plumbline/v1/sensing.proto"]);
        let frame = names("foxglove.FrameTransform").unwrap();
        assert_eq!(frame.last().map(String::as_str), Some("foxglove/FrameTransform.proto"));
        assert!(frame.contains(&"google/protobuf/timestamp.proto".to_owned()), "{frame:?}");
        assert_eq!(names("plumbline.v1.Nothing"), None);
    }
}
