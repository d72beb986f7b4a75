//! Secured link under load in both directions: no message is lost or changed.
use std::{
    sync::LazyLock,
    thread,
    time::{Duration, Instant},
};

use super::site::{Site, wait_for};
use zenoh::{Session, Wait, handlers::FifoChannelHandler, pubsub::Subscriber, qos::CongestionControl, sample::Sample};

const TO_BETA: &str = "plumbline/v1/alpha/@carry";
const TO_ALPHA: &str = "plumbline/v1/beta/@carry";
/// Message size in bytes. Each message needs many packets and several Zenoh batches.
const MESSAGE_BYTES: usize = 256 * 1024;
const DURATION: Duration = Duration::from_secs(60);
/// Number of messages per burst. A burst is sent as fast as the link accepts it, so that both
/// directions are saturated.
const BURST_MESSAGES: u64 = 24;
/// Interval between the starts of two bursts, which leaves time for other work on this machine.
const BURST_INTERVAL: Duration = Duration::from_millis(500);
const RECEIVE_TIMEOUT: Duration = Duration::from_secs(60);

/// Pseudo-random bytes. Each message is a slice of this buffer.
static NOISE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let word = |word: u64| (word.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ word.rotate_left(17)).to_le_bytes();
    (1..=2 * MESSAGE_BYTES as u64 / 8).flat_map(word).collect()
});

type SampleSubscriber = Subscriber<FifoChannelHandler<Sample>>;

/// Returns the message with the given number. No two messages in a run are equal.
fn message(number: u64) -> &'static [u8] {
    let start = (number.wrapping_mul(0xff51_afd7_ed55_8ccd) % MESSAGE_BYTES as u64) as usize;
    &NOISE[start..][..MESSAGE_BYTES]
}

/// Waits until messages arrive, then discards those still in transit.
fn wait_for_route(from: &Session, key: &str, subscriber: &SampleSubscriber) {
    wait_for("a first message", || {
        from.put(key, "first").wait().unwrap();
        subscriber.recv_timeout(Duration::from_millis(50)).unwrap().is_some()
    });
    while subscriber.recv_timeout(Duration::from_millis(500)).unwrap().is_some() {}
}

/// Sends messages for `DURATION` and returns their number. An empty message marks the end.
fn send_messages(to: &Session, key: &str) -> u64 {
    let started_at = Instant::now();
    let send = |bytes: &[u8]| to.put(key, bytes).congestion_control(CongestionControl::Block).wait().unwrap();
    let mut number = 0;
    while started_at.elapsed() < DURATION {
        (number..number + BURST_MESSAGES).for_each(|number| send(message(number)));
        number += BURST_MESSAGES;
        thread::sleep((BURST_INTERVAL * (number / BURST_MESSAGES) as u32).saturating_sub(started_at.elapsed()));
    }
    send(&[]);
    number
}

/// Receives and checks messages until the empty message arrives, and returns their number.
fn receive_messages(subscriber: &SampleSubscriber) -> u64 {
    for number in 0.. {
        let sample = subscriber.recv_timeout(RECEIVE_TIMEOUT).unwrap().unwrap();
        if sample.payload().is_empty() {
            return number;
        }
        assert!(sample.payload().to_bytes() == message(number), "message {number}");
    }
    unreachable!("the loop returns at the empty message")
}

#[test]
fn saturated_secured_link_delivers_all_messages() {
    let site = Site::new(&[]);
    let [alpha, beta] = ["vehicle.alpha", "vehicle.beta"].map(|party| party.parse().unwrap());
    let hosts = ["127.0.0.1".parse().unwrap()];
    site.keys.issue(&alpha, &hosts, &[], 30, false).unwrap();
    site.keys.issue(&beta, &[], std::slice::from_ref(&alpha), 30, false).unwrap();
    // Each vehicle may import what the other vehicle exports.
    site.keys.issue(&alpha, &hosts, &[beta], 30, true).unwrap();
    let (alpha, beta) = (site.listening("vehicle.alpha"), site.session("vehicle.beta"));
    let at_beta: SampleSubscriber = beta.declare_subscriber(TO_BETA).wait().unwrap();
    let at_alpha: SampleSubscriber = alpha.declare_subscriber(TO_ALPHA).wait().unwrap();
    wait_for_route(&alpha, TO_BETA, &at_beta);
    wait_for_route(&beta, TO_ALPHA, &at_alpha);

    thread::scope(|scope| {
        let received = [&at_beta, &at_alpha].map(|subscriber| scope.spawn(|| receive_messages(subscriber)));
        let sent = [(&alpha, TO_BETA), (&beta, TO_ALPHA)].map(|(from, key)| scope.spawn(|| send_messages(from, key)));
        let sent = sent.map(|thread| thread.join().unwrap());
        println!("{sent:?} messages of {MESSAGE_BYTES} bytes, {BURST_MESSAGES} per burst");
        assert_eq!(received.map(|thread| thread.join().unwrap()), sent);
        assert!(sent.iter().all(|number| *number > 4 * BURST_MESSAGES), "{sent:?}");
    });
}
