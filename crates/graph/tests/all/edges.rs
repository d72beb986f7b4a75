//! Queries on the system's topic table.
use graph::{
    Presence, Service,
    Service::{Accel, Cockpit, Course, Drivers, Fuser, Gateway, Gyro, Ingest},
    Slot, Topic,
};

fn names(topics: impl Iterator<Item = Topic>) -> Vec<&'static str> {
    topics.map(Topic::name).collect()
}

/// Services with the edges and properties that these tests state. An additional service changes
/// none of them.
const SERVICES: [Service; 8] = [Ingest, Gyro, Accel, Fuser, Course, Gateway, Drivers, Cockpit];

#[test]
fn inputs_and_outputs_follow_the_table() {
    let inputs = SERVICES.map(|service| names(service.inputs()));
    let expected: [&[&str]; 8] =
        [&[], &["imu"], &["imu"], &["mag", "gnss", "gyro", "accel"], &["gnss", "fused"], &[], &[], &[]];
    assert_eq!(inputs, expected);
    let outputs = SERVICES.map(Service::output);
    let expected = [Topic::Imu, Topic::Gyro, Topic::Accel, Topic::Fused, Topic::Attitude].map(Some);
    assert_eq!(outputs, [&expected[..], &[None, None, None]].concat()[..]);
}

#[test]
fn downstream_includes_gateway_for_carried_topics() {
    let downstream = SERVICES.map(|service| service.downstream().collect::<Vec<_>>());
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
fn properties_follow_the_service_table() {
    let with = |property: fn(Service) -> bool| SERVICES.into_iter().filter(|s| property(*s)).collect::<Vec<_>>();
    let listed = with(|service| Service::LISTED.contains(&service));
    assert_eq!(listed, [Ingest, Gyro, Accel, Fuser, Course, Gateway, Cockpit]);
    assert!(Service::LISTED.is_sorted_by_key(|service| *service as usize));
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
    // Files name a service by its variant in lower case.
    assert!(Service::ALL.iter().all(|service| format!("{service:?}").to_lowercase() == service.name()));
    // The index identifies a service in messages, so a new one comes last.
    assert_eq!(std::array::from_fn(|index| Service::from_index(index as u32)), SERVICES.map(Some));
    assert_eq!(Service::from_index(Service::ALL.len() as u32), None);
}
