//! Subscription over a link with delay. Messages that a vehicle sends before it receives the
//! subscription do not count as lost.
use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use crate::common::{remote::free_port, wait_for};
use link::{Endpoints, Link};
use remote::fleet::FleetMonitor;
use wire::{
    command::ControlMessage,
    keys,
    v1::{Envelope, GatewayReport},
};

/// Delay of the link in each direction.
const DELAY: Duration = Duration::from_millis(100);
/// Interval between two messages of the vehicle.
const INTERVAL: Duration = Duration::from_millis(1);
/// Maximum number of messages of the vehicle.
const MAX_MESSAGES: u64 = 100_000;

/// Forwards one TCP connection to `port` with a delay, and returns the port to connect to.
fn delayed(port: u16) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let delayed_port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        let (near, _) = listener.accept().unwrap();
        let far = TcpStream::connect(("127.0.0.1", port)).unwrap();
        forward(near.try_clone().unwrap(), far.try_clone().unwrap());
        forward(far, near);
    });
    delayed_port
}

fn forward(mut from: TcpStream, mut to: TcpStream) {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        let mut buffer = [0; 65536];
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            if sender.send((Instant::now() + DELAY, buffer[..count].to_vec())).is_err() {
                break;
            }
        }
    });
    thread::spawn(move || {
        for (due, bytes) in receiver {
            thread::sleep(due.saturating_duration_since(Instant::now()));
            if to.write_all(&bytes).is_err() {
                break;
            }
        }
        // The other end may have closed the connection already.
        let _ = to.shutdown(Shutdown::Both);
    });
}

#[test]
fn messages_before_subscription_do_not_count_as_lost() {
    let key = keys::key("boat", keys::GATEWAY);
    let report = |sequence| {
        let envelope = Envelope { sequence, start_ns: 1, samples_before: sequence, ..Envelope::default() };
        GatewayReport { envelope: Some(envelope), ..GatewayReport::default() }.to_bytes()
    };
    let port = free_port();
    let endpoint = |port| format!("tcp/127.0.0.1:{port}");
    let vehicle = Link::open(&Endpoints { listen: vec![endpoint(port)], ..Endpoints::default() }).unwrap();
    let _handler = vehicle.handle_queries(&key, {
        let key = key.clone();
        move |query| query.reply(&key, GatewayReport::NAME, report(0))
    });
    let publisher = vehicle.publisher(&key, GatewayReport::NAME).unwrap();
    let (sent, is_finished) = (AtomicU64::new(0), AtomicBool::new(false));
    let monitor = thread::scope(|scope| {
        scope.spawn(|| {
            for sequence in (0..MAX_MESSAGES).take_while(|_| !is_finished.load(Ordering::SeqCst)) {
                publisher.send(&report(sequence)).unwrap();
                sent.store(sequence, Ordering::SeqCst);
                thread::sleep(INTERVAL);
            }
        });
        let station = Link::open(&Endpoints::with_connect(&[endpoint(delayed(port))])).unwrap();
        wait_for("the connection", || station.peer_count() > 0);
        let connected = sent.load(Ordering::SeqCst);
        wait_for("messages before the subscription", || sent.load(Ordering::SeqCst) > connected + 10);
        let mut monitor = FleetMonitor::open(&station, &["*"], None).unwrap();
        wait_for("messages after the subscription", || {
            monitor.poll().unwrap();
            monitor.vehicles.get("boat").is_some_and(|boat| boat.messages() > 200)
        });
        is_finished.store(true, Ordering::SeqCst);
        monitor
    });
    let tracker = &monitor.vehicles["boat"].trackers[keys::GATEWAY];
    assert_eq!((tracker.lost_messages, tracker.repeated), (0, 0), "{tracker:?}");
}
