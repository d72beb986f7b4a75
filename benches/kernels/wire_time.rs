//! Time of a message's way onto the wire and off it: `cargo bench -p kernels --bench wire_time [-- ROUNDS]`.
//!
//! Input: messages as they are on the bus. Output: nanoseconds from the payload to the bytes that go out and from the bytes to checked
//! payloads, and the bytes. Time: CPU time of this thread, medians of interleaved rounds. Failure: none.

mod drawn;
#[path = "../common/median.rs"]
mod median;
#[path = "../common/own_time.rs"]
mod own_time;

use std::{env, hint::black_box};

use messages::{AttitudeOutput, FusedState, Health, ImuSample};
use wire::Payload;

use drawn::{Drawn, envelope};
use median::median;
use own_time::cpu_ns;

const ROUNDS: usize = 31;
/// Messages timed together.
const MESSAGES: u64 = 2000;

/// A row of the table.
struct Row {
    name: &'static str,
    round: fn(u64) -> Ns,
    samples: u64,
    bytes: usize,
    rounds: Vec<Ns>,
}

/// Of one message, ns.
#[derive(Clone, Copy)]
struct Ns {
    encode: f64,
    decode: f64,
}

fn main() {
    let rounds = env::args().filter_map(|argument| argument.parse().ok()).next().unwrap_or(ROUNDS);
    let mut rows = [
        row::<AttitudeOutput>("attitude", 1),
        row::<AttitudeOutput>("attitude, 5 to a message", 5),
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

fn row<M: Payload + Drawn>(name: &'static str, samples: u64) -> Row {
    let messages: Vec<M> = (0..samples).map(M::drawn).collect();
    let bytes = wire::encode_batch(&envelope(), &wire::encode_samples(&messages)).len();
    Row { name, round: round::<M>, samples, bytes, rounds: Vec::new() }
}

fn round<M: Payload + Drawn>(samples: u64) -> Ns {
    let batches: Vec<Vec<M>> = (0..MESSAGES).map(|_| (0..samples).map(M::drawn).collect()).collect();
    let start_ns = cpu_ns();
    let encoded: Vec<_> = batches.iter().map(|batch| wire::encode_batch(&envelope(), &wire::encode_samples(batch))).collect();
    let encoded_ns = cpu_ns();
    for bytes in &encoded {
        black_box(wire::decode_batch::<M>(bytes).expect("what was encoded here"));
    }
    let of_one = |ns: i64| ns as f64 / MESSAGES as f64;
    Ns { encode: of_one(encoded_ns - start_ns), decode: of_one(cpu_ns() - encoded_ns) }
}
