//! Observers of a test system: their maximum number and their independence from the system.
use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::PathBuf,
    process::Command,
    sync::atomic::{AtomicBool, AtomicU32, Ordering},
};

use bus::{Bus, BusError, Claim, MAX_OBSERVERS, Observer, Publisher, StaleResources, SystemLiveness, SystemName};
use bytemuck::Zeroable;
use graph::Topic;
use messages::ImuSample;

const BUFFER: usize = 64;

/// System without services, consisting of the owner's claim and one member of its bus.
struct System {
    bus: Bus,
    claim: Claim,
    system_name: SystemName,
}

fn system() -> System {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("test-observer-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
    start_system(&SystemName::new(&name).unwrap())
}

fn start_system(system_name: &SystemName) -> System {
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
    StaleResources::for_system(system_name).unwrap().files
}

#[test]
fn observer_receives_new_messages_and_lists_ports() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..10);
    let observer = Observer::attach(system_name, "test").unwrap();
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
fn slow_observer_loses_only_its_own_messages() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let reader = bus.subscriber::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::attach(system_name, "test").unwrap();
    let tap = observer.tap(Topic::Imu).unwrap();
    for start in (0..300).step_by(50) {
        send(&publisher, start..start + 50);
        assert_eq!(std::iter::from_fn(|| reader.receive().unwrap()).count(), 50, "the service loses no message");
    }
    let mut count = 0;
    assert!(tap.drain(&mut |_| count += 1).unwrap());
    assert_eq!(count, BUFFER);
}

#[test]
fn observer_limit_is_enforced_and_places_are_reused() {
    let System { system_name, .. } = &system();
    let mut observers: Vec<_> = (0..MAX_OBSERVERS).map(|_| Observer::attach(system_name, "test").unwrap()).collect();
    let refused = Observer::attach(system_name, "one too many").unwrap_err();
    assert!(matches!(refused, BusError::TooManyObservers { .. }), "{refused}");
    observers.pop();
    Observer::attach(system_name, "test").unwrap();
}

#[test]
fn place_is_free_although_other_thread_forks() {
    let System { system_name, .. } = &system();
    let _others: Vec<_> = (1..MAX_OBSERVERS).map(|_| Observer::attach(system_name, "test").unwrap()).collect();
    let has_ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !has_ended.load(Ordering::Relaxed) {
                assert!(Command::new("true").status().unwrap().success());
            }
        });
        let attached = (0..200).try_for_each(|_| Observer::attach(system_name, "test").map(drop));
        has_ended.store(true, Ordering::Relaxed);
        attached.unwrap();
    });
}

#[test]
fn observers_leave_ports_for_services() {
    let System { bus, system_name, claim: _claim } = &system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observers: Vec<_> = (0..MAX_OBSERVERS).map(|_| Observer::attach(system_name, "test").unwrap()).collect();
    let _taps: Vec<_> = observers.iter().map(|observer| observer.tap(Topic::Imu).unwrap()).collect();
    let readers: Vec<_> = (0..10).map(|_| bus.subscriber::<ImuSample>(BUFFER).unwrap()).collect();
    send(&publisher, 0..BUFFER as u64);
    assert!(readers.iter().all(|reader| std::iter::from_fn(|| reader.receive().unwrap()).count() == BUFFER));
}

#[test]
fn observer_reports_unopened_topic() {
    let System { system_name, .. } = &system();
    let observer = Observer::attach(system_name, "test").unwrap();
    assert!(matches!(observer.tap(Topic::Imu).unwrap_err(), BusError::TopicNotOpen { topic: "imu" }));
    assert!(
        StaleResources::for_system(system_name)
            .unwrap()
            .files
            .iter()
            .all(|path| path.extension().is_none_or(|it| it != "dynamic"))
    );
}

#[test]
fn incomplete_segment_is_reported_without_blocking() {
    let System { bus, system_name, claim: _claim } = &system();
    let _publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::attach(system_name, "test").unwrap();
    observer.tap(Topic::Imu).unwrap();
    let killed = PathBuf::from(format!("/dev/shm/plumbline.{}.0_1.dynamic", system_name.name()));
    fs::write(&killed, "").unwrap();
    let refused = observer.tap(Topic::Imu).unwrap_err();
    assert!(matches!(&refused, BusError::IncompleteSegment { path, .. } if *path == killed), "{refused}");
    assert_eq!(StaleResources::for_system(system_name).unwrap().incomplete_segment, Some(killed));
}

#[test]
fn segment_that_is_being_created_is_awaited() {
    let System { bus, system_name, claim: _claim } = &system();
    let _publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let path = PathBuf::from(format!("/dev/shm/plumbline.{}.1_2_3.data", system_name.name()));
    fs::write(&path, "").unwrap();
    // The creator sets the size later than an abandoned segment is reported.
    let mut command = Command::new("sh");
    command.args(["-c", "sleep 0.4; head -c 8 /dev/zero"]).stdout(fs::File::create(&path).unwrap());
    let mut creator = command.spawn().unwrap();
    drop(command);
    Observer::attach(system_name, "test").unwrap().tap(Topic::Imu).map(drop).unwrap();
    assert!(fs::metadata(&path).unwrap().len() > 0, "the tap did not wait");
    creator.wait().unwrap();
}

#[test]
fn incomplete_connection_is_removed_once_unused() {
    let System { bus, system_name, claim: _claim } = &system();
    let _publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let tap = || Observer::attach(system_name, "test").unwrap().tap(Topic::Imu).map(drop);
    let path = PathBuf::from(format!("/dev/shm/plumbline.{}.0_1_2.connection", system_name.name()));
    fs::write(&path, "").unwrap();
    let mut creator = Command::new("sleep").arg("60").stdin(fs::File::open(&path).unwrap()).spawn().unwrap();
    assert!(matches!(tap().unwrap_err(), BusError::IncompleteSegment { .. }), "in use");
    creator.kill().unwrap();
    creator.wait().unwrap();
    tap().unwrap();
    assert!(!path.exists());
}

#[test]
fn outliving_observer_keeps_files_of_next_run() {
    let System { bus, system_name, claim } = system();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let observer = Observer::attach(&system_name, "test").unwrap();
    let tap = observer.tap(Topic::Imu).unwrap();
    send(&publisher, 0..3);
    drop((publisher, bus, claim));
    assert!(!observer.is_running());
    assert_eq!(files(&system_name), Vec::<PathBuf>::new(), "the system does not wait for the observer");
    let next = start_system(&system_name);
    let publisher = next.bus.publisher::<ImuSample>(BUFFER).unwrap();
    let before = files(&system_name);
    assert!(!observer.is_running(), "another run has started");
    assert!(observer.tap(Topic::Imu).is_err());
    drop((tap, observer));
    assert_eq!(files(&system_name), before);
    let reader = next.bus.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..3);
    assert_eq!(std::iter::from_fn(|| reader.receive().unwrap()).count(), 3);
}

#[test]
fn stale_files_are_removed_only_for_dead_systems() {
    let living = system();
    assert_eq!(
        StaleResources::for_system(&living.system_name).unwrap().liveness,
        SystemLiveness::Running { pid: std::process::id() }
    );
    StaleResources::for_system(&living.system_name).unwrap().remove().unwrap();
    let publisher = living.bus.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..1);
    drop((publisher, living.bus));
    let (system_name, claim) = (living.system_name, living.claim);
    drop(claim);

    let path = PathBuf::from(format!("/dev/shm/plumbline.{}.wake", system_name.name()));
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system_name.name()));
    fs::write(&path, [0]).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("control"), "").unwrap();
    let stale = StaleResources::all().into_iter().flatten().find(|stale| stale.system_name == system_name).unwrap();
    assert_eq!((stale.liveness.clone(), stale.files.len()), (SystemLiveness::Dead, 2));
    stale.remove().unwrap();
    assert_eq!(files(&system_name), Vec::<PathBuf>::new());
}

#[test]
fn observer_fails_if_system_is_not_running() {
    let system_name = SystemName::new(&format!("test-nobody-{}", std::process::id())).unwrap();
    assert!(matches!(Observer::attach(&system_name, "test").unwrap_err(), BusError::NotRunning { .. }));
    assert_eq!(files(&system_name), Vec::<PathBuf>::new());
}
