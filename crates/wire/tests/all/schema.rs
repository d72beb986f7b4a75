//! The schema covers all layouts and stays compatible with released versions.
use std::collections::BTreeMap;

use crate::common::{RandomMessage, TestRng, for_every_message};
use messages::Layout;
use prost::Message as _;
use prost_types::{DescriptorProto, FileDescriptorSet, field_descriptor_proto::Type};

fn descriptors() -> BTreeMap<String, DescriptorProto> {
    let set = FileDescriptorSet::decode(wire::schema::DESCRIPTORS).unwrap();
    let messages = set.file.into_iter().flat_map(|file| file.message_type);
    messages.map(|message| (message.name().to_owned(), message)).collect()
}

fn names(message: &DescriptorProto) -> Vec<String> {
    message.field.iter().map(|field| field.name().to_owned()).collect()
}

fn name_and_layout<M: RandomMessage>() -> (&'static str, Layout) {
    (M::NAME, M::layout())
}

#[test]
fn every_layout_field_is_in_schema() {
    let descriptors = descriptors();
    let header = names(&descriptors["Header"]);
    for (name, layout) in for_every_message!(name_and_layout()) {
        let own = names(&descriptors[name]);
        let has_header = own.iter().any(|field| field == "header");
        for field in layout.fields.iter().filter(|field| field.name != "reserved") {
            let is_present = own.iter().any(|own| own == field.name)
                || (has_header && header.iter().any(|header| header == field.name));
            assert!(is_present, "message {name} lacks the field {}", field.name);
        }
        let fields = own.len() + if has_header { header.len() - 1 } else { 0 };
        let reserved = layout.fields.iter().filter(|field| field.name == "reserved").count();
        assert_eq!(fields, layout.fields.len() - reserved, "message {name} has a field that its layout lacks");
    }
}

#[test]
fn every_topic_has_message_and_batch() {
    let descriptors = descriptors();
    let all = for_every_message!(name_and_layout());
    assert_eq!(all.len(), graph::Topic::ALL.len());
    for (name, _) in all {
        let batch = &descriptors[&format!("{name}Batch")];
        let fields: Vec<_> = batch.field.iter().map(|field| (field.number(), field.type_name())).collect();
        assert_eq!(fields, [(1, ".plumbline.v1.Envelope"), (2, format!(".plumbline.v1.{name}").as_str())]);
    }
}

/// Lists the released schema: each field as `Message.field number label type` and each enum value
/// as `Enum.NAME number`.
fn released() -> Vec<String> {
    let set = FileDescriptorSet::decode(wire::schema::DESCRIPTORS).unwrap();
    let mut lines = Vec::new();
    for file in &set.file {
        file.message_type.iter().for_each(|message| add_message("", message, &mut lines));
        for kind in &file.enum_type {
            lines.extend(kind.value.iter().map(|value| format!("{}.{} {}", kind.name(), value.name(), value.number())));
        }
    }
    lines
}

fn add_message(outer: &str, message: &DescriptorProto, lines: &mut Vec<String>) {
    let name = format!("{outer}{}", message.name());
    for field in &message.field {
        let kind = match field.r#type() {
            Type::Message | Type::Enum => field.type_name().trim_start_matches(".plumbline.v1.").to_owned(),
            other => other.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
        };
        let label = field.label().as_str_name().trim_start_matches("LABEL_").to_lowercase();
        lines.push(format!("{name}.{} {} {label} {kind}", field.name(), field.number()));
    }
    for kind in &message.enum_type {
        let value = |value: &prost_types::EnumValueDescriptorProto| {
            format!("{name}.{}.{} {}", kind.name(), value.name(), value.number())
        };
        lines.extend(kind.value.iter().map(value));
    }
    message.nested_type.iter().for_each(|nested| add_message(&format!("{name}."), nested, lines));
}

#[test]
fn released_fields_are_unchanged() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/released.txt");
    let (now, golden) = (released(), std::fs::read_to_string(path).unwrap());
    let missing: Vec<_> = golden.lines().filter(|line| !now.iter().any(|now| now == line)).collect();
    assert!(
        missing.is_empty(),
        "released fields are missing; give new fields new numbers, or remove lines not committed yet: {missing:#?}"
    );
    let is_new = |line: &&String| !golden.lines().any(|old| old == *line);
    let added: String = now.iter().filter(is_new).map(|line| format!("{line}\n")).collect();
    if !added.is_empty() && std::env::var_os("CI").is_none() {
        std::fs::write(path, golden + &added).unwrap();
    }
    assert_eq!(added, "", "{path} lacks these fields; run the test without CI to add them");
}

#[test]
fn encoded_bytes_match_golden_file() {
    fn line<M: RandomMessage>() -> String {
        let bytes = M::random(&mut TestRng::new(7)).to_bytes();
        let hex: String = bytes.iter().take(400).map(|byte| format!("{byte:02x}")).collect();
        format!("{} {} {hex}\n", M::NAME, bytes.len())
    }
    let now: String = for_every_message!(line()).concat();
    let golden = include_str!("../../golden/messages.txt");
    assert_eq!(now, golden, "the encoding has changed, so that earlier versions cannot decode it");
}
