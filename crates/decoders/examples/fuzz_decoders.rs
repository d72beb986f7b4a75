//! Feeds damaged streams to every decoder: `cargo run --release -p decoders --example fuzz_decoders
//! -- 1000000 [SEED]` runs a million cases per format.
//!
//! Valid units (frames or lines) are truncated, spliced, extended and rotated, and their bits and
//! bytes are changed. The decoder receives the stream twice: as a whole and in chunks. Both results
//! must be equal, every byte must be accounted for, and the intact units after the damage must be
//! decoded. The program prints totals. A panic ends it with an error.
#![allow(clippy::unwrap_used, reason = "the fuzzer detects panics")]

#[allow(dead_code, reason = "tests use more of it")]
#[path = "../tests/all/streams.rs"]
mod streams;

use std::time::Instant;

use decoders::{Counts, Measurement};
use streams::{Stream, decoded};

/// Number of units per stream. The last [`INTACT_UNITS`] of them are not damaged.
const UNITS: u32 = 8;
const INTACT_UNITS: usize = 4;
/// Number of zero bytes that suffices to complete any false frame, even one of the maximum length.
const FLUSH_BYTES: usize = 8300;

fn main() {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<u64>().unwrap());
    let (executions, seed) = (arguments.next().unwrap_or(1_000_000), arguments.next().unwrap_or(1));
    for stream in streams::all(UNITS) {
        let (start, mut rng) = (Instant::now(), FuzzRng(seed));
        let mut sum = Counts::default();
        let mut measurements = 0;
        for _ in 0..executions {
            let (found, counts) = run_case(&stream, &mut rng);
            measurements += found.len();
            sum.frames += counts.frames;
            sum.rejected += counts.rejected;
            sum.skipped_bytes += counts.skipped_bytes;
        }
        println!(
            "{}: {executions} executions of seed {seed}, {:.0}/s: {measurements} measurements, {sum:?}",
            stream.name,
            executions as f64 / start.elapsed().as_secs_f64()
        );
    }
}

fn run_case(stream: &Stream, rng: &mut FuzzRng) -> (Vec<Measurement>, Counts) {
    let (good, intact) = stream.units.split_at(UNITS as usize - INTACT_UNITS);
    let mut bytes = damage(good, rng);
    let damaged_bytes = bytes.len();
    // In one of 64 cases, zero bytes complete any false frame, so that all intact units must be
    // decoded.
    if stream.checksum_bits > 0 {
        bytes.resize(bytes.len() + FLUSH_BYTES * usize::from(rng.below(64) == 0), 0);
    }
    let is_flushed = bytes.len() > damaged_bytes;
    bytes.extend(intact.concat());
    let unsplit = decoded((stream.decoder)(), [&bytes[..]]);
    let mut rest = &bytes[..];
    let pieces = std::iter::from_fn(|| {
        let (piece, later) = rest.split_at((1 + rng.below(96) as usize).min(rest.len()));
        rest = later;
        (!piece.is_empty()).then_some(piece)
    });
    let pieces = decoded((stream.decoder)(), pieces);
    assert!(is_same(&unsplit, &pieces), "{}: {bytes:02x?}", stream.name);
    assert!(unsplit.1.skipped_bytes <= bytes.len() as u64, "{}: {bytes:02x?}", stream.name);
    if is_flushed && stream.is_stateless {
        let wanted = decoded((stream.decoder)(), [&intact.concat()[..]]).0;
        let found = &unsplit.0[unsplit.0.len().saturating_sub(wanted.len())..];
        assert!(is_same(&found, &&wanted[..]), "{}: {bytes:02x?}", stream.name);
    }
    unsplit
}

/// Returns `true` if the values are equal or have the same debug text, so that NaN equals NaN.
fn is_same<T: PartialEq + std::fmt::Debug>(a: &T, b: &T) -> bool {
    a == b || format!("{a:?}") == format!("{b:?}")
}

/// Concatenates the units and damages the result in one to four places.
fn damage(units: &[Vec<u8>], rng: &mut FuzzRng) -> Vec<u8> {
    let mut bytes = units.concat();
    for _ in 0..=rng.below(4) {
        let at = rng.below(bytes.len() as u64 + 1) as usize;
        match rng.below(7) {
            0 => bytes.truncate(at),
            1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << rng.below(8)),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = rng.next_u64() as u8),
            3 => {
                let length = rng.below(12) as usize;
                bytes.splice(at..at, std::iter::repeat_with(|| rng.next_u64() as u8).take(length));
            }
            // Inserts a partial unit.
            4 => {
                let other = &units[rng.below(units.len() as u64) as usize];
                let length = rng.below(other.len() as u64 + 1) as usize;
                bytes.splice(at..at, other[..length].iter().copied());
            }
            5 => drop(bytes.splice(at..at, std::iter::repeat_n(0xff, rng.below(9) as usize))),
            _ => bytes.rotate_left(at),
        }
    }
    bytes
}

/// SplitMix64 generator.
struct FuzzRng(u64);

impl FuzzRng {
    fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, end: u64) -> u64 {
        self.next_u64() % end
    }
}
