//! What follows from the table of the system.
use graph::{
    Presence, Service,
    Service::{Accel, Cockpit, Course, Drivers, Fuser, Gateway, Gyro, Ingest},
    Topic,
};

fn names(topics: impl Iterator<Item = Topic>) -> Vec<&'static str> {
    topics.map(Topic::name).collect()
}

#[test]
fn every_service_has_the_inputs_and_the_output_of_its_line() {
    let inputs = Service::ALL.map(|service| names(service.inputs()));
    let expected: [&[&str]; 8] =
        [&[], &["imu"], &["imu"], &["mag", "gnss", "gyro", "accel"], &["gnss", "fused"], &[], &[], &[]];
    assert_eq!(inputs, expected);
    let outputs = Service::ALL.map(Service::output);
    let expected = [Topic::Imu, Topic::Gyro, Topic::Accel, Topic::Fused, Topic::Attitude].map(Some);
    assert_eq!(outputs, [&expected[..], &[None, None, None]].concat()[..]);
}

#[test]
fn who_restarts_says_again_what_those_who_read_it_need() {
    let readers = Service::ALL.map(|service| service.readers().collect::<Vec<_>>());
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
    assert_eq!(readers, expected);
}

#[test]
fn a_service_waits_for_those_whose_topic_has_every_tick() {
    let sources = Service::PATH.map(|service| service.sources().collect::<Vec<_>>());
    let expected: [&[Service]; 5] = [&[], &[Ingest], &[Ingest], &[Gyro, Accel], &[Fuser]];
    assert_eq!(sources, expected);
}

#[test]
fn what_goes_with_some_ticks_is_carried_before_those_ticks() {
    assert_eq!(names(Topic::carried()), ["mag", "gnss", "imu", "gyro", "accel", "fused"]);
}

#[test]
fn names_places_and_flags_are_those_of_the_table() {
    for (place, topic) in Topic::ALL.iter().enumerate() {
        assert_eq!((topic.entry().place, Topic::named(topic.name())), (place, Some(*topic)));
    }
    assert_eq!(Topic::named("imus"), None);
    assert_eq!(Topic::Mag.entry().presence, Presence::Flagged("FIELD"));
    assert_eq!(Service::ALL.map(|service| Service::named(service.name())), Service::ALL.map(Some));
    assert_eq!([0, 5, 6, 7, 8].map(Service::at), [Some(Ingest), Some(Gateway), Some(Drivers), Some(Cockpit), None]);
}
