//! Tests that the viewer layouts in `deploy` name existing channels and fields.

use std::{collections::BTreeSet, fs, path::Path};

use graph::Topic;
use prost_types::{DescriptorProto, FileDescriptorSet};
use wire::{
    channel::{Channel, channels},
    schema,
};

/// Message types of all schemas, with their full names.
struct Schemas(Vec<(String, DescriptorProto)>);

impl Schemas {
    fn all() -> Self {
        let sets = channels(Topic::ALL).into_iter().map(|channel| schema::descriptors_for(&channel.schema).unwrap());
        let files = sets.flat_map(|set| <FileDescriptorSet as prost::Message>::decode(&*set).unwrap().file);
        let messages = files.flat_map(|file| {
            let package = file.package().to_owned();
            file.message_type.into_iter().map(move |message| (format!(".{package}.{}", message.name()), message))
        });
        Self(messages.collect())
    }

    /// Returns `true` if the topic exists and the path is empty or leads from the topic's message
    /// to a scalar field.
    fn has(&self, topic: &str, path: &[&str]) -> bool {
        let found = channels(Topic::ALL).into_iter().find(|channel| channel.name == topic);
        let Some(Channel { schema, .. }) = found else { return false };
        let mut current = Some(format!(".{schema}"));
        for name in path {
            let message = current.and_then(|current| self.0.iter().find(|(full, _)| *full == current));
            let field = message.and_then(|(_, message)| message.field.iter().find(|field| field.name() == *name));
            let Some(field) = field else { return false };
            current = field.type_name.clone().filter(|full| self.0.iter().any(|(name, _)| name == full));
        }
        current.is_none() || path.is_empty()
    }

    fn assert_has(&self, path: &str, separator: char) {
        // A filter in braces selects messages by the value of one of their fields.
        let (topic, filter, rest) = match path.split_once('{') {
            Some((topic, rest)) => {
                let (filter, rest) = rest.split_once('}').unwrap();
                (topic, filter.split_once("==").map(|(field, _)| field), rest.trim_start_matches(separator))
            }
            None => {
                let end = path[1..].find(separator).map_or(path.len(), |offset| offset + 1);
                (&path[..end], None, path[end..].trim_start_matches(separator))
            }
        };
        let fields: Vec<_> = rest.split(separator).filter(|field| !field.is_empty()).collect();
        assert!(self.has(topic, &fields), "no {path}");
        assert!(filter.is_none_or(|field| self.has(topic, &[field])), "no {filter:?} of {path}");
    }
}

fn read_layout(file: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy").join(file)).unwrap()
}

#[test]
fn foxglove_layout_names_existing_channels_and_fields() {
    let layout: serde_json::Value = serde_json::from_str(&read_layout("foxglove/layout.json")).unwrap();
    let (schemas, mut paths) = (Schemas::all(), 0);
    let panels = layout["configById"].as_object().unwrap();
    for panel in panels.values() {
        for path in panel["paths"].as_array().into_iter().flatten() {
            schemas.assert_has(path["value"].as_str().unwrap(), '.');
            paths += 1;
        }
        for topic in panel["topics"].as_object().into_iter().flat_map(|topics| topics.keys()) {
            schemas.assert_has(topic, '.');
        }
    }
    assert!(paths > 10, "{paths} paths");
    // Every panel has a position in the layout, and every position has a panel.
    let layout_text = layout["layout"].to_string();
    let places: BTreeSet<_> = layout_text.split('"').filter(|word| word.contains('!')).collect();
    assert_eq!(places, panels.keys().map(String::as_str).collect());
}

#[test]
fn plotjuggler_layout_names_existing_channels_and_fields() {
    let text = read_layout("plotjuggler/layout.xml");
    let layout = roxmltree::Document::parse(&text).unwrap();
    let (schemas, mut curves) = (Schemas::all(), 0);
    let elements = |tag: &'static str| layout.descendants().filter(move |node| node.has_tag_name(tag));
    let snippets: Vec<_> = elements("snippet").filter_map(|node| node.attribute("name")).collect();
    for curve in elements("curve").map(|node| node.attribute("name").unwrap()) {
        if !snippets.contains(&curve) {
            schemas.assert_has(curve, '/');
        }
        curves += 1;
    }
    for source in elements("linked_source").chain(elements("v1")) {
        schemas.assert_has(source.text().unwrap(), '/');
    }
    assert!(curves > 10 && snippets == ["latency_ms"], "{curves} curves, {snippets:?}");
}

#[test]
fn missing_paths_are_detected() {
    let schemas = Schemas::all();
    assert!(schemas.has("/fused", &["w", "re"]) && !schemas.has("/fused", &["w", "x"]));
    assert!(!schemas.has("/fused", &["w"]), "no number");
    assert!(!schemas.has("/nothing", &[]) && schemas.has("/pose", &[]));
}
