//! Simulates senders that share a port, and checks which sender is chosen and for how long.
//!
//! The expected choice is computed from the record of all datagrams, not from the state of the
//! choice under test.

use std::time::Duration;

use decoders::{SENDER_TIMEOUT, SenderChoice};

use crate::random::Random;

/// Duration of a run, ms.
const RUN_MS: u64 = 30_000;

/// Behaviour of a sender.
#[derive(Debug)]
struct Sender {
    /// Time of the next datagram, ms.
    due_ms: u64,
    /// Maximum interval between two datagrams, ms.
    max_interval_ms: u64,
    /// Share of datagrams with a measurement, per mille.
    measurements_per_mille: u64,
    /// Share of datagrams that are followed by a pause of up to twice the timeout, per mille.
    pauses_per_mille: u64,
}

/// Simulates several senders.
///
/// # Errors
///
/// Fails if the wrong sender is chosen, if a datagram is wrongly admitted or refused, or if a
/// change of sender is wrongly reported.
pub(crate) fn simulate(seed: u64) -> Result<(), String> {
    let mut random = Random::new(seed ^ 0x5e4d);
    let timeout_ms = SENDER_TIMEOUT.as_millis() as u64;
    let mut senders: Vec<_> = (0..random.between(1, 5)).map(|_| sender(&mut random)).collect();
    let mut choice = SenderChoice::default();
    // Chosen sender, and the time of its last measurement in ms.
    let mut owner: Option<(usize, u64)> = None;
    loop {
        let next = senders.iter().enumerate().min_by_key(|(_, sender)| sender.due_ms);
        let Some((number, now_ms)) = next.map(|(number, sender)| (number, sender.due_ms)) else { return Ok(()) };
        if now_ms > RUN_MS {
            return Ok(());
        }
        let sender = &mut senders[number];
        let pauses = random.chance(sender.pauses_per_mille);
        sender.due_ms += if pauses {
            random.between(timeout_ms / 2, 2 * timeout_ms)
        } else {
            random.between(0, sender.max_interval_ms)
        };
        let has_measurement = random.chance(sender.measurements_per_mille);
        let now = Duration::from_millis(now_ms);
        let holder = owner.filter(|(_, at_ms)| now_ms < at_ms + timeout_ms).map(|(holder, _)| holder);
        let found = choice.chosen(now);
        if found != holder {
            return Err(format!("at {now_ms} ms sender {found:?} is chosen instead of {holder:?}"));
        }
        let is_expected = holder.is_none_or(|holder| holder == number);
        if choice.admits(number, now) != is_expected {
            return Err(format!("at {now_ms} ms sender {number} is wrongly admitted or refused beside {holder:?}"));
        }
        if has_measurement {
            let is_new = is_expected && owner.is_none_or(|(last, _)| last != number);
            if choice.confirm(number, now) != is_new {
                return Err(format!("at {now_ms} ms the change from {owner:?} to sender {number} is wrongly reported"));
            }
            if is_expected {
                owner = Some((number, now_ms));
            }
        }
    }
}

fn sender(random: &mut Random) -> Sender {
    Sender {
        due_ms: random.between(0, 5000),
        max_interval_ms: random.pick(&[5, 50, 1000, 1999]),
        measurements_per_mille: random.pick(&[0, 0, 10, 500, 1000]),
        pauses_per_mille: random.pick(&[0, 5, 100]),
    }
}
