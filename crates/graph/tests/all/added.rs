//! Queries on the topic table with additional lines.
use graph::{Buffer, Graph, Participant, Presence, Service};

mod extended {
    graph::topics!(graph::define_topics {}
        Pressure = "pressure": PressureSample, flagged(PRESSURE), Path, ingest => [fuser];
        Wind = "wind": WindState, every_tick, Path, gateway => [course];
    );
}

use extended::Topic;

const GRAPH: Graph = Graph(Topic::ENTRIES);

#[test]
fn added_line_defines_the_entry() {
    let entry = Topic::Pressure.entry();
    assert_eq!((entry.index, entry.name, entry.payload), (graph::Topic::ALL.len(), "pressure", "PressureSample"));
    assert_eq!(entry.publisher, Participant::One(Service::Ingest));
    assert_eq!(entry.subscribers, [Participant::One(Service::Fuser)]);
    assert_eq!((entry.presence, entry.buffer), (Presence::Flagged("PRESSURE"), Buffer::Path));
    assert_eq!(Topic::from_name("pressure"), Some(Topic::Pressure));
}

#[test]
fn added_topic_is_input_and_output_of_its_services() {
    let inputs: Vec<_> = GRAPH.inputs(Service::Fuser).map(|topic| topic.name).collect();
    assert_eq!(inputs, ["mag", "gnss", "gyro", "accel", "pressure"]);
    assert!(GRAPH.outputs(Service::Ingest).any(|topic| topic == Topic::Pressure.entry()));
    assert_eq!(GRAPH.output(Service::Ingest), Some(Topic::Imu.entry()), "`pressure` is not an every-tick topic");
}

#[test]
fn added_topics_are_carried_in_order() {
    let carried: Vec<_> = GRAPH.carried().map(|topic| topic.name).collect();
    assert_eq!(carried, ["mag", "gnss", "pressure", "imu", "gyro", "accel", "fused", "wind"]);
}

#[test]
fn added_dense_topic_makes_its_publisher_a_source() {
    let entry = Topic::Wind.entry();
    assert_eq!(GRAPH.output(Service::Gateway), Some(entry));
    let inputs: Vec<_> = GRAPH.inputs(Service::Course).map(|topic| topic.name).collect();
    assert_eq!(inputs, ["gnss", "fused", "wind"]);
    assert_eq!(GRAPH.sources(Service::Course).collect::<Vec<_>>(), [Service::Fuser, Service::Gateway]);
}

/// Example of a user-defined macro that is applied to the table. It creates a match arm for each
/// line.
macro_rules! payload_of {
    ({ $topic_value:expr } $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($subscriber:ident),*];)*
    ) => {
        match $topic_value { $(Topic::$topic => stringify!($payload)),* }
    };
}

#[test]
fn macro_over_the_table_covers_added_topics() {
    let payload = |topic: Topic| {
        graph::topics!(payload_of { topic }
            Pressure = "pressure": PressureSample, flagged(PRESSURE), Path, ingest => [fuser];
            Wind = "wind": WindState, every_tick, Path, gateway => [course];
        )
    };
    assert_eq!([Topic::Imu, Topic::Wind].map(payload), ["ImuSample", "WindState"]);
}
