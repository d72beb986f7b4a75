//! Golden digests of the filter with each stage over the sample recording.
//!
//! After every 1000 samples and at the end, `golden/broad.csv` contains a digest of all attitudes
//! up to that sample. The Python package and other processors are compared with the same file.
//! After an intended change, run the command that the failing test shows.
use std::{fmt::Write as _, fs, path::Path};

use plumbline_ahrs::{Ahrs, AhrsBuilder, Slot, stages::Fuser};
use readings::source::Reading;
use recording::Reader;

use crate::{digest::Digest, path::update};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const INTERVAL: usize = 1000;

/// Creates the filter with a stage in a slot, and the default stages in the others.
fn filter(slot: Slot, stage: &str) -> Ahrs<Fuser> {
    let builder = AhrsBuilder::new().fuser_stage(Slot::Fuser.default_stage()).unwrap();
    builder.stage(slot, stage).unwrap().build()
}

#[test]
fn attitudes_have_the_golden_bits() {
    let recording = Path::new(ROOT).join("../../samples/broad.csv.gz");
    let readings: Vec<_> = Reader::open(&recording).unwrap().map(|row| Reading::from(row.unwrap())).collect();
    let mut table = String::from("slot,stage,samples,digest\n");
    for slot in Slot::ALL {
        for stage in slot.stages() {
            let (mut ahrs, mut digest) = (filter(slot, stage), Digest::new());
            for (i, reading) in readings.iter().enumerate() {
                digest.add(&update(&mut ahrs, reading));
                let count = i + 1;
                if count % INTERVAL == 0 || count == readings.len() {
                    writeln!(table, "{},{stage},{count},{:016x}", slot.name(), digest.0).unwrap();
                }
            }
        }
    }
    let actual = Path::new(env!("CARGO_TARGET_TMPDIR")).join("broad.csv");
    fs::write(&actual, &table).unwrap();
    let golden = Path::new(ROOT).join("golden/broad.csv");
    let expected = fs::read_to_string(&golden).unwrap_or_default();
    let difference =
        table.lines().zip(expected.lines().chain(std::iter::repeat(""))).find(|(found, line)| found != line);
    assert_eq!(difference, None, "to accept the bits, run cp {} {}", actual.display(), golden.display());
    assert_eq!(table.len(), expected.len());
}
