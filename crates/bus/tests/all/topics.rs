//! Two places on the bus of a system that only the test has.
use std::{
    fs,
    os::unix::fs::{FileExt, PermissionsExt},
    path::PathBuf,
    sync::atomic::{AtomicU32, Ordering},
    time::Duration,
};

use bus::{Bus, BusError, Claim, Publisher, Subscriber, SystemName, Woken};
use bytemuck::Zeroable;
use graph::Entry;
use messages::{Field, Health, ImuSample, Layout, Message, Reference};

const BUFFER: usize = 64;
/// Nothing that is waited for takes so long; it ends a test that failed.
const HANG: Duration = Duration::from_secs(60);

/// A system whose name no other test has.
fn system_name() -> SystemName {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    SystemName::new(&format!("test-bus-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst))).unwrap()
}

/// Two places on the bus of a claimed system. Dropped before the claim, as in a system.
struct Pair {
    here: Bus,
    there: Bus,
    system_name: SystemName,
    _claim: Claim,
}

fn pair() -> Pair {
    let system_name = system_name();
    let claim = system_name.claim().unwrap();
    let [here, there] = ["here", "there"].map(|who| Bus::join(&system_name, who).unwrap());
    Pair { here, there, system_name, _claim: claim }
}

/// What carries the system's name.
fn remains(system_name: &SystemName) -> Vec<String> {
    let (dotted, folder) = (format!("plumbline.{}.", system_name.name()), format!("plumbline.{}", system_name.name()));
    ["/dev/shm", "/tmp"]
        .iter()
        .flat_map(|path| fs::read_dir(path).unwrap().flatten())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with(&dotted) || *name == folder)
        .collect()
}

fn send(publisher: &Publisher<ImuSample>, ticks: std::ops::Range<u64>) {
    for tick in ticks {
        let mut sample = ImuSample::zeroed();
        sample.header.tick = tick;
        publisher.send(&sample).unwrap();
    }
}

fn ticks(subscriber: &Subscriber<ImuSample>) -> Vec<u64> {
    std::iter::from_fn(|| subscriber.receive().unwrap()).map(|sample| sample.header.tick).collect()
}

#[test]
fn messages_arrive_whole_and_in_order() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    for count in 0..1000u32 {
        let mut sample = ImuSample::zeroed();
        bytemuck::bytes_of_mut(&mut sample).iter_mut().zip(count..).for_each(|(byte, n)| *byte = n as u8);
        publisher.send(&sample).unwrap();
        if count % 40 == 39 {
            let first = count - 39;
            for expected in first..=count {
                let sample = subscriber.receive().unwrap().unwrap();
                assert!(bytemuck::bytes_of(&sample).iter().zip(expected..).all(|(byte, n)| *byte == n as u8));
            }
            assert!(subscriber.receive().unwrap().is_none());
        }
    }
}

#[test]
fn a_slow_reader_loses_the_oldest_and_a_quick_one_nothing() {
    let Pair { here, there, .. } = &pair();
    let slow = there.subscriber::<ImuSample>(BUFFER).unwrap();
    let quick = here.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    let mut seen = Vec::new();
    for tick in 0..100 {
        send(&publisher, tick..tick + 1);
        seen.extend(ticks(&quick));
    }
    assert_eq!(seen, (0..100).collect::<Vec<_>>());
    assert_eq!(ticks(&slow), (100 - BUFFER as u64..100).collect::<Vec<_>>());
    send(&publisher, 100..110);
    assert_eq!(ticks(&slow), (100..110).collect::<Vec<_>>());
}

#[test]
fn a_reader_that_comes_late_begins_with_the_next_message() {
    let Pair { here, there, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..10);
    let late = there.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 10..13);
    assert_eq!(ticks(&late), [10, 11, 12]);
}

#[test]
fn a_waiter_is_woken_by_what_was_sent() {
    let Pair { there, system_name, .. } = &pair();
    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let here = Bus::join(system_name, "thread").unwrap();
            let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
            for tick in 0..500 {
                std::thread::sleep(Duration::from_micros(tick % 7 * 50));
                send(&publisher, tick..tick + 1);
                publisher.wake();
            }
        });
        let mut seen = Vec::new();
        while seen.len() < 500 {
            assert_eq!(subscriber.wait(HANG), Woken::Work, "after {}", seen.len());
            subscriber.drain(BUFFER, |sample| seen.push(sample.header.tick)).unwrap();
        }
        assert_eq!(seen, (0..500).collect::<Vec<_>>());
    });
}

#[test]
fn every_reader_of_a_topic_is_woken_by_one_call() {
    let Pair { here, system_name, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..4)
            .map(|n| {
                scope.spawn(move || {
                    let there = Bus::join(system_name, &format!("reader-{n}")).unwrap();
                    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
                    let mut last = None;
                    while last != Some(999) {
                        assert_ne!(subscriber.wait(HANG), Woken::Idle);
                        subscriber.drain(BUFFER, |sample| last = Some(sample.header.tick)).unwrap();
                    }
                })
            })
            .collect();
        for tick in 0.. {
            // The last tick again and again, for readers that were not there before.
            send(&publisher, tick.min(999)..tick.min(999) + 1);
            publisher.wake();
            std::thread::sleep(Duration::from_micros(50));
            if readers.iter().all(|reader| reader.is_finished()) {
                break;
            }
        }
    });
}

/// Who is frozen said that he waits before that, and says nothing more.
#[test]
fn a_reader_that_is_frozen_while_it_waits_costs_one_call_of_the_kernel() {
    let Pair { here, system_name, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    // Each word is alone on its cache line, and so is what stands before the first.
    let word_bytes = 64;
    let waiting = (word_bytes * (1 + ImuSample::TOPIC.place) + size_of::<u32>()) as u64;
    let page = fs::File::options()
        .read(true)
        .write(true)
        .open(format!("/dev/shm/plumbline.{}.wake", system_name.name()))
        .unwrap();
    page.write_all_at(&1_u32.to_ne_bytes(), waiting).unwrap();
    publisher.wake();
    let mut said = [0xff; 4];
    page.read_exact_at(&mut said, waiting).unwrap();
    assert_eq!(u32::from_ne_bytes(said), 0, "the next message would call the kernel as well");
}

#[test]
fn a_wait_is_idle_without_work_and_none_with_it() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), Woken::Idle);
    send(&publisher, 0..BUFFER as u64);
    publisher.wake();
    assert_eq!(subscriber.wait(HANG), Woken::Work, "it is there already");
    subscriber.drain(BUFFER / 2, |_| ()).unwrap();
    assert_eq!(subscriber.wait(HANG), Woken::Work, "there may be more than was taken");
    subscriber.drain(BUFFER, |_| ()).unwrap();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), Woken::Idle);
}

mod more {
    graph::topics!(graph::define_topics {}
        Pressure = "pressure": Pressure, no_tick, Control, services => [supervisor];
    );
}

/// A payload of a topic that the table has in one line more.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Pressure {
    pressure_pa: f64,
}

impl Message for Pressure {
    const TOPIC: &'static Entry = more::Topic::Pressure.entry();
    const TYPE: &'static str = "plumbline.Pressure.1";

    fn layout() -> Layout {
        let fields = vec![Field { name: "pressure_pa", kind: "f64", offset: 0, about: "" }];
        Layout { name: Self::TYPE, size: 8, fields, topic: Some(Self::TOPIC.name), about: "", header_fields: 0 }
    }
}

#[test]
fn a_topic_of_a_line_more_has_a_wake_word_of_its_own_and_room_for_its_publishers() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<Pressure>(BUFFER).unwrap();
    let publishers: Vec<_> = (0..10).map(|_| here.publisher::<Pressure>(BUFFER).unwrap()).collect();
    let health = here.publisher::<Health>(BUFFER).unwrap();
    health.wake();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), Woken::Idle, "that was another topic");
    for (count, publisher) in publishers.iter().enumerate() {
        publisher.send(&Pressure { pressure_pa: count as f64 }).unwrap();
    }
    publishers[0].set_next_tick_after(41);
    publishers[0].wake();
    assert_eq!(subscriber.wait(HANG), Woken::Work);
    let mut sum_pa = 0.0;
    subscriber.drain(BUFFER, |message| sum_pa += message.pressure_pa).unwrap();
    assert_eq!((sum_pa, there.next_tick(Pressure::TOPIC), there.next_tick(Health::TOPIC)), (45.0, 42, 0));
}

/// `Reference` as another build of this program might define it: same name, same size, two fields the other way round.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Swapped {
    scored: u64,
    tick: u64,
    quaternion: [f64; 4],
}

impl Message for Swapped {
    const TOPIC: &'static Entry = Reference::TOPIC;
    const TYPE: &'static str = Reference::TYPE;

    fn layout() -> Layout {
        let field = |name, kind, offset| Field { name, kind, offset, about: "" };
        let fields = vec![field("scored", "u64", 0), field("tick", "u64", 8), field("quaternion", "[f64; 4]", 16)];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC.name),
            about: "",
            header_fields: 0,
        }
    }
}

/// `Reference` as a later version might define it.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Later {
    tick: u64,
}

impl Message for Later {
    const TOPIC: &'static Entry = Reference::TOPIC;
    const TYPE: &'static str = "plumbline.Reference.2";

    fn layout() -> Layout {
        let fields = vec![Field { name: "tick", kind: "u64", offset: 0, about: "" }];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC.name),
            about: "",
            header_fields: 0,
        }
    }
}

fn assert_names_both_layouts(error: &BusError, here: &Layout, there: &Layout) {
    assert!(matches!(error, BusError::Layout { .. }), "{error:?}");
    let expected = format!(
        "opening the topic `reference`: another layout is on the bus\n  here:  {here}\n  there: {there}\nrun one version of plumb only"
    );
    assert_eq!(error.to_string(), expected);
}

#[test]
fn a_topic_that_holds_too_little_says_how_much_all_must_ask_for() {
    let Pair { here, there, .. } = &pair();
    let _publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    for error in [there.publisher::<ImuSample>(2000).unwrap_err(), there.subscriber::<ImuSample>(2000).unwrap_err()] {
        assert!(matches!(error, BusError::Buffer { here: 2000, there: BUFFER, .. }), "{error:?}");
        let said = error.to_string();
        assert!(said.contains("`imu`") && said.contains("buffer_s x rate_hz of the launch file"), "{said}");
    }
    // Whoever asks for less takes what there is.
    there.publisher::<ImuSample>(BUFFER / 2).unwrap();
}

#[test]
fn a_message_of_another_layout_is_refused_and_both_layouts_are_shown() {
    let Pair { here, there, .. } = &pair();
    let _publisher = here.publisher::<Reference>(BUFFER).unwrap();
    let error = there.subscriber::<Swapped>(BUFFER).unwrap_err();
    assert_names_both_layouts(&error, &Swapped::layout(), &Reference::layout());
    let error = there.publisher::<Swapped>(BUFFER).unwrap_err();
    assert_names_both_layouts(&error, &Swapped::layout(), &Reference::layout());
    let error = there.subscriber::<Later>(BUFFER).unwrap_err();
    assert_names_both_layouts(&error, &Later::layout(), &Reference::layout());
    there.subscriber::<Reference>(BUFFER).unwrap();
}

#[test]
fn a_name_cannot_be_claimed_twice() {
    let Pair { system_name, .. } = &pair();
    let error = system_name.claim().unwrap_err();
    let pid = std::process::id();
    assert!(matches!(error, BusError::Taken { .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains(&format!("process {pid}")) && text.contains(&format!("kill {pid}")), "{text}");
    assert!(text.contains("set another `name` in launch.toml"), "{text}");
}

#[test]
fn a_system_that_does_not_run_cannot_be_joined() {
    let system_name = system_name();
    let error = Bus::join(&system_name, "test").unwrap_err();
    assert!(matches!(error, BusError::NotRunning { .. }), "{error:?}");
    drop(system_name.claim().unwrap());
    assert!(matches!(Bus::join(&system_name, "test"), Err(BusError::NotRunning { .. })), "after its end");
    assert_eq!(remains(&system_name), Vec::<String>::new());
}

#[test]
fn names_that_cannot_be_part_of_a_file_name_are_refused() {
    for name in ["", "a.b", "a/b", "..", "Upper", "with space", "é", &"x".repeat(33)] {
        assert!(matches!(SystemName::new(name), Err(BusError::Name { .. })), "{name:?}");
    }
    assert_eq!(SystemName::new(&"x".repeat(32)).unwrap().name().len(), 32);
}

#[test]
fn nothing_of_the_name_remains_at_the_end() {
    let pair = pair();
    let system_name = pair.system_name.clone();
    let subscriber = pair.there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = pair.here.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..3);
    assert!(remains(&system_name).len() > 1);
    drop((subscriber, publisher, pair));
    assert_eq!(remains(&system_name), Vec::<String>::new());
}

/// A real owner is killed in the tests of the command line.
#[test]
fn what_a_dead_owner_left_is_removed_by_the_next() {
    let system_name = system_name();
    let prefix = format!("/dev/shm/plumbline.{}.", system_name.name());
    for file in ["wake", "0123.service", "4567.publisher"] {
        fs::write(prefix.clone() + file, "old").unwrap();
        fs::set_permissions(prefix.clone() + file, fs::Permissions::from_mode(0o600)).unwrap();
    }
    let services = PathBuf::from(format!("/dev/shm/plumbline.{}/services", system_name.name()));
    fs::create_dir_all(services.join("0123")).unwrap();
    let claim = system_name.claim().unwrap();
    let left = remains(&system_name);
    assert!(!left.iter().any(|name| name.ends_with("0123.service") || name.ends_with("4567.publisher")), "{left:?}");
    assert!(!services.join("0123").exists());
    let bus = Bus::join(&system_name, "heir").unwrap();
    let subscriber = bus.subscriber::<ImuSample>(2 * BUFFER).unwrap();
    let publisher = bus.publisher::<ImuSample>(2 * BUFFER).unwrap();
    send(&publisher, 5..8);
    assert_eq!(ticks(&subscriber), [5, 6, 7]);
    drop((subscriber, publisher, bus, claim));
    assert_eq!(remains(&system_name), Vec::<String>::new());
}

#[test]
fn a_name_that_begins_another_does_not_touch_it() {
    let short = system_name();
    let long = SystemName::new(&format!("{}b", short.name())).unwrap();
    let long_claim = long.claim().unwrap();
    let bus = Bus::join(&long, "test").unwrap();
    let subscriber = bus.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let before = remains(&long);
    drop(short.claim().unwrap());
    assert_eq!(remains(&long), before);
    send(&publisher, 0..3);
    assert_eq!(ticks(&subscriber), [0, 1, 2]);
    let other = Bus::join(&long, "other").unwrap();
    let late = other.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 3..5);
    assert_eq!(ticks(&late), [3, 4]);
    drop((late, other, subscriber, publisher, bus, long_claim));
    assert_eq!(remains(&long), Vec::<String>::new());
}

#[test]
fn the_page_of_another_system_is_never_removed() {
    let system_name = system_name();
    let foreign = PathBuf::from(format!("/dev/shm/plumbline.{}x.test", system_name.name()));
    fs::write(&foreign, "").unwrap();
    drop(system_name.claim().unwrap());
    let there = foreign.exists();
    fs::remove_file(&foreign).unwrap();
    assert!(there);
}

#[test]
fn a_name_taken_anew_after_its_files_were_removed_goes_on_with_its_ticks() {
    let system_name = system_name();
    let claim = system_name.claim().unwrap();
    let driver = Bus::join(&system_name, "driver").unwrap();
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    publisher.set_next_tick_after(41);
    let own = [std::process::id()];
    assert_eq!(system_name.removed(&own), None);
    for name in remains(&system_name) {
        let path = PathBuf::from("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    assert!(system_name.removed(&own).is_some());
    drop((publisher, bus));
    let claim = claim.renew().unwrap();
    assert!(!driver.is_running(), "it has to join again");
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    assert_eq!(bus.next_tick(ImuSample::TOPIC), 42);
    assert!(bus.is_running());
    assert!(system_name.removed(&own).is_some(), "the driver's are still the old ones");
    drop(driver);
    assert_eq!(system_name.removed(&own), None);
    drop((bus, claim));
    assert_eq!(remains(&system_name), Vec::<String>::new());
}
