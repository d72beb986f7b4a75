//! A control socket and who connects to it.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{
    io::{ErrorKind, Read, Write},
    os::unix::net::UnixStream,
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::Instant,
};

use bus::{Claim, SystemName};
use launch::Stage;

use super::{client::connect_to, *};

/// A control socket of a system of its own, which goes with the test.
struct House(SystemName, String, ControlSocket, #[expect(dead_code, reason = "it is held")] Claim);

impl House {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-door-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let system_name = SystemName::new(&name).unwrap();
        let claim = system_name.claim().unwrap();
        let door = ControlSocket::open(&system_name).unwrap();
        Self(system_name, name, door, claim)
    }

    fn caller(&self) -> UnixStream {
        let caller = UnixStream::connect(self.0.door().unwrap()).unwrap();
        caller.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        caller
    }

    /// What is asked meanwhile gets this answer, but for a swap, which waits.
    fn open_for(&mut self, ask: impl FnOnce(&str) + Send) {
        let Self(_, name, door, _) = self;
        thread::scope(|scope| {
            let asking = scope.spawn(|| ask(name));
            while !asking.is_finished() {
                for (caller, question) in door.requests() {
                    if !takes_time(&question) {
                        door.answer(caller, &7);
                    }
                }
                thread::sleep(Duration::from_millis(5));
            }
        });
    }
}

fn shadow() -> ControlRequest {
    let stage = Stage { stage: "vqf".into(), set: Default::default() };
    ControlRequest::Swap(SwapRequest {
        slot: "fuser".into(),
        stage,
        shadow: true,
        expected_epoch: None,
        limit_ms: None,
    })
}

#[test]
fn callers_who_say_nothing_are_sent_away_and_the_others_are_told_so_until_then() {
    let mut house = House::new();
    let silent: Vec<_> = (0..server::CALLERS_MAX).map(|_| house.caller()).collect();
    house.open_for(|name| {
        let full = ask::<u32>(name, &ControlRequest::Ps).unwrap_err();
        assert!(full.to_string().contains("16 others wait"), "{full}");
        thread::sleep(server::QUESTION_LIMIT);
        let came = Instant::now();
        while ask::<u32>(name, &ControlRequest::Ps).is_err() {
            assert!(came.elapsed() < Duration::from_secs(60), "they are still there");
        }
    });
    drop(silent);
}

#[test]
fn half_a_question_is_none() {
    let mut house = House::new();
    let mut caller = house.caller();
    writeln!(caller, "\"ps").unwrap();
    let mut half = house.caller();
    write!(half, "\"p").unwrap();
    house.open_for(|_| {
        let mut said = String::new();
        caller.read_to_string(&mut said).unwrap();
        assert!(said.contains("no question"), "{said}");
        said.clear();
        half.read_to_string(&mut said).unwrap();
        assert_eq!(said, "");
    });
}

#[test]
fn whoever_waits_for_an_answer_stays() {
    let mut house = House::new();
    let mut waiting = house.caller();
    writeln!(waiting, "{}", serde_json::to_string(&shadow()).unwrap()).unwrap();
    house.open_for(|_| thread::sleep(2 * server::QUESTION_LIMIT));
    house.2.answer(1, &7);
    let mut said = String::new();
    waiting.read_to_string(&mut said).unwrap();
    assert_eq!(said, "\"taken\"\n{\"answer\":7}\n");
}

#[test]
fn a_supervisor_that_says_nothing_is_not_waited_for_and_does_not_do_it_later() {
    let mut house = House::new();
    thread::scope(|scope| {
        for question in [ControlRequest::Ps, ControlRequest::ServiceConfig, shadow()] {
            let name = &house.1;
            scope.spawn(move || {
                let error = ask::<u32>(name, &question).unwrap_err();
                assert!(matches!(error, ControlError::Silent { .. }), "{error}");
            });
        }
    });
    assert_eq!(house.2.requests(), []);
}

#[test]
fn nobody_waits_to_be_let_wait() {
    let house = House::new();
    let full = (0..100_000).find_map(|_| connect_to(&house.0.door().unwrap()).err()).unwrap();
    assert_eq!(full.kind(), ErrorKind::WouldBlock, "{full}");
    let error = ask::<u32>(&house.1, &ControlRequest::Ps).unwrap_err();
    assert!(error.to_string().contains("too many wait"), "{error}");
}
