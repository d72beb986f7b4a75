//! Garbage, half frames, bytes that changed, bytes cut anywhere: counted, and nothing good is lost.

use decoders::{Measurement, Value};
use proptest::{prelude::*, test_runner::RngSeed};

use crate::streams::{self, decoded};

const UNITS: u32 = 12;
/// More than any frame waits for.
const FLUSH: [u8; 9000] = [0; 9000];

fn any_garbage() -> impl Strategy<Value = Vec<u8>> {
    const BEGINS: [u8; 11] = [0xfa, 0xff, 0x36, 0xfe, 0xfd, 0xb5, 0x62, b'$', b',', b'1', b'\n'];
    proptest::collection::vec(prop_oneof![any::<u8>(), proptest::sample::select(&BEGINS[..])], 0..200)
}

/// Whether all of `wanted` are in `found`, in their order; as text, so that NaN is equal to itself.
fn holds(found: &[Measurement], wanted: &[Measurement]) -> bool {
    let mut found = found.iter().map(|found| format!("{found:?}"));
    wanted.iter().all(|wanted| found.any(|found| found == format!("{wanted:?}")))
}

#[test]
fn every_unit_of_an_undamaged_stream_is_measured() {
    for stream in streams::all(UNITS) {
        let (found, counts) = decoded((stream.decoder)(), [&stream.units.concat()[..]]);
        let imus = found.iter().filter(|found| !matches!(found.value, Value::Field(_))).count();
        // The first of a stream has none before it: no turn, or perhaps half a line.
        let expected = UNITS as usize - usize::from(matches!(stream.name, "rvc" | "lines"));
        assert!(imus >= expected, "{}: {imus}", stream.name);
        assert_eq!(counts.refused, 0, "{}", stream.name);
    }
}

proptest! {
    // The same cases each time: of frames with a sum of 8 bits one in 256 broken ones is sound by accident.
    #![proptest_config(ProptestConfig { cases: 512, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Default::default() })]

    #[test]
    fn where_bytes_are_cut_changes_nothing(
        garbage in proptest::collection::vec(any_garbage(), 4),
        cuts in proptest::collection::vec(1usize..60, 1..40),
    ) {
        for stream in streams::all(UNITS) {
            let mut bytes = Vec::new();
            for (index, unit) in stream.units.iter().enumerate() {
                bytes.extend(unit);
                if index % 3 == 0 {
                    bytes.extend(&garbage[index / 3]);
                }
            }
            let mut chunks = Vec::new();
            let mut rest = &bytes[..];
            for cut in cuts.iter().cycle() {
                let (chunk, later) = rest.split_at((*cut).min(rest.len()));
                chunks.push(chunk);
                rest = later;
                if rest.is_empty() {
                    break;
                }
            }
            let (whole, cut) = (decoded((stream.decoder)(), [&bytes[..]]), decoded((stream.decoder)(), chunks));
            prop_assert_eq!(format!("{whole:?}"), format!("{cut:?}"), "{}", stream.name);
        }
    }

    #[test]
    fn garbage_is_counted_and_what_is_good_around_it_is_found(
        garbage in proptest::collection::vec(any_garbage(), UNITS as usize),
    ) {
        for stream in streams::all(UNITS).into_iter().filter(|stream| stream.sum_bits > 0) {
            let (wanted, _) = decoded((stream.decoder)(), [&stream.units.concat()[..]]);
            let mut bytes = Vec::new();
            for (unit, garbage) in stream.units.iter().zip(&garbage) {
                bytes.extend(garbage);
                bytes.extend(unit);
            }
            bytes.extend(FLUSH);
            let (found, counts) = decoded((stream.decoder)(), [&bytes[..]]);
            prop_assert!(holds(&found, &wanted), "{}: {found:?} instead of {wanted:?}", stream.name);
            let passed: usize = garbage.iter().map(Vec::len).sum();
            // A frame in the garbage would be an accident: each has a checksum.
            prop_assert!(counts.skipped_bytes >= passed as u64, "{}: {counts:?} of {passed}", stream.name);
        }
    }

    #[test]
    fn one_damaged_unit_costs_that_one_and_by_accident_the_next(
        which in 0..UNITS as usize - 1,
        at in any::<proptest::sample::Index>(),
        damage in 1u8..,
        is_cut in any::<bool>(),
    ) {
        for stream in streams::all(UNITS).into_iter().filter(|stream| stream.is_without_memory) {
            let mut units = stream.units.clone();
            let at = at.index(units[which].len());
            // Half a frame and the beginning of the next pass for one: of 256 with a sum of 8 bits, or where one byte is missing.
            let spared = if stream.sum_bits > 8 && at + 1 < units[which].len() { 1 } else { 2 };
            let good: Vec<_> = [&units[..which], &units[which + spared..]].concat().concat();
            if is_cut {
                units[which].truncate(at);
            } else {
                units[which][at] ^= damage;
            }
            units.push(FLUSH.to_vec());
            let (wanted, _) = decoded((stream.decoder)(), [&good[..]]);
            let (found, _) = decoded((stream.decoder)(), [&units.concat()[..]]);
            prop_assert!(holds(&found, &wanted), "{}: {found:?} instead of {wanted:?}", stream.name);
        }
    }

    #[test]
    fn a_line_that_changed_is_refused_or_read_and_those_around_it_are_read(
        which in 1..UNITS as usize - 1,
        garbage in any_garbage(),
    ) {
        let streams = streams::all(UNITS);
        let stream = streams.into_iter().find(|stream| stream.name == "lines").unwrap();
        let mut units = stream.units.clone();
        units[which] = [&garbage[..], b"\n"].concat();
        let good = [&stream.units[..which], &stream.units[which + 1..]].concat().concat();
        let (wanted, before) = decoded((stream.decoder)(), [&good[..]]);
        let (found, after) = decoded((stream.decoder)(), [&units.concat()[..]]);
        prop_assert!(holds(&found, &wanted), "{found:?} instead of {wanted:?}");
        prop_assert!(after.frames + after.refused > before.frames, "{after:?}");
    }
}

/// What a receiver makes of bytes that are sent `ratio` times as fast as it listens: start bit, eight bits from the lowest, stop bit.
fn heard(bytes: &[u8], ratio: f64) -> Vec<u8> {
    let mut line = vec![true; 20];
    for byte in bytes {
        line.push(false);
        line.extend((0..8).map(|bit| byte >> bit & 1 == 1));
        line.push(true);
    }
    line.extend([true; 20]);
    let at = |place: f64| line.get(place as usize).copied();
    let mut heard = Vec::new();
    let mut place = 0.0;
    while let Some(level) = at(place) {
        if level {
            place += 0.25;
            continue;
        }
        // In the middle of each bit; a stop bit that is none is an error, and the byte comes all the same.
        let bits = (0..8).map(|bit| u8::from(at(place + (1.5 + f64::from(bit)) * ratio).unwrap_or(true)) << bit);
        heard.push(bits.sum());
        place += 9.5 * ratio;
    }
    heard
}

#[test]
fn a_wrong_baud_rate_is_counted_and_the_right_one_heard_after_it() {
    for stream in streams::all(200).into_iter().filter(|stream| stream.name != "iio") {
        let sent = stream.units.concat();
        assert_eq!(heard(&sent, 1.0), sent);
        let (wanted, _) = decoded((stream.decoder)(), [&sent[..]]);
        for ratio in [12.0, 2.0, 0.5, 1.0 / 12.0] {
            let wrong = heard(&sent, ratio);
            assert!(wrong.len() > 100, "{} {ratio}", stream.name);
            let (found, counts) = decoded((stream.decoder)(), [&wrong[..]]);
            assert_eq!(found, [], "{} {ratio}: {counts:?}", stream.name);
            let newline = if stream.name == "lines" { &b"\n"[..] } else { &FLUSH };
            let (found, counts) = decoded((stream.decoder)(), [&wrong[..], newline, &sent]);
            assert!(holds(&found, &wanted), "{} {ratio}: {counts:?}", stream.name);
            assert!(counts.skipped_bytes >= wrong.len() as u64, "{} {ratio}: {counts:?}", stream.name);
        }
    }
}
