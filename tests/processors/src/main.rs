//! Writes the golden traces of this processor.
//!
//!     processors FOLDER < recording.csv
//!
//! Input: the sample recording as CSV text, on standard input.
//!
//! Output: `FOLDER/broad.csv`, the digests of the filter as in `crates/ahrs/golden`, and with the
//! feature `std` `FOLDER/SLOT/STAGE.csv`, the trace of each stage as in `tools/conformance/golden`.
//!
//! Failure: panics.

#[path = "../../../crates/ahrs/tests/all/digest.rs"]
mod digest;

#[cfg(feature = "std")]
use std::path::Path;
use std::{env, fmt::Write as _, fs, io, path::PathBuf};

use digest::Digest;
use plumbline_ahrs::{Ahrs, AhrsBuilder, BuildError, Slot, stages::Fuser};

const INTERVAL: usize = 1000;

/// Creates the filter with a stage in a slot, and the default stages in the other slots.
fn filter(slot: Slot, stage: &str) -> Result<Ahrs<Fuser>, BuildError> {
    Ok(AhrsBuilder::new().fuser_stage(Slot::Fuser.default_stage())?.stage(slot, stage)?.build())
}

/// Writes the trace of each stage.
#[cfg(feature = "std")]
fn write_traces(folder: &Path) {
    for (slot, stage) in conformance::stages() {
        let path = folder.join(slot.name()).join(stage).with_extension("csv");
        fs::create_dir_all(path.parent().expect("a folder")).expect("folder of the traces");
        fs::write(path, conformance::golden::trace(slot, stage).expect("a stage")).expect("trace");
    }
}

fn main() {
    let folder = PathBuf::from(env::args().nth(1).expect("argument: folder of the traces"));
    fs::create_dir_all(&folder).expect("folder of the traces");
    #[cfg(feature = "std")]
    write_traces(&folder);
    let text = io::read_to_string(io::stdin()).expect("recording");
    let rows: Vec<[f64; 10]> = text
        .lines()
        .skip(1)
        .map(|line| {
            let mut values = line.split(',').map(|text| text.parse().expect("number"));
            std::array::from_fn(|_| values.next().expect("column"))
        })
        .collect();
    let mut table = String::from("slot,stage,samples,digest\n");
    for slot in Slot::ALL {
        for stage in slot.stages() {
            let (mut ahrs, mut digest) = (filter(slot, stage).expect("a stage"), Digest::new());
            for (count, [t_s, gx, gy, gz, ax, ay, az, mx, my, mz]) in (1..).zip(&rows) {
                let t_ns = (t_s * 1e9).round() as i64;
                digest.add(&ahrs.update_at([*gx, *gy, *gz], [*ax, *ay, *az], Some([*mx, *my, *mz]), t_ns));
                if count % INTERVAL == 0 || count == rows.len() {
                    writeln!(table, "{},{stage},{count},{:016x}", slot.name(), digest.0).expect("text");
                }
            }
        }
    }
    fs::write(folder.join("broad.csv"), table).expect("digests");
}
