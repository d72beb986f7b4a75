//! A secured link in both directions at once: nothing is lost and no byte is another.
use std::{
    sync::LazyLock,
    thread,
    time::{Duration, Instant},
};

use super::site::{Site, until};
use zenoh::{Session, Wait, handlers::FifoChannelHandler, pubsub::Subscriber, qos::CongestionControl, sample::Sample};

const TO_BETA: &str = "plumbline/v1/alpha/@carry";
const TO_ALPHA: &str = "plumbline/v1/beta/@carry";
/// Many packets, and several batches of Zenoh.
const BYTES: usize = 256 * 1024;
const DURATION: Duration = Duration::from_secs(60);
/// As fast as the link takes them, so that both directions are full at once.
const BURST: u64 = 24;
/// From one burst to the next: what else this machine does has its turn.
const BURST_EVERY: Duration = Duration::from_millis(500);
const LIMIT: Duration = Duration::from_secs(60);

/// What all messages are cut from.
static NOISE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let word = |word: u64| (word.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ word.rotate_left(17)).to_le_bytes();
    (1..=2 * BYTES as u64 / 8).flat_map(word).collect()
});

type Heard = Subscriber<FifoChannelHandler<Sample>>;

/// A message as whoever gets it can check it: no two of a run are the same.
fn message(number: u64) -> &'static [u8] {
    let begin = (number.wrapping_mul(0xff51_afd7_ed55_8ccd) % BYTES as u64) as usize;
    &NOISE[begin..][..BYTES]
}

/// Waits until what is put is heard, and nothing of it is left.
fn begin(from: &Session, key: &str, heard: &Heard) {
    until("a first message", || {
        from.put(key, "first").wait().unwrap();
        heard.recv_timeout(Duration::from_millis(50)).unwrap().is_some()
    });
    while heard.recv_timeout(Duration::from_millis(500)).unwrap().is_some() {}
}

/// How many were put; the last is followed by an empty one.
fn put(to: &Session, key: &str) -> u64 {
    let began = Instant::now();
    let put = |bytes: &[u8]| to.put(key, bytes).congestion_control(CongestionControl::Block).wait().unwrap();
    let mut number = 0;
    while began.elapsed() < DURATION {
        (number..number + BURST).for_each(|number| put(message(number)));
        number += BURST;
        thread::sleep((BURST_EVERY * (number / BURST) as u32).saturating_sub(began.elapsed()));
    }
    put(&[]);
    number
}

/// How many came, each as it was put.
fn take(heard: &Heard) -> u64 {
    for number in 0.. {
        let sample = heard.recv_timeout(LIMIT).unwrap().unwrap();
        if sample.payload().is_empty() {
            return number;
        }
        assert!(sample.payload().to_bytes() == message(number), "message {number}");
    }
    unreachable!("the numbers do not end")
}

#[test]
fn what_goes_both_ways_at_once_over_a_secured_link_arrives_whole() {
    let site = Site::new(&[]);
    let [alpha, beta] = ["vehicle.alpha", "vehicle.beta"].map(|party| party.parse().unwrap());
    let here = ["127.0.0.1".parse().unwrap()];
    site.keys.issue(&alpha, &here, &[], 30, false).unwrap();
    site.keys.issue(&beta, &[], std::slice::from_ref(&alpha), 30, false).unwrap();
    // Each takes what the other carries.
    site.keys.issue(&alpha, &here, &[beta], 30, true).unwrap();
    let (alpha, beta) = (site.listening("vehicle.alpha"), site.session("vehicle.beta"));
    let at_beta: Heard = beta.declare_subscriber(TO_BETA).wait().unwrap();
    let at_alpha: Heard = alpha.declare_subscriber(TO_ALPHA).wait().unwrap();
    begin(&alpha, TO_BETA, &at_beta);
    begin(&beta, TO_ALPHA, &at_alpha);

    thread::scope(|scope| {
        let taken = [&at_beta, &at_alpha].map(|heard| scope.spawn(|| take(heard)));
        let sent = [(&alpha, TO_BETA), (&beta, TO_ALPHA)].map(|(from, key)| scope.spawn(|| put(from, key)));
        let sent = sent.map(|thread| thread.join().unwrap());
        println!("{sent:?} messages of {BYTES} bytes, {BURST} at once");
        assert_eq!(taken.map(|thread| thread.join().unwrap()), sent);
        assert!(sent.iter().all(|number| *number > 4 * BURST), "{sent:?}");
    });
}
