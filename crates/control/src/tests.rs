//! Tests of a control socket and its clients.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{
    cell::Cell,
    fs,
    io::{ErrorKind, Read, Write},
    os::unix::{
        fs::PermissionsExt,
        net::{UnixListener, UnixStream},
    },
    path::Path,
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::Instant,
};

use bus::{Claim, SystemName};
use graph::StageConfig;

use super::{client::connect_socket, *};

/// Control socket of a claimed system that no other test uses.
struct TestSystem(
    SystemName,
    String,
    ControlSocket,
    #[expect(dead_code, reason = "held until the end of the test")] Claim,
);

impl TestSystem {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-control-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let system_name = SystemName::new(&name).unwrap();
        let claim = system_name.claim().unwrap();
        let socket = ControlSocket::open(&system_name).unwrap();
        Self(system_name, name, socket, claim)
    }

    fn client(&self) -> UnixStream {
        let client = UnixStream::connect(self.0.control_socket_path().unwrap()).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        client
    }

    /// Responds to requests with 7 while `run` executes. Swaps are acknowledged but never
    /// completed.
    fn serve_during(&mut self, run: impl FnOnce(&str) + Send) {
        let Self(_, name, socket, _) = self;
        thread::scope(|scope| {
            let running = scope.spawn(|| run(name));
            while !running.is_finished() {
                for (client, request) in socket.poll_requests() {
                    if !is_long_running(&request) {
                        socket.respond(client, &7);
                    }
                }
                thread::sleep(Duration::from_millis(5));
            }
        });
    }
}

fn shadow() -> ControlRequest {
    let stage = StageConfig { stage: "vqf".into(), set: Default::default() };
    ControlRequest::Swap(SwapRequest {
        slot: "fuser".into(),
        stage,
        shadow: true,
        expected_epoch: None,
        timeout_ms: None,
    })
}

#[test]
fn silent_clients_are_disconnected_after_timeout() {
    let mut system = TestSystem::new();
    let silent: Vec<_> = (0..server::MAX_CLIENTS).map(|_| system.client()).collect();
    system.serve_during(|name| {
        let full = send_request::<u32>(name, &ControlRequest::Status).unwrap_err();
        assert!(full.to_string().contains("16 other clients are waiting"), "{full}");
        thread::sleep(server::REQUEST_TIMEOUT);
        let came = Instant::now();
        while send_request::<u32>(name, &ControlRequest::Status).is_err() {
            assert!(came.elapsed() < Duration::from_secs(60), "the silent clients are still connected");
        }
    });
    drop(silent);
}

#[test]
fn incomplete_requests_are_rejected() {
    let mut system = TestSystem::new();
    let mut client = system.client();
    writeln!(client, "\"ps").unwrap();
    let mut half = system.client();
    write!(half, "\"p").unwrap();
    system.serve_during(|_| {
        let mut text = String::new();
        client.read_to_string(&mut text).unwrap();
        assert!(text.contains("invalid request"), "{text}");
        text.clear();
        half.read_to_string(&mut text).unwrap();
        assert_eq!(text, "");
    });
}

#[test]
fn waiting_client_stays_connected() {
    let mut system = TestSystem::new();
    let mut waiting = system.client();
    writeln!(waiting, "{}", serde_json::to_string(&shadow()).unwrap()).unwrap();
    system.serve_during(|_| thread::sleep(2 * server::REQUEST_TIMEOUT));
    system.2.respond(1, &7);
    let mut text = String::new();
    waiting.read_to_string(&mut text).unwrap();
    assert_eq!(text, "\"accepted\"\n{\"completed\":7}\n");
}

#[test]
fn frozen_supervisor_times_out_and_drops_requests() {
    let mut system = TestSystem::new();
    thread::scope(|scope| {
        for request in [ControlRequest::Status, ControlRequest::ServiceConfig, shadow()] {
            let name = &system.1;
            scope.spawn(move || {
                let error = send_request::<u32>(name, &request).unwrap_err();
                assert!(matches!(error, ControlError::Timeout { .. }), "{error}");
            });
        }
    });
    assert_eq!(system.2.poll_requests(), []);
}

#[test]
fn full_queue_fails_without_blocking() {
    let system = TestSystem::new();
    let full = (0..100_000).find_map(|_| connect_socket(&system.0.control_socket_path().unwrap()).err()).unwrap();
    assert_eq!(full.kind(), ErrorKind::WouldBlock, "{full}");
    let error = send_request::<u32>(&system.1, &ControlRequest::Status).unwrap_err();
    assert!(error.to_string().contains("too many clients are waiting"), "{error}");
}

#[test]
fn client_of_an_ended_supervisor_finds_it_not_running() {
    let system = TestSystem::new();
    let path = system.0.control_socket_path().unwrap();
    thread::scope(|scope| {
        let client = scope.spawn(|| send_request::<u32>(&system.1, &ControlRequest::Status).unwrap_err());
        // The kernel lists the path once for the listener and once for the waiting connection.
        let sockets = || std::fs::read_to_string("/proc/net/unix").unwrap();
        while sockets().matches(path.to_str().unwrap()).count() < 2 {
            thread::yield_now();
        }
        drop(system.2);
        let error = client.join().unwrap();
        assert!(matches!(error, ControlError::NotRunning { .. }), "{error}");
    });
}

#[test]
fn notification_is_repeated_until_it_is_answered() {
    let mut system = TestSystem::new();
    let TestSystem(_, name, socket, _) = &mut system;
    let mut requests = 0;
    thread::scope(|scope| {
        let sender = scope.spawn(|| notify(name, &ControlRequest::Status, || false));
        while !sender.is_finished() {
            for (client, _) in socket.poll_requests() {
                requests += 1;
                // The first response has the wrong type.
                if requests == 1 { socket.respond(client, &7) } else { socket.respond(client, &()) }
            }
            thread::sleep(Duration::from_millis(5));
        }
    });
    assert!(requests >= 2, "{requests}");
}

#[test]
fn notification_ends_with_its_sender() {
    let attempts = Cell::new(0);
    notify("test-control-absent", &ControlRequest::Status, || {
        attempts.set(attempts.get() + 1);
        attempts.get() == 3
    });
    assert_eq!(attempts.get(), 3);
}

#[test]
fn removed_and_replaced_sockets_are_opened_again() {
    let mut system = TestSystem::new();
    let path = system.0.control_socket_path().unwrap();
    let replace: [fn(&Path); 4] = [
        |_| {},
        |path| fs::write(path, "not a socket").unwrap(),
        |path| drop(UnixListener::bind(path).unwrap()),
        |path| fs::create_dir(path).unwrap(),
    ];
    assert!(!system.2.reopen_if_missing(&system.0).unwrap());
    for replace in replace {
        let waiting = system.client();
        system.2.poll_requests();
        fs::remove_file(&path).unwrap();
        replace(&path);
        assert!(system.2.reopen_if_missing(&system.0).unwrap());
        assert!(!system.2.reopen_if_missing(&system.0).unwrap());
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        system.serve_during(|name| assert_eq!(send_request::<u32>(name, &ControlRequest::Status).unwrap(), 7));
        drop(waiting);
    }
}
