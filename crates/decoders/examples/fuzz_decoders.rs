//! Hands damaged streams to every decoder: `cargo run --release -p decoders --example fuzz_decoders -- 1000000 [SEED]`, so many of each format.
//!
//! A stream of sound units is cut, joined, flipped, overwritten and lengthened, and goes to its decoder twice: as a whole, and cut into
//! pieces. What comes of it must be the same, every byte must be accounted for, and the undamaged units behind the damage must be
//! found. Ends with the counts; a panic ends it with an error.
#![allow(clippy::unwrap_used, reason = "a panic is what is looked for")]

#[allow(dead_code, reason = "tests use more of it")]
#[path = "../tests/all/streams.rs"]
mod streams;

use std::time::Instant;

use decoders::{Counts, Measurement};
use streams::{Stream, decoded};

/// Units that are damaged, and sound ones behind them.
const UNITS: u32 = 8;
const SOUND: usize = 4;
/// More than a false frame waits for; a false frame that ends in it has had its chance.
const FLUSH_BYTES: usize = 8300;

fn main() {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<u64>().unwrap());
    let (executions, seed) = (arguments.next().unwrap_or(1_000_000), arguments.next().unwrap_or(1));
    for stream in streams::all(UNITS) {
        let (start, mut dice) = (Instant::now(), Dice(seed));
        let mut sum = Counts::default();
        let mut measurements = 0;
        for _ in 0..executions {
            let (found, counts) = executed(&stream, &mut dice);
            measurements += found.len();
            sum.frames += counts.frames;
            sum.refused += counts.refused;
            sum.skipped_bytes += counts.skipped_bytes;
        }
        println!(
            "{}: {executions} executions of seed {seed}, {:.0}/s: {measurements} measurements, {sum:?}",
            stream.name,
            executions as f64 / start.elapsed().as_secs_f64()
        );
    }
}

fn executed(stream: &Stream, dice: &mut Dice) -> (Vec<Measurement>, Counts) {
    let (good, behind) = stream.units.split_at(UNITS as usize - SOUND);
    let mut bytes = damaged(good, dice);
    let damaged_bytes = bytes.len();
    // Now and then a false frame of the greatest length must end before what is behind it is looked at.
    if stream.sum_bits > 0 {
        bytes.resize(bytes.len() + FLUSH_BYTES * usize::from(dice.below(64) == 0), 0);
    }
    let is_flushed = bytes.len() > damaged_bytes;
    bytes.extend(behind.concat());
    let whole = decoded((stream.decoder)(), [&bytes[..]]);
    let mut rest = &bytes[..];
    let pieces = std::iter::from_fn(|| {
        let (piece, later) = rest.split_at((1 + dice.below(96) as usize).min(rest.len()));
        rest = later;
        (!piece.is_empty()).then_some(piece)
    });
    let pieces = decoded((stream.decoder)(), pieces);
    assert!(is_same(&whole, &pieces), "{}: {bytes:02x?}", stream.name);
    assert!(whole.1.skipped_bytes <= bytes.len() as u64, "{}: {bytes:02x?}", stream.name);
    if is_flushed && stream.is_without_memory {
        let wanted = decoded((stream.decoder)(), [&behind.concat()[..]]).0;
        let found = &whole.0[whole.0.len().saturating_sub(wanted.len())..];
        assert!(is_same(&found, &&wanted[..]), "{}: {bytes:02x?}", stream.name);
    }
    whole
}

/// As text where it differs, so that NaN is equal to itself.
fn is_same<T: PartialEq + std::fmt::Debug>(a: &T, b: &T) -> bool {
    a == b || format!("{a:?}") == format!("{b:?}")
}

/// One to four damages.
fn damaged(units: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = units.concat();
    for _ in 0..=dice.below(4) {
        let at = dice.below(bytes.len() as u64 + 1) as usize;
        match dice.below(7) {
            0 => bytes.truncate(at),
            1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << dice.below(8)),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = dice.word() as u8),
            3 => {
                let length = dice.below(12) as usize;
                bytes.splice(at..at, std::iter::repeat_with(|| dice.word() as u8).take(length));
            }
            // Half a unit, or the beginning of one.
            4 => {
                let other = &units[dice.below(units.len() as u64) as usize];
                let length = dice.below(other.len() as u64 + 1) as usize;
                bytes.splice(at..at, other[..length].iter().copied());
            }
            5 => drop(bytes.splice(at..at, std::iter::repeat_n(0xff, dice.below(9) as usize))),
            _ => bytes.rotate_left(at),
        }
    }
    bytes
}

/// SplitMix64.
struct Dice(u64);

impl Dice {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, end: u64) -> u64 {
        self.word() % end
    }
}
