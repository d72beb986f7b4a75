//! The schema says all that the layouts say, and says what it has said before.
use std::collections::BTreeMap;

use crate::common::{Dice, Drawn, for_every_message};
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

fn described<M: Drawn>() -> (&'static str, Layout) {
    (M::NAME, M::layout())
}

#[test]
fn every_field_of_every_layout_has_a_field_of_its_name_and_unit() {
    let descriptors = descriptors();
    let header = names(&descriptors["Header"]);
    for (name, layout) in for_every_message!(described()) {
        let own = names(&descriptors[name]);
        let has_header = own.iter().any(|field| field == "header");
        for field in layout.fields.iter().filter(|field| field.name != "reserved") {
            let there = own.iter().any(|own| own == field.name)
                || (has_header && header.iter().any(|header| header == field.name));
            assert!(there, "{name} of the schema lacks {}", field.name);
        }
        let fields = own.len() + if has_header { header.len() - 1 } else { 0 };
        let reserved = layout.fields.iter().filter(|field| field.name == "reserved").count();
        assert_eq!(fields, layout.fields.len() - reserved, "{name} of the schema has a field that no layout has");
    }
}

#[test]
fn every_topic_has_a_message_and_every_message_a_batch() {
    let descriptors = descriptors();
    let all = for_every_message!(described());
    assert_eq!(all.len(), graph::Topic::ALL.len());
    for (name, _) in all {
        let batch = &descriptors[&format!("{name}Batch")];
        let fields: Vec<_> = batch.field.iter().map(|field| (field.number(), field.type_name())).collect();
        assert_eq!(fields, [(1, ".plumbline.v1.Envelope"), (2, format!(".plumbline.v1.{name}").as_str())]);
    }
}

/// `Message.field number type` of each field, and `Enum.NAME number` of each value.
fn released() -> Vec<String> {
    let set = FileDescriptorSet::decode(wire::schema::DESCRIPTORS).unwrap();
    let mut lines = Vec::new();
    for file in &set.file {
        file.message_type.iter().for_each(|message| of_message("", message, &mut lines));
        for kind in &file.enum_type {
            lines.extend(kind.value.iter().map(|value| format!("{}.{} {}", kind.name(), value.name(), value.number())));
        }
    }
    lines
}

fn of_message(outer: &str, message: &DescriptorProto, lines: &mut Vec<String>) {
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
    message.nested_type.iter().for_each(|nested| of_message(&format!("{name}."), nested, lines));
}

#[test]
fn no_released_field_has_changed_its_name_number_or_type() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/released.txt");
    let (now, golden) = (released(), std::fs::read_to_string(path).unwrap());
    let gone: Vec<_> = golden.lines().filter(|line| !now.iter().any(|now| now == line)).collect();
    assert!(gone.is_empty(), "released, and no longer so; give the new field a new number instead: {gone:#?}");
    let added: Vec<_> = now.iter().filter(|line| !golden.lines().any(|old| old == *line)).collect();
    assert!(added.is_empty(), "not yet released; add to {path}: {added:#?}");
}

#[test]
fn the_bytes_are_those_of_the_golden_file() {
    fn line<M: Drawn>() -> String {
        let bytes = M::drawn(&mut Dice::new(7)).encoded();
        let hex: String = bytes.iter().take(400).map(|byte| format!("{byte:02x}")).collect();
        format!("{} {} {hex}\n", M::NAME, bytes.len())
    }
    let now: String = for_every_message!(line()).concat();
    let golden = include_str!("../../golden/messages.txt");
    assert_eq!(now, golden, "what is written has changed: whoever reads it has not");
}
