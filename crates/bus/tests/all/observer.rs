//! Observers of a system that only the test has: they are few, they hold up nobody, and what is not theirs stays.
use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::PathBuf,
    sync::atomic::{AtomicU32, Ordering},
};

use bus::{Bus, BusError, Claim, OBSERVERS, Observer, Publisher, StaleResources, SystemLiveness, SystemName};
use bytemuck::Zeroable;
use graph::Topic;
use messages::ImuSample;

const BUFFER: usize = 64;

/// A system without services: its name, its owner's claim, and a place on its bus.
struct System {
    bus: Bus,
    claim: Claim,
    system_name: SystemName,
}

fn system() -> System {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("test-observer-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
    begin(&SystemName::new(&name).unwrap())
}

fn begin(system_name: &SystemName) -> System {
    let claim = system_name.claim().unwrap();
    System { bus: Bus::join(system_name, "service").unwrap(), claim, system_name: system_name.clone() }
}

fn send(publisher: &Publisher<ImuSample>, ticks: std::ops::Range<u64>) {
    for tick in ticks {
        let mut sample = ImuSample::zeroed();
        sample.header.tick = tick;
        publisher.send(&sample).unwrap();
    }
}

fn files(system_name: &SystemName) -> Vec<PathBuf> {
    StaleResources::of(system_name).unwrap().files
}

#[test]
fn an_observer_sees_what_is_published_from_then_on_and_who_is_there() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..10);
    let observer = Observer::sit(system_name, "test").unwrap();
    let tap = observer.tap(Topic::Imu).unwrap();
    send(&publisher, 10..13);
    let mut ticks = Vec::new();
    let full =
        tap.drain(&mut |bytes| ticks.push(bytemuck::pod_read_unaligned::<ImuSample>(bytes).header.tick)).unwrap();
    assert_eq!((ticks, full), (vec![10, 11, 12], false));
    let ports = tap.ports().unwrap();
    assert_eq!(ports.buffer, BUFFER);
    let names = |ports: &[bus::Port]| ports.iter().map(|port| port.name.clone()).collect::<Vec<_>>();
    assert_eq!((names(&ports.publishers), names(&ports.subscribers)), (vec!["service".into()], vec!["test".into()]));
    assert_eq!((ports.publishers[0].pid, ports.publishers[0].alive), (std::process::id(), true));
}

#[test]
fn a_slow_observer_loses_its_own_messages_and_is_told() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let reader = bus.subscriber::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::sit(system_name, "test").unwrap();
    let tap = observer.tap(Topic::Imu).unwrap();
    for start in (0..300).step_by(50) {
        send(&publisher, start..start + 50);
        assert_eq!(std::iter::from_fn(|| reader.receive().unwrap()).count(), 50, "the service beside it loses nothing");
    }
    let mut count = 0;
    assert!(tap.drain(&mut |_| count += 1).unwrap());
    assert_eq!(count, BUFFER);
}

#[test]
fn one_observer_too_many_is_told_so_and_a_place_that_is_left_is_free() {
    let System { system_name, .. } = &system();
    let mut observers: Vec<_> = (0..OBSERVERS).map(|_| Observer::sit(system_name, "test").unwrap()).collect();
    let refused = Observer::sit(system_name, "one too many").unwrap_err();
    assert!(matches!(refused, BusError::Crowded { .. }), "{refused}");
    observers.pop();
    Observer::sit(system_name, "test").unwrap();
}

#[test]
fn observers_leave_every_place_of_the_services_free() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observers: Vec<_> = (0..OBSERVERS).map(|_| Observer::sit(system_name, "test").unwrap()).collect();
    let _taps: Vec<_> = observers.iter().map(|observer| observer.tap(Topic::Imu).unwrap()).collect();
    let readers: Vec<_> = (0..10).map(|_| bus.subscriber::<ImuSample>(BUFFER).unwrap()).collect();
    send(&publisher, 0..BUFFER as u64);
    assert!(readers.iter().all(|reader| std::iter::from_fn(|| reader.receive().unwrap()).count() == BUFFER));
}

#[test]
fn an_observer_opens_nothing_and_names_what_is_missing() {
    let System { system_name, .. } = &system();
    let observer = Observer::sit(system_name, "test").unwrap();
    assert!(matches!(observer.tap(Topic::Imu).unwrap_err(), BusError::Unopened { topic: "imu" }));
    assert!(
        StaleResources::of(system_name)
            .unwrap()
            .files
            .iter()
            .all(|path| path.extension().is_none_or(|it| it != "dynamic"))
    );
}

#[test]
fn what_nobody_can_open_is_not_waited_for() {
    let System { bus, system_name, claim: _claim } = &system();
    let _publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::sit(system_name, "test").unwrap();
    observer.tap(Topic::Imu).unwrap();
    let killed = PathBuf::from(format!("/dev/shm/plumbline.{}.0_1.dynamic", system_name.name()));
    fs::write(&killed, "").unwrap();
    let refused = observer.tap(Topic::Imu).unwrap_err();
    assert!(matches!(&refused, BusError::HalfMade { path, .. } if *path == killed), "{refused}");
    assert_eq!(StaleResources::of(system_name).unwrap().half_made, Some(killed));
}

#[test]
fn an_observer_that_outlives_its_system_leaves_the_next_one_of_the_name_alone() {
    let System { bus, system_name, claim } = system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::sit(&system_name, "test").unwrap();
    let tap = observer.tap(Topic::Imu).unwrap();
    send(&publisher, 0..3);
    drop((publisher, bus, claim));
    assert!(!observer.is_running());
    assert_eq!(files(&system_name), Vec::<PathBuf>::new(), "the system does not wait for it");
    let next = begin(&system_name);
    let publisher = next.bus.publisher::<ImuSample>(BUFFER).unwrap();
    let before = files(&system_name);
    assert!(!observer.is_running(), "another one has the name");
    assert!(observer.tap(Topic::Imu).is_err());
    drop((tap, observer));
    assert_eq!(files(&system_name), before);
    let reader = next.bus.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..3);
    assert_eq!(std::iter::from_fn(|| reader.receive().unwrap()).count(), 3);
}

#[test]
fn what_a_dead_system_left_is_found_and_removed_and_a_living_one_is_not() {
    let living = system();
    assert_eq!(
        StaleResources::of(&living.system_name).unwrap().liveness,
        SystemLiveness::Runs { pid: std::process::id() }
    );
    StaleResources::of(&living.system_name).unwrap().clear().unwrap();
    let publisher = living.bus.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..1);
    drop((publisher, living.bus));
    let (system_name, claim) = (living.system_name, living.claim);
    drop(claim);

    let page = PathBuf::from(format!("/dev/shm/plumbline.{}.wake", system_name.name()));
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system_name.name()));
    fs::write(&page, [0]).unwrap();
    fs::set_permissions(&page, fs::Permissions::from_mode(0o600)).unwrap();
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("door"), "").unwrap();
    let remains =
        StaleResources::all().into_iter().flatten().find(|remains| remains.system_name == system_name).unwrap();
    assert_eq!((remains.liveness.clone(), remains.files.len()), (SystemLiveness::Dead, 2));
    remains.clear().unwrap();
    assert_eq!(files(&system_name), Vec::<PathBuf>::new());
}

#[test]
fn there_is_nothing_to_observe_where_nothing_runs() {
    let system_name = SystemName::new(&format!("test-nobody-{}", std::process::id())).unwrap();
    assert!(matches!(Observer::sit(&system_name, "test").unwrap_err(), BusError::NotRunning { .. }));
    assert_eq!(files(&system_name), Vec::<PathBuf>::new());
}
