//! Time to encode and decode a message.
//!
//! Command: `cargo bench -p kernels --bench wire_time [-- ROUNDS]`.
//!
//! Input: messages in their bus layout.
//!
//! Output: the encoded length in bytes, and the nanoseconds to encode a payload and to decode and
//! validate it.
//!
//! Time: CPU time of this thread, as medians over interleaved rounds.

mod examples;
#[path = "../common/median.rs"]
mod median;
#[path = "../common/thread_time.rs"]
mod thread_time;

use std::{env, hint::black_box};

use messages::{AttitudeOutput, FusedState, Health, ImuSample};
use wire::Payload;

use examples::{Example, envelope};
use median::median;
use thread_time::thread_cpu_ns;

const ROUNDS: usize = 31;
/// Number of messages per measurement.
const MESSAGES: u64 = 2000;

/// Row of the output table, with its measurements.
struct Row {
    name: &'static str,
    round: fn(u64) -> Ns,
    samples: u64,
    bytes: usize,
    rounds: Vec<Ns>,
}

/// Times per message, ns.
#[derive(Clone, Copy)]
struct Ns {
    encode: f64,
    decode: f64,
}

fn main() {
    let rounds = env::args().filter_map(|argument| argument.parse().ok()).next().unwrap_or(ROUNDS);
    let mut rows = [
        row::<AttitudeOutput>("attitude", 1),
        row::<AttitudeOutput>("attitude, 5 per message", 5),
        row::<FusedState>("fused", 1),
        row::<ImuSample>("imu", 1),
        row::<Health>("health", 1),
    ];
    for _ in 0..rounds {
        rows.iter_mut().for_each(|row| row.rounds.push((row.round)(row.samples)));
    }
    println!("| message | bytes | encode, ns | decode, ns |\n| --- | --- | --- | --- |");
    for Row { name, bytes, rounds, .. } in &rows {
        let median = |pick: fn(&Ns) -> f64| median(rounds.iter().map(pick));
        println!("| {name} | {bytes} | {:.0} | {:.0} |", median(|ns| ns.encode), median(|ns| ns.decode));
    }
}

fn row<M: Payload + Example>(name: &'static str, samples: u64) -> Row {
    let messages: Vec<M> = (0..samples).map(M::example).collect();
    let bytes = wire::encode_batch(&envelope(), &wire::encode_samples(&messages)).len();
    Row { name, round: round::<M>, samples, bytes, rounds: Vec::new() }
}

fn round<M: Payload + Example>(samples: u64) -> Ns {
    let batches: Vec<Vec<M>> = (0..MESSAGES).map(|_| (0..samples).map(M::example).collect()).collect();
    let start_ns = thread_cpu_ns();
    let encoded: Vec<_> =
        batches.iter().map(|batch| wire::encode_batch(&envelope(), &wire::encode_samples(batch))).collect();
    let encoded_ns = thread_cpu_ns();
    for bytes in &encoded {
        black_box(wire::decode_batch::<M>(bytes).expect("the bytes were encoded here"));
    }
    let per_message = |ns: i64| ns as f64 / MESSAGES as f64;
    Ns { encode: per_message(encoded_ns - start_ns), decode: per_message(thread_cpu_ns() - encoded_ns) }
}
