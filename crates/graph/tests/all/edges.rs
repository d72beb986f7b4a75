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
    let inputs = Service::ALL.map(|service| (service, names(service.inputs())));
    let inputs: Vec<_> = inputs.iter().filter(|(_, inputs)| !inputs.is_empty()).map(|(s, i)| (*s, &i[..])).collect();
    let expected: [(Service, &[&str]); 4] =
        [(Gyro, &["imu"]), (Accel, &["imu"]), (Fuser, &["mag", "gnss", "gyro", "accel"]), (Course, &["gnss", "fused"])];
    assert_eq!(inputs, expected);
    let outputs: Vec<_> = Service::ALL.into_iter().filter_map(|service| Some((service, service.output()?))).collect();
    let expected = [
        (Ingest, Topic::Imu),
        (Gyro, Topic::Gyro),
        (Accel, Topic::Accel),
        (Fuser, Topic::Fused),
        (Course, Topic::Attitude),
    ];
    assert_eq!(outputs, expected);
}

#[test]
fn downstream_includes_gateway_for_carried_topics() {
    let downstream = Service::ALL.map(|service| (service, service.downstream().collect::<Vec<_>>()));
    let downstream: Vec<_> = downstream.iter().filter(|(_, d)| !d.is_empty()).map(|(s, d)| (*s, &d[..])).collect();
    let expected: [(Service, &[Service]); 5] = [
        (Ingest, &[Gyro, Accel, Fuser, Course, Gateway]),
        (Gyro, &[Fuser, Gateway]),
        (Accel, &[Fuser, Gateway]),
        (Fuser, &[Course, Gateway]),
        (Gateway, &[Gyro, Accel, Fuser, Course]),
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
    let properties = |service: Service| {
        let is_listed = Service::LISTED.contains(&service);
        (is_listed, service.is_auxiliary(), service.carries_ticks(), service.is_low_priority())
    };
    let expected = [
        (Ingest, (true, false, false, false)),
        (Gyro, (true, false, false, false)),
        (Accel, (true, false, false, false)),
        (Fuser, (true, false, false, false)),
        (Course, (true, false, false, false)),
        (Gateway, (true, true, true, true)),
        (Drivers, (false, true, false, false)),
        (Cockpit, (true, true, false, true)),
    ];
    assert_eq!(expected.map(|(service, _)| (service, properties(service))), expected);
    assert!(Service::LISTED.is_sorted_by_key(|service| *service as usize));
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
    assert_eq!(
        [0, 5, 6, 7].map(Service::from_index),
        [Some(Ingest), Some(Gateway), Some(Drivers), Some(Cockpit)],
        "a new service comes last, because its index identifies it in messages"
    );
    assert_eq!(Service::from_index(Service::ALL.len() as u32), None);
}
