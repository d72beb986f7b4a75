//! A topic more is a line more: what follows from the table follows for it.
use graph::{Buffer, Graph, Participant, Presence, Service};

mod more {
    graph::topics!(graph::define_topics {}
        Pressure = "pressure": PressureSample, flagged(PRESSURE), Path, ingest => [fuser];
        Wind = "wind": WindState, every_tick, Path, gateway => [course];
    );
}

use more::Topic;

const GRAPH: Graph = Graph(Topic::ENTRIES);

#[test]
fn a_line_gives_the_topic_its_place_name_publisher_readers_presence_and_buffer() {
    let entry = Topic::Pressure.entry();
    assert_eq!((entry.place, entry.name, entry.payload), (graph::Topic::ALL.len(), "pressure", "PressureSample"));
    assert_eq!(entry.publisher, Participant::One(Service::Ingest));
    assert_eq!(entry.readers, [Participant::One(Service::Fuser)]);
    assert_eq!((entry.presence, entry.buffer), (Presence::Flagged("PRESSURE"), Buffer::Path));
    assert_eq!(Topic::named("pressure"), Some(Topic::Pressure));
}

#[test]
fn its_readers_have_it_among_their_inputs_and_its_publisher_among_its_outputs() {
    let inputs: Vec<_> = GRAPH.inputs(Service::Fuser).map(|topic| topic.name).collect();
    assert_eq!(inputs, ["mag", "gnss", "gyro", "accel", "pressure"]);
    assert!(GRAPH.outputs(Service::Ingest).any(|topic| topic == Topic::Pressure.entry()));
    assert_eq!(GRAPH.output(Service::Ingest), Some(Topic::Imu.entry()), "it has not every tick");
}

#[test]
fn it_is_carried_to_other_hosts_in_its_turn() {
    let carried: Vec<_> = GRAPH.carried().map(|topic| topic.name).collect();
    assert_eq!(carried, ["mag", "gnss", "pressure", "imu", "gyro", "accel", "fused", "wind"]);
}

#[test]
fn one_with_every_tick_is_waited_for() {
    let entry = Topic::Wind.entry();
    assert_eq!(GRAPH.output(Service::Gateway), Some(entry));
    let inputs: Vec<_> = GRAPH.inputs(Service::Course).map(|topic| topic.name).collect();
    assert_eq!(inputs, ["gnss", "fused", "wind"]);
    assert_eq!(GRAPH.sources(Service::Course).collect::<Vec<_>>(), [Service::Fuser, Service::Gateway]);
}

/// What a crate does that hands out types: an arm for each line, and none for anything else.
macro_rules! payload_of {
    ({ $wanted:expr } $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($reader:ident),*];)*
    ) => {
        match $wanted { $(Topic::$topic => stringify!($payload)),* }
    };
}

#[test]
fn a_match_made_from_the_table_has_an_arm_for_it() {
    let payload = |topic: Topic| {
        graph::topics!(payload_of { topic }
            Pressure = "pressure": PressureSample, flagged(PRESSURE), Path, ingest => [fuser];
            Wind = "wind": WindState, every_tick, Path, gateway => [course];
        )
    };
    assert_eq!([Topic::Imu, Topic::Wind].map(payload), ["ImuSample", "WindState"]);
}
