//! Descriptors of the schemas, for clients without the `.proto` files.

use prost::Message as _;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

/// Serialised `google.protobuf.FileDescriptorSet` of the files in `proto/plumbline/v1`.
pub const DESCRIPTORS: &[u8] = include_bytes!("generated/plumbline.v1.bin");

/// Message type of [`DESCRIPTORS`].
pub const DESCRIPTORS_TYPE: &str = "google.protobuf.FileDescriptorSet";

/// Descriptor set of the files in `proto/foxglove` and their imports.
const VIEWER_DESCRIPTORS: &[u8] = include_bytes!("generated/foxglove.bin");

/// Returns a serialised `google.protobuf.FileDescriptorSet` for a message such as
/// `plumbline.v1.ImuSample`.
///
/// The set contains the file that defines the message, preceded by the files it imports. Returns
/// `None` if the message is unknown.
pub fn descriptors_for(message: &str) -> Option<Vec<u8>> {
    let (package, name) = message.rsplit_once('.')?;
    let files: Vec<_> = [DESCRIPTORS, VIEWER_DESCRIPTORS]
        .into_iter()
        .filter_map(|bytes| FileDescriptorSet::decode(bytes).ok())
        .flat_map(|set| set.file)
        .collect();
    let contains = |file: &&FileDescriptorProto| {
        file.package() == package && file.message_type.iter().any(|message| message.name() == name)
    };
    let mut chosen = Vec::new();
    add_with_imports(&files, files.iter().find(contains)?.name(), &mut chosen);
    Some(FileDescriptorSet { file: chosen }.encode_to_vec())
}

/// Field of a message, for schema-driven readers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SchemaField {
    /// Name of the message without its package. Nested messages are qualified by the outer ones.
    pub message: String,
    /// Field number.
    pub number: i32,
    /// Field name.
    pub name: String,
    /// Type: a scalar as named by protobuf, or the name of a message or an enum.
    pub kind: String,
    /// `true` if the field is repeated.
    pub is_repeated: bool,
    /// `true` if a missing field can be distinguished from a field with the default value.
    pub has_presence: bool,
}

/// Returns the fields and enum values of `proto/plumbline/v1`.
///
/// Each enum value is a tuple of enum name, value name and number.
pub fn fields_and_enum_values() -> (Vec<SchemaField>, Vec<(String, String, i32)>) {
    let (mut fields, mut enum_values) = (Vec::new(), Vec::new());
    for file in FileDescriptorSet::decode(DESCRIPTORS).map_or(Vec::new(), |set| set.file) {
        file.message_type.iter().for_each(|message| add_message("", message, &mut fields, &mut enum_values));
        file.enum_type.iter().for_each(|descriptor| add_enum("", descriptor, &mut enum_values));
    }
    (fields, enum_values)
}

fn add_message(
    outer: &str,
    message: &DescriptorProto,
    fields: &mut Vec<SchemaField>,
    enum_values: &mut Vec<(String, String, i32)>,
) {
    let qualified = format!("{outer}{}", message.name());
    fields.extend(message.field.iter().map(|field| SchemaField {
        message: qualified.clone(),
        number: field.number(),
        name: field.name().into(),
        kind: match field.r#type() {
            Type::Message | Type::Enum => field.type_name().trim_start_matches(".plumbline.v1.").to_owned(),
            scalar => scalar.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
        },
        is_repeated: field.label() == Label::Repeated,
        has_presence: field.proto3_optional() || field.r#type() == Type::Message,
    }));
    let inner = format!("{qualified}.");
    message.enum_type.iter().for_each(|descriptor| add_enum(&inner, descriptor, enum_values));
    message.nested_type.iter().for_each(|nested| add_message(&inner, nested, fields, enum_values));
}

fn add_enum(outer: &str, descriptor: &EnumDescriptorProto, enum_values: &mut Vec<(String, String, i32)>) {
    let entry = |value: &prost_types::EnumValueDescriptorProto| {
        (format!("{outer}{}", descriptor.name()), value.name().to_owned(), value.number())
    };
    enum_values.extend(descriptor.value.iter().map(entry));
}

/// Appends a file, preceded by its imports. The recursion ends, because the schema compiler rejects
/// cyclic imports.
fn add_with_imports(files: &[FileDescriptorProto], name: &str, chosen: &mut Vec<FileDescriptorProto>) {
    if chosen.iter().any(|file| file.name() == name) {
        return;
    }
    let Some(file) = files.iter().find(|file| file.name() == name) else { return };
    file.dependency.iter().for_each(|import| add_with_imports(files, import, chosen));
    chosen.push(file.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(message: &str) -> Option<Vec<String>> {
        let set = FileDescriptorSet::decode(&*descriptors_for(message)?).unwrap();
        Some(set.file.iter().map(|file| file.name().to_owned()).collect())
    }

    #[test]
    fn fields_have_number_type_and_presence() {
        let (fields, enum_values) = fields_and_enum_values();
        let lookup = |message: &str, name: &str| {
            let found = fields.iter().find(|field| field.message == message && field.name == name);
            let field = found.unwrap();
            (field.number, field.kind.clone(), field.is_repeated, field.has_presence)
        };
        assert_eq!(lookup("Header", "t_end_ns"), (3, "sint64".into(), false, false));
        assert_eq!(lookup("FusedState", "w"), (2, "Complex".into(), false, true));
        assert_eq!(lookup("Snapshot", "events"), (14, "SystemEvent".into(), true, true));
        assert_eq!(lookup("SwapAnswer", "outcome"), (2, "SwapAnswer.Outcome".into(), false, false));
        assert_eq!(lookup("SwapAnswer", "commit_tick"), (7, "uint64".into(), false, true));
        assert!(enum_values.contains(&("SwapAnswer.Outcome".into(), "OUTCOME_REFUSED".into(), 2)), "{enum_values:?}");
    }

    #[test]
    fn descriptor_set_contains_only_needed_imports() {
        let imu = files("plumbline.v1.ImuSample").unwrap();
        assert_eq!(imu, ["plumbline/v1/common.proto", "plumbline/v1/sensing.proto"]);
        let frame = files("foxglove.FrameTransform").unwrap();
        assert_eq!(frame.last().map(String::as_str), Some("foxglove/FrameTransform.proto"));
        assert!(frame.contains(&"google/protobuf/timestamp.proto".to_owned()), "{frame:?}");
        assert_eq!(files("plumbline.v1.Nothing"), None);
    }
}
