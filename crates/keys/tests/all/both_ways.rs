//! A secured link in both directions at once: nothing is lost and no byte is another.
use std::time::Duration;

use crate::common::{Site, until};
use zenoh::{Wait, qos::CongestionControl};

const KEY: &str = "plumbline/v1/alpha/attitude";
/// Several records of TLS, and several batches of Zenoh.
const BYTES: usize = 256 * 1024;
const MESSAGES: usize = 400;
const LIMIT: Duration = Duration::from_secs(60);

/// A message as whoever gets it can check it.
fn message(number: usize) -> Vec<u8> {
    let first = number as u64 * 0x9e37_79b9_7f4a_7c15;
    (0..BYTES as u64 / 8).flat_map(|word| (first ^ word.wrapping_mul(0xff51_afd7_ed55_8ccd)).to_le_bytes()).collect()
}

#[test]
fn what_goes_both_ways_at_once_over_a_secured_link_arrives_whole() {
    let site = Site::new(&["viewer.wall"]);
    site.keys.issue(&"vehicle.alpha".parse().unwrap(), &["127.0.0.1".parse().unwrap()], &[], 30, false).unwrap();
    let alpha = site.listening("vehicle.alpha");
    let viewer = site.session("viewer.wall");
    let heard = viewer.declare_subscriber(KEY).wait().unwrap();
    let asked = alpha.declare_queryable(KEY).wait().unwrap();
    until("a first message", || {
        alpha.put(KEY, "first").wait().unwrap();
        heard.recv_timeout(Duration::from_millis(50)).unwrap().is_some()
    });
    while heard.recv_timeout(Duration::from_millis(200)).unwrap().is_some() {}

    std::thread::scope(|scope| {
        scope.spawn(|| {
            for number in 0..MESSAGES {
                alpha.put(KEY, message(number)).congestion_control(CongestionControl::Block).wait().unwrap();
            }
        });
        scope.spawn(|| {
            for number in 0..MESSAGES {
                let question = asked.recv_timeout(LIMIT).unwrap().unwrap();
                assert!(question.payload().unwrap().to_bytes() == message(number), "question {number}");
                question.reply(KEY, number.to_le_bytes()).wait().unwrap();
            }
        });
        scope.spawn(|| {
            for number in 0..MESSAGES {
                let sample = heard.recv_timeout(LIMIT).unwrap().unwrap();
                assert!(sample.payload().to_bytes() == message(number), "message {number}");
            }
        });
        for number in 0..MESSAGES {
            let replies = viewer.get(KEY).payload(message(number)).timeout(LIMIT).wait().unwrap();
            let reply = replies.recv().unwrap().into_result().unwrap();
            assert_eq!(*reply.payload().to_bytes(), number.to_le_bytes());
        }
    });
}
