//! The schemas for whoever has no copy of the files.

use prost::Message as _;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

/// A serialised `google.protobuf.FileDescriptorSet` with every file of `proto/plumbline/v1`.
pub const DESCRIPTORS: &[u8] = include_bytes!("generated/plumbline.v1.bin");

/// The type of [`DESCRIPTORS`].
pub const DESCRIPTORS_NAME: &str = "google.protobuf.FileDescriptorSet";

/// The same of `proto/foxglove`, with what it imports.
const VIEWER_DESCRIPTORS: &[u8] = include_bytes!("generated/foxglove.bin");

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

/// A field of a message, for readers that are made from the schema.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldRule {
    /// The message, without its package; one that is declared within another with that one's name and a point before.
    pub message: String,
    /// Its number.
    pub number: i32,
    /// Its name.
    pub name: String,
    /// A scalar as protobuf names it, or the name of a message or an enum.
    pub kind: String,
    /// There may be many.
    pub is_repeated: bool,
    /// Whether it is there is told, also of a scalar.
    pub has_presence: bool,
}

/// Every field of `proto/plumbline/v1`, and every name of its enums: the enum, the name, the number.
pub fn rules() -> (Vec<FieldRule>, Vec<(String, String, i32)>) {
    let (mut fields, mut names) = (Vec::new(), Vec::new());
    for file in FileDescriptorSet::decode(DESCRIPTORS).map_or(Vec::new(), |set| set.file) {
        file.message_type.iter().for_each(|message| rules_of("", message, &mut fields, &mut names));
        file.enum_type.iter().for_each(|one| names_of("", one, &mut names));
    }
    (fields, names)
}

fn rules_of(
    outer: &str,
    message: &DescriptorProto,
    fields: &mut Vec<FieldRule>,
    names: &mut Vec<(String, String, i32)>,
) {
    let own = format!("{outer}{}", message.name());
    fields.extend(message.field.iter().map(|field| FieldRule {
        message: own.clone(),
        number: field.number(),
        name: field.name().into(),
        kind: match field.r#type() {
            Type::Message | Type::Enum => field.type_name().trim_start_matches(".plumbline.v1.").to_owned(),
            scalar => scalar.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
        },
        is_repeated: field.label() == Label::Repeated,
        has_presence: field.proto3_optional() || field.r#type() == Type::Message,
    }));
    let inner = format!("{own}.");
    message.enum_type.iter().for_each(|one| names_of(&inner, one, names));
    message.nested_type.iter().for_each(|nested| rules_of(&inner, nested, fields, names));
}

fn names_of(outer: &str, one: &EnumDescriptorProto, names: &mut Vec<(String, String, i32)>) {
    let of = |value: &prost_types::EnumValueDescriptorProto| {
        (format!("{outer}{}", one.name()), value.name().to_owned(), value.number())
    };
    names.extend(one.value.iter().map(of));
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
    fn the_rules_name_every_field_with_its_kind() {
        let (fields, names) = rules();
        let of = |message: &str, name: &str| {
            let found = fields.iter().find(|field| field.message == message && field.name == name);
            let field = found.unwrap();
            (field.number, field.kind.clone(), field.is_repeated, field.has_presence)
        };
        assert_eq!(of("Header", "t_end_ns"), (3, "sint64".into(), false, false));
        assert_eq!(of("FusedState", "w"), (2, "Complex".into(), false, true));
        assert_eq!(of("Picture", "events"), (14, "SystemEvent".into(), true, true));
        assert_eq!(of("SwapAnswer", "outcome"), (2, "SwapAnswer.Outcome".into(), false, false));
        assert_eq!(of("SwapAnswer", "commit_tick"), (7, "uint64".into(), false, true));
        assert!(names.contains(&("SwapAnswer.Outcome".into(), "OUTCOME_REFUSED".into(), 2)), "{names:?}");
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
