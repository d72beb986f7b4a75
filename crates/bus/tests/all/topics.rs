//! Topics, names and wake-ups on the bus of a test system.
use std::{
    fs,
    os::unix::fs::{FileExt, PermissionsExt},
    path::PathBuf,
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use bus::{Bus, BusError, Claim, FileMonitor, Observer, Publisher, Subscriber, SystemName, WaitOutcome};
use bytemuck::Zeroable;
use graph::{Entry, Topic};
use messages::{CHECKPOINT_WORDS, Checkpoint, Field, Health, ImuSample, Layout, Message, Reference};

const BUFFER: usize = 64;
/// Upper limit for waits in these tests, so that a failed test ends.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Returns a system name that no other test uses.
fn system_name() -> SystemName {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    SystemName::new(&format!("test-bus-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst))).unwrap()
}

/// Two members of the bus of a claimed system. The members are dropped before the claim.
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

/// Returns the names of all files and folders of the system.
fn system_files(system_name: &SystemName) -> Vec<String> {
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
fn messages_arrive_complete_and_in_order() {
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
fn slow_subscriber_loses_oldest_messages_only() {
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
fn overwritten_messages_stay_unconsumed() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    let sent = BUFFER as u64 + 5;
    send(&publisher, 0..sent);
    publisher.add_sent(sent);
    assert_eq!(subscriber.unconsumed(), sent);
    let mut received = 0;
    subscriber.drain(2 * BUFFER, |_| received += 1).unwrap();
    subscriber.add_consumed(received);
    assert_eq!((received, subscriber.unconsumed()), (BUFFER as u64, 5));
}

#[test]
fn late_subscriber_starts_with_next_message() {
    let Pair { here, there, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..10);
    let late = there.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 10..13);
    assert_eq!(ticks(&late), [10, 11, 12]);
}

#[test]
fn drain_finds_history_delivered_later() {
    let Pair { here, there, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..10);
    let late = there.late_subscriber::<ImuSample>(BUFFER).unwrap();
    let mut seen = Vec::new();
    let mut drain = |calls: usize| {
        (0..calls).for_each(|_| late.drain(BUFFER, |sample| seen.push(sample.header.tick)).unwrap());
        seen.len()
    };
    assert_eq!(drain(100), 0, "the publisher has not delivered the history yet");
    publisher.deliver_history().unwrap();
    assert_eq!(drain(16), 10);
    send(&publisher, 10..13);
    assert_eq!(drain(1), 13, "messages that were counted are received immediately");
    assert_eq!(seen, Vec::from_iter(0..13));
}

#[test]
fn topic_needs_little_more_memory_than_its_messages() {
    /// Number of subscriptions assumed in the memory limit. A topic has buffers for at most this
    /// many.
    const SUBSCRIBERS: usize = 45;
    const OVERHEAD_BYTES: usize = 128;
    let Pair { here, system_name, .. } = &pair();
    let _publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    let data: Vec<_> = system_files(system_name).into_iter().filter(|name| name.ends_with(".data")).collect();
    let [name] = &data[..] else { panic!("one segment expected: {data:?}") };
    let bytes = fs::metadata(format!("/dev/shm/{name}")).unwrap().len() as usize;
    let messages = SUBSCRIBERS * (BUFFER + 1) + BUFFER + 1;
    assert!(bytes < messages * (size_of::<ImuSample>() + OVERHEAD_BYTES), "{bytes} bytes");
}

#[test]
fn messages_of_many_exited_publishers_are_received() {
    const PUBLISHERS: u64 = 20;
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<Health>(BUFFER).unwrap();
    let publishers: Vec<_> = (0..PUBLISHERS).map(|_| here.publisher::<Health>(BUFFER).unwrap()).collect();
    assert_eq!(subscriber.receive().unwrap(), None, "connects the subscriber");
    for (ticks, publisher) in (0..).zip(&publishers) {
        publisher.send(&Health { ticks, ..Health::zeroed() }).unwrap();
    }
    drop(publishers);
    let mut received: Vec<u64> =
        std::iter::from_fn(|| subscriber.receive().unwrap()).map(|health| health.ticks).collect();
    received.sort_unstable();
    assert_eq!(received, Vec::from_iter(0..PUBLISHERS));
}

#[test]
fn waiter_is_woken_by_messages() {
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
            assert_eq!(subscriber.wait(TEST_TIMEOUT), WaitOutcome::Published, "after {}", seen.len());
            subscriber.drain(BUFFER, |sample| seen.push(sample.header.tick)).unwrap();
        }
        assert_eq!(seen, (0..500).collect::<Vec<_>>());
    });
}

#[test]
fn wake_reaches_every_subscriber() {
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
                        assert_ne!(subscriber.wait(TEST_TIMEOUT), WaitOutcome::Idle);
                        subscriber.drain(BUFFER, |sample| last = Some(sample.header.tick)).unwrap();
                    }
                })
            })
            .collect();
        for tick in 0.. {
            // Repeats the last tick for subscribers that joined late.
            send(&publisher, tick.min(999)..tick.min(999) + 1);
            publisher.wake();
            std::thread::sleep(Duration::from_micros(50));
            if readers.iter().all(|reader| reader.is_finished()) {
                break;
            }
        }
    });
}

/// Simulates a subscriber that announced that it is waiting and then froze.
#[test]
fn frozen_waiter_costs_one_system_call() {
    let Pair { here, system_name, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    // Each word occupies one cache line, as do the struct fields before the first word.
    let word_bytes = 64;
    let waiting = (word_bytes * (1 + ImuSample::TOPIC.index) + size_of::<u32>()) as u64;
    let file = fs::File::options()
        .read(true)
        .write(true)
        .open(format!("/dev/shm/plumbline.{}.wake", system_name.name()))
        .unwrap();
    file.write_all_at(&1_u32.to_ne_bytes(), waiting).unwrap();
    publisher.wake();
    let mut waiting_word = [0xff; 4];
    file.read_exact_at(&mut waiting_word, waiting).unwrap();
    assert_eq!(u32::from_ne_bytes(waiting_word), 0, "the next message would make a system call, too");
}

/// Events on a topic while its subscriber sleeps without a timer.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Activity {
    Idle,
    /// A publisher counts a message and clears the announcement of the subscriber. It is killed
    /// before it wakes the subscriber.
    LostWake,
    /// A publisher is killed as in `LostWake`, and another one continues.
    LostWakeAndMessages,
}

/// Returns the outcome of a wait without a timer, and whether a periodic wake-up has ended it.
fn untimed_wait(activity: Activity) -> (WaitOutcome, bool) {
    let Pair { here, system_name, .. } = &pair();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    let mut idle_waker = here.idle_waker();
    // The layout is that of `frozen_waiter_costs_one_system_call`.
    let wake_count = (64 * (1 + ImuSample::TOPIC.index)) as u64;
    let waiting = wake_count + size_of::<u32>() as u64;
    let path = format!("/dev/shm/plumbline.{}.wake", system_name.name());
    let file = fs::File::options().read(true).write(true).open(path).unwrap();
    let word = |at: u64| {
        let mut bytes = [0; 4];
        file.read_exact_at(&mut bytes, at).unwrap();
        u32::from_ne_bytes(bytes)
    };
    std::thread::scope(|scope| {
        let waiter = scope.spawn(|| {
            let there = Bus::join(system_name, "waiter").unwrap();
            there.subscriber::<ImuSample>(BUFFER).unwrap().wait(None)
        });
        while word(waiting) == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(20));
        if activity != Activity::Idle {
            file.write_all_at(&(word(wake_count) + 1).to_ne_bytes(), wake_count).unwrap();
            file.write_all_at(&0_u32.to_ne_bytes(), waiting).unwrap();
        }
        for _ in 0..100 {
            if activity == Activity::LostWakeAndMessages {
                publisher.wake();
            }
            idle_waker.wake();
            std::thread::sleep(Duration::from_millis(1));
        }
        // The thread of a subscriber that has been woken may take long to end on a loaded machine.
        let end = Instant::now() + TEST_TIMEOUT;
        while activity != Activity::LostWakeAndMessages && !waiter.is_finished() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
        let was_woken = waiter.is_finished();
        while !waiter.is_finished() {
            idle_waker.wake_after_exit();
            std::thread::sleep(Duration::from_millis(1));
        }
        (waiter.join().unwrap(), was_woken)
    })
}

#[test]
fn untimed_waits_are_ended() {
    assert_eq!(untimed_wait(Activity::Idle), (WaitOutcome::Idle, true));
    // On a loaded machine, the message may be counted before the subscriber sleeps.
    let outcome =
        |activity| (0..20).map(|_| untimed_wait(activity)).find(|(outcome, _)| *outcome != WaitOutcome::Published);
    assert_eq!(outcome(Activity::LostWake), Some((WaitOutcome::LateWake, true)));
    assert_eq!(outcome(Activity::LostWakeAndMessages), Some((WaitOutcome::LateWake, false)));
}

#[test]
fn wait_returns_immediately_with_messages() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), WaitOutcome::Idle);
    send(&publisher, 0..BUFFER as u64);
    publisher.wake();
    assert_eq!(subscriber.wait(TEST_TIMEOUT), WaitOutcome::Published, "the message is there already");
    subscriber.drain(BUFFER / 2, |_| ()).unwrap();
    assert_eq!(subscriber.wait(TEST_TIMEOUT), WaitOutcome::Published, "more messages may be left");
    subscriber.drain(BUFFER, |_| ()).unwrap();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), WaitOutcome::Idle);
}

mod extended {
    graph::topics!(graph::define_topics {}
        Pressure = "pressure": Pressure, no_tick, Control, services => [supervisor];
    );
}

/// Payload of the additional topic.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Pressure {
    pressure_pa: f64,
}

impl Message for Pressure {
    const TOPIC: &'static Entry = extended::Topic::Pressure.entry();
    const TYPE: &'static str = "plumbline.Pressure.1";

    fn layout() -> Layout {
        let fields = vec![Field { name: "pressure_pa", kind: "f64", offset: 0, description: "" }];
        Layout { name: Self::TYPE, size: 8, fields, topic: Some(Self::TOPIC.name), description: "", header_fields: 0 }
    }
}

#[test]
fn added_topic_has_its_own_wake_word_and_publishers() {
    let Pair { here, there, .. } = &pair();
    let subscriber = there.subscriber::<Pressure>(BUFFER).unwrap();
    let publishers: Vec<_> = (0..10).map(|_| here.publisher::<Pressure>(BUFFER).unwrap()).collect();
    let health = here.publisher::<Health>(BUFFER).unwrap();
    health.wake();
    assert_eq!(subscriber.wait(Duration::from_millis(5)), WaitOutcome::Idle, "another topic was woken");
    for (count, publisher) in publishers.iter().enumerate() {
        publisher.send(&Pressure { pressure_pa: count as f64 }).unwrap();
    }
    publishers[0].set_next_tick_after(41);
    publishers[0].wake();
    assert_eq!(subscriber.wait(TEST_TIMEOUT), WaitOutcome::Published);
    let mut sum_pa = 0.0;
    subscriber.drain(BUFFER, |message| sum_pa += message.pressure_pa).unwrap();
    assert_eq!((sum_pa, there.next_tick(Pressure::TOPIC), there.next_tick(Health::TOPIC)), (45.0, 42, 0));
}

/// `Reference` of a different build: the same name and size, but two struct fields swapped.
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
        let field = |name, kind, offset| Field { name, kind, offset, description: "" };
        let fields = vec![field("scored", "u64", 0), field("tick", "u64", 8), field("quaternion", "[f64; 4]", 16)];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC.name),
            description: "",
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
    const TYPE: &'static str = "plumbline.Reference.3";

    fn layout() -> Layout {
        let fields = vec![Field { name: "tick", kind: "u64", offset: 0, description: "" }];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC.name),
            description: "",
            header_fields: 0,
        }
    }
}

fn assert_names_both_layouts(error: &BusError, here: &Layout, there: &Layout) {
    assert!(matches!(error, BusError::LayoutMismatch { .. }), "{error:?}");
    let expected = format!(
        "opening the topic `reference`: the layout on the bus differs\n  here:  {here}\n  there: {there}\nrun a single version of plumb"
    );
    assert_eq!(error.to_string(), expected);
}

#[test]
fn buffer_mismatch_reports_required_size() {
    let Pair { here, there, .. } = &pair();
    let _publisher = here.publisher::<ImuSample>(BUFFER).unwrap();
    for error in [there.publisher::<ImuSample>(2000).unwrap_err(), there.subscriber::<ImuSample>(2000).unwrap_err()] {
        assert!(matches!(error, BusError::BufferMismatch { here: 2000, there: BUFFER, .. }), "{error:?}");
        let message = error.to_string();
        assert!(message.contains("`imu`") && message.contains("buffer_s x rate_hz of the launch file"), "{message}");
    }
    // A request for a smaller buffer uses the existing, larger one.
    there.publisher::<ImuSample>(BUFFER / 2).unwrap();
}

#[test]
fn layout_mismatch_reports_both_layouts() {
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
fn second_claim_names_the_owner() {
    let Pair { system_name, .. } = &pair();
    let error = system_name.claim().unwrap_err();
    let pid = std::process::id();
    assert!(matches!(error, BusError::NameInUse { .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains(&format!("process {pid}")) && text.contains(&format!("kill {pid}")), "{text}");
    assert!(text.contains("set another `name` in launch.toml"), "{text}");
}

#[test]
fn join_fails_if_system_is_not_running() {
    let system_name = system_name();
    let error = Bus::join(&system_name, "test").unwrap_err();
    assert!(matches!(error, BusError::NotRunning { .. }), "{error:?}");
    drop(system_name.claim().unwrap());
    assert!(matches!(Bus::join(&system_name, "test"), Err(BusError::NotRunning { .. })), "after the end of the system");
    assert_eq!(system_files(&system_name), Vec::<String>::new());
}

#[test]
fn system_name_rejects_invalid_characters() {
    for name in ["", "a.b", "a/b", "..", "Upper", "with space", "é", &"x".repeat(33)] {
        assert!(matches!(SystemName::new(name), Err(BusError::InvalidName { .. })), "{name:?}");
    }
    assert_eq!(SystemName::new(&"x".repeat(32)).unwrap().name().len(), 32);
}

#[test]
fn dropped_claim_removes_all_files() {
    let pair = pair();
    let system_name = pair.system_name.clone();
    let subscriber = pair.there.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = pair.here.publisher::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 0..3);
    assert!(system_files(&system_name).len() > 1);
    drop((subscriber, publisher, pair));
    assert_eq!(system_files(&system_name), Vec::<String>::new());
}

/// The command-line tests cover the case in which a real owner is killed.
#[test]
fn claim_removes_files_of_dead_owner() {
    let system_name = system_name();
    let prefix = format!("/dev/shm/plumbline.{}.", system_name.name());
    for file in ["wake", "0123.service", "4567.publisher"] {
        fs::write(prefix.clone() + file, "old").unwrap();
        fs::set_permissions(prefix.clone() + file, fs::Permissions::from_mode(0o600)).unwrap();
    }
    let services = PathBuf::from(format!("/dev/shm/plumbline.{}/services", system_name.name()));
    fs::create_dir_all(services.join("0123")).unwrap();
    let claim = system_name.claim().unwrap();
    let left = system_files(&system_name);
    assert!(!left.iter().any(|name| name.ends_with("0123.service") || name.ends_with("4567.publisher")), "{left:?}");
    assert!(!services.join("0123").exists());
    let bus = Bus::join(&system_name, "successor").unwrap();
    let subscriber = bus.subscriber::<ImuSample>(2 * BUFFER).unwrap();
    let publisher = bus.publisher::<ImuSample>(2 * BUFFER).unwrap();
    send(&publisher, 5..8);
    assert_eq!(ticks(&subscriber), [5, 6, 7]);
    drop((subscriber, publisher, bus, claim));
    assert_eq!(system_files(&system_name), Vec::<String>::new());
}

#[test]
fn claim_of_name_prefix_keeps_other_system() {
    let short = system_name();
    let long = SystemName::new(&format!("{}b", short.name())).unwrap();
    let long_claim = long.claim().unwrap();
    let bus = Bus::join(&long, "test").unwrap();
    let subscriber = bus.subscriber::<ImuSample>(BUFFER).unwrap();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let before = system_files(&long);
    drop(short.claim().unwrap());
    assert_eq!(system_files(&long), before);
    send(&publisher, 0..3);
    assert_eq!(ticks(&subscriber), [0, 1, 2]);
    let other = Bus::join(&long, "other").unwrap();
    let late = other.subscriber::<ImuSample>(BUFFER).unwrap();
    send(&publisher, 3..5);
    assert_eq!(ticks(&late), [3, 4]);
    drop((late, other, subscriber, publisher, bus, long_claim));
    assert_eq!(system_files(&long), Vec::<String>::new());
}

#[test]
fn claim_keeps_files_of_longer_names() {
    let system_name = system_name();
    let foreign = PathBuf::from(format!("/dev/shm/plumbline.{}x.test", system_name.name()));
    fs::write(&foreign, "").unwrap();
    drop(system_name.claim().unwrap());
    let there = foreign.exists();
    fs::remove_file(&foreign).unwrap();
    assert!(there);
}

/// Returns the permanent files of a system. Asserts that there is at least one of each kind.
fn permanent_files(system_name: &SystemName) -> Vec<PathBuf> {
    let folder = PathBuf::from("/dev/shm").join(format!("plumbline.{}", system_name.name())).join("services");
    let all = system_files(system_name).into_iter().map(|name| PathBuf::from("/dev/shm").join(name));
    let all = all.chain(fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
    let kinds = ["dynamic", "data", "global_mgmt", "service"];
    let all: Vec<_> =
        all.filter(|path| path.extension().is_some_and(|kind| kinds.iter().any(|k| kind == *k))).collect();
    assert!(kinds.iter().all(|kind| all.iter().any(|path| path.extension().is_some_and(|found| found == *kind))));
    all
}

#[test]
fn truncated_and_overwritten_permanent_files_are_found() {
    let system_name = system_name();
    let claim = system_name.claim().unwrap();
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    let subscriber = bus.subscriber::<ImuSample>(BUFFER).unwrap();
    let mut monitor = FileMonitor::default();
    for _ in 0..3 {
        assert_eq!(monitor.damaged_file(&system_name), None);
        send(&publisher, 0..5);
        assert_eq!(ticks(&subscriber), [0, 1, 2, 3, 4]);
    }
    let files = permanent_files(&system_name);
    // The damaged memory must not be used, so no message is sent after this point.
    for path in &files {
        let (content, mode) = (fs::read(path).unwrap(), fs::metadata(path).unwrap().permissions());
        let write = |content: &[u8]| {
            fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
            fs::write(path, content).unwrap();
            fs::set_permissions(path, mode.clone()).unwrap();
        };
        let mut overwritten = content.clone();
        overwritten[..8].fill(0x55);
        for damaged in [&overwritten[..], &content[..content.len() - 1], &[]] {
            write(damaged);
            assert_eq!(monitor.damaged_file(&system_name).as_ref(), Some(path), "{} bytes", damaged.len());
            write(&content);
            assert_eq!(monitor.damaged_file(&system_name), None);
        }
    }
    assert!(claim.has_intact_state());
    let state = fs::OpenOptions::new().write(true).open(system_name.shared_state_path()).unwrap();
    state.write_all_at(&[0x55; 64], 0).unwrap();
    assert!(!claim.has_intact_state());
    drop((subscriber, publisher, bus, claim));
}

#[test]
fn removed_files_are_found_after_checks_without_one() {
    let mut systems = ["dynamic", "data", "service", "wake", "members"].map(|kind| {
        let system_name = system_name();
        let claim = system_name.claim().unwrap();
        let bus = Bus::join(&system_name, "supervisor").unwrap();
        let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
        let path = match kind {
            "wake" => system_name.shared_state_path(),
            "members" => system_name.shared_state_path().with_extension(kind),
            _ => permanent_files(&system_name).into_iter().find(|path| path.extension().unwrap() == kind).unwrap(),
        };
        (FileMonitor::default(), system_name, path, (publisher, bus, claim))
    });
    for is_removed in [false, false, true, true] {
        // The folders have not changed for longer than the resolution of their times.
        std::thread::sleep(Duration::from_millis(250));
        for (monitor, system_name, path, _) in &mut systems {
            if is_removed && path.exists() {
                fs::remove_file(&path).unwrap();
            }
            let removed = monitor.removed_file(system_name, &[std::process::id()], false);
            assert_eq!(removed.as_ref(), Some(&*path).filter(|_| is_removed));
        }
    }
}

#[test]
fn unused_words_of_checkpoint_arrive_as_zeros() {
    let system_name = system_name();
    let claim = system_name.claim().unwrap();
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    let (publisher, subscriber) = (bus.publisher::<Checkpoint>(4).unwrap(), bus.subscriber::<Checkpoint>(4).unwrap());
    let tap = Observer::attach(&system_name, "test").unwrap().tap(Topic::Checkpoint).unwrap();
    for used_words in [3, CHECKPOINT_WORDS, 1, 0] {
        let mut checkpoint = Checkpoint { next_tick: 7, slot_words: used_words as u32, ..bytemuck::Zeroable::zeroed() };
        checkpoint.words[..used_words].fill(u64::MAX);
        publisher.send_checkpoint(&checkpoint).unwrap();
        let received = subscriber.receive().unwrap().unwrap();
        assert_eq!(bytemuck::bytes_of(&received), bytemuck::bytes_of(&checkpoint), "{used_words}");
        let mut tapped = Vec::new();
        tap.drain(&mut |bytes| tapped.push(bytes.to_vec())).unwrap();
        assert_eq!(tapped, [bytemuck::bytes_of(&checkpoint)], "{used_words}");
    }
    drop((tap, publisher, subscriber, bus, claim));
}

#[test]
fn renewed_claim_keeps_next_ticks() {
    let system_name = system_name();
    let claim = system_name.claim().unwrap();
    let driver = Bus::join(&system_name, "driver").unwrap();
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    let publisher = bus.publisher::<ImuSample>(BUFFER).unwrap();
    publisher.set_next_tick_after(41);
    let own = [std::process::id()];
    assert_eq!(system_name.removed_file(&own), None);
    for name in system_files(&system_name) {
        let path = PathBuf::from("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    assert!(system_name.removed_file(&own).is_some());
    drop((publisher, bus));
    let claim = claim.renew().unwrap();
    assert!(!driver.is_running(), "the driver has to join again");
    let bus = Bus::join(&system_name, "supervisor").unwrap();
    assert_eq!(bus.next_tick(ImuSample::TOPIC), 42);
    assert!(bus.is_running());
    assert!(system_name.removed_file(&own).is_some(), "the driver still has removed files open");
    drop(driver);
    assert_eq!(system_name.removed_file(&own), None);
    drop((bus, claim));
    assert_eq!(system_files(&system_name), Vec::<String>::new());
}
