//! The layouts for viewers in `deploy` name what a flight has.

use std::{collections::BTreeSet, fs, path::Path};

use graph::Topic;
use prost_types::{DescriptorProto, FileDescriptorSet};
use wire::{
    channel::{Channel, channels},
    schema,
};

/// Every message of a schema by its full name.
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

    /// The path leads from the topic's message to a number.
    fn has(&self, topic: &str, path: &[&str]) -> bool {
        let found = channels(Topic::ALL).into_iter().find(|channel| channel.name == topic);
        let Some(Channel { schema, .. }) = found else { return false };
        let mut here = Some(format!(".{schema}"));
        for name in path {
            let message = here.and_then(|here| self.0.iter().find(|(full, _)| *full == here));
            let field = message.and_then(|(_, message)| message.field.iter().find(|field| field.name() == *name));
            let Some(field) = field else { return false };
            here = field.type_name.clone().filter(|full| self.0.iter().any(|(name, _)| name == full));
        }
        here.is_none() || path.is_empty()
    }

    fn assert_has(&self, path: &str, between: char) {
        // What is in braces chooses messages by a field of theirs.
        let (topic, filter, rest) = match path.split_once('{') {
            Some((topic, rest)) => {
                let (filter, rest) = rest.split_once('}').unwrap();
                (topic, filter.split_once("==").map(|(field, _)| field), rest.trim_start_matches(between))
            }
            None => {
                let at = path[1..].find(between).map_or(path.len(), |at| at + 1);
                (&path[..at], None, path[at..].trim_start_matches(between))
            }
        };
        let fields: Vec<_> = rest.split(between).filter(|field| !field.is_empty()).collect();
        assert!(self.has(topic, &fields), "no {path}");
        assert!(filter.is_none_or(|field| self.has(topic, &[field])), "no {filter:?} of {path}");
    }
}

fn deployed(file: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy").join(file)).unwrap()
}

#[test]
fn the_layout_of_foxglove_names_channels_and_fields_that_are_there() {
    let layout: serde_json::Value = serde_json::from_str(&deployed("foxglove/layout.json")).unwrap();
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
    // Every panel has its place, and every place a panel.
    let placed = layout["layout"].to_string();
    let places: BTreeSet<_> = placed.split('"').filter(|word| word.contains('!')).collect();
    assert_eq!(places, panels.keys().map(String::as_str).collect());
}

#[test]
fn the_layout_of_plotjuggler_names_channels_and_fields_that_are_there() {
    let text = deployed("plotjuggler/layout.xml");
    let layout = roxmltree::Document::parse(&text).unwrap();
    let (schemas, mut curves) = (Schemas::all(), 0);
    let of = |tag: &'static str| layout.descendants().filter(move |node| node.has_tag_name(tag));
    let made: Vec<_> = of("snippet").filter_map(|node| node.attribute("name")).collect();
    for curve in of("curve").map(|node| node.attribute("name").unwrap()) {
        if !made.contains(&curve) {
            schemas.assert_has(curve, '/');
        }
        curves += 1;
    }
    for source in of("linked_source").chain(of("v1")) {
        schemas.assert_has(source.text().unwrap(), '/');
    }
    assert!(curves > 10 && made == ["latency_ms"], "{curves} curves, {made:?}");
}

#[test]
fn a_path_that_is_not_there_is_found() {
    let schemas = Schemas::all();
    assert!(schemas.has("/fused", &["w", "re"]) && !schemas.has("/fused", &["w", "x"]));
    assert!(!schemas.has("/fused", &["w"]), "no number");
    assert!(!schemas.has("/nothing", &[]) && schemas.has("/pose", &[]));
}
