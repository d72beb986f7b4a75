//! Queries on the system's topic table.
use graph::{
    Presence, Service,
    Service::{Accel, Cockpit, Course, Drivers, Fuser, Gateway, Gyro, Ingest},
    Slot, Topic,
};

fn names(topics: impl Iterator<Item = Topic>) -> Vec<&'static str> {
    topics.map(Topic::name).collect()
}

#[test]
fn inputs_and_outputs_follow_the_table() {
    let inputs = Service::ALL.map(|service| names(service.inputs()));
    let expected: [&[&str]; 8] =
        [&[], &["imu"], &["imu"], &["mag", "gnss", "gyro", "accel"], &["gnss", "fused"], &[], &[], &[]];
    assert_eq!(inputs, expected);
    let outputs = Service::ALL.map(Service::output);
    let expected = [Topic::Imu, Topic::Gyro, Topic::Accel, Topic::Fused, Topic::Attitude].map(Some);
    assert_eq!(outputs, [&expected[..], &[None, None, None]].concat()[..]);
}

#[test]
fn downstream_includes_gateway_for_carried_topics() {
    let downstream = Service::ALL.map(|service| service.downstream().collect::<Vec<_>>());
    let expected: [&[Service]; 8] = [
        &[Gyro, Accel, Fuser, Course, Gateway],
        &[Fuser, Gateway],
        &[Fuser, Gateway],
        &[Course, Gateway],
        &[],
        &[Gyro, Accel, Fuser, Course],
        &[],
        &[],
    ];
    assert_eq!(downstream, expected);
}

#[test]
fn sources_publish_every_tick() {
    let sources = Service::PATH.map(|service| service.sources().collect::<Vec<_>>());
    let expected: [&[Service]; 5] = [&[], &[Ingest], &[Ingest], &[Gyro, Accel], &[Fuser]];
    assert_eq!(sources, expected);
}

#[test]
fn sparse_topics_are_carried_before_dense_ones() {
    assert_eq!(names(Topic::carried()), ["mag", "gnss", "imu", "gyro", "accel", "fused"]);
}

#[test]
fn slots_are_services_of_the_path_that_run_a_stage() {
    let services = Slot::ALL.map(Service::from);
    assert_eq!(services, [Gyro, Accel, Fuser, Course]);
    assert_eq!(Service::ALL.into_iter().filter(|service| service.slot().is_some()).collect::<Vec<_>>(), services);
    assert_eq!(services.map(Service::slot), Slot::ALL.map(Some));
    assert_eq!(services.map(Service::name), Slot::ALL.map(Slot::name));
    assert_eq!(["fuser", "ingest", "fusers"].map(Slot::from_name), [Some(Slot::Fuser), None, None]);
}

#[test]
fn properties_follow_the_table_of_services() {
    assert_eq!(Service::LISTED, [Ingest, Gyro, Accel, Fuser, Course, Gateway, Cockpit]);
    let with = |property: fn(Service) -> bool| Service::ALL.into_iter().filter(|s| property(*s)).collect::<Vec<_>>();
    assert_eq!(with(Service::is_auxiliary), [Gateway, Drivers, Cockpit]);
    assert_eq!(with(Service::carries_ticks), [Gateway]);
    assert_eq!(with(Service::is_low_priority), [Gateway, Cockpit]);
}

#[test]
fn names_indices_and_flags_follow_the_table() {
    for (index, topic) in Topic::ALL.iter().enumerate() {
        assert_eq!((topic.entry().index, Topic::from_name(topic.name())), (index, Some(*topic)));
    }
    assert_eq!(Topic::from_name("imus"), None);
    assert_eq!(Topic::Mag.entry().presence, Presence::Flagged("FIELD"));
    assert_eq!(Service::ALL.map(|service| Service::from_name(service.name())), Service::ALL.map(Some));
    assert_eq!(
        [0, 5, 6, 7, 8].map(Service::from_index),
        [Some(Ingest), Some(Gateway), Some(Drivers), Some(Cockpit), None]
    );
}
