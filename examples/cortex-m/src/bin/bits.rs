//! Compares the attitudes of every stage with the golden digests in `crates/ahrs/golden`, bit by
//! bit.
//!
//! Output: a line per stage, printed by semihosting.
//!
//! Failure: exits with 1 if a digest differs.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

#[path = "../../../../crates/ahrs/tests/all/digest.rs"]
mod digest;

use cortex_m as _;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use digest::Digest;
use panic_semihosting as _;
use plumbline_ahrs::{Ahrs, AhrsBuilder, BuildError, Slot, stages::Fuser};

static GOLDEN: &str = include_str!("../../../../crates/ahrs/golden/broad.csv");
/// Digests of the stage `vqf` with the mathematical functions of libm. [`GOLDEN`] has those with
/// the functions of the standard library.
static GOLDEN_LIBM: &str = include_str!("../../../../crates/ahrs/golden/vqf-libm.csv");
/// Number of compared samples, which cover 15 s at rest and 6 s of motion.
const SAMPLES: usize = 3000;

fn filter(slot: Slot, stage: &str) -> Result<Ahrs<Fuser>, BuildError> {
    Ok(AhrsBuilder::new().fuser_stage(Slot::Fuser.default_stage())?.stage(slot, stage)?.build())
}

/// Returns the golden digest after [`SAMPLES`] samples.
fn golden(slot: Slot, stage: &str) -> Option<u64> {
    let mut rows = GOLDEN_LIBM.lines().chain(GOLDEN.lines()).map(|line| line.split(','));
    rows.find_map(|mut row| {
        let is_row = row.next()? == slot.name() && row.next()? == stage && row.next()?.parse() == Ok(SAMPLES);
        is_row.then(|| row.next()).flatten()
    })
    .and_then(|digest| u64::from_str_radix(digest, 16).ok())
}

#[entry]
fn main() -> ! {
    let mut is_equal = true;
    for slot in Slot::ALL {
        for stage in slot.stages() {
            let Ok(mut ahrs) = filter(slot, stage) else { panic!("no stage {stage}") };
            let mut digest = Digest::new();
            for sample in firmware::samples().take(SAMPLES) {
                digest.add(&ahrs.update_at(sample.gyro_rad_s, sample.accel_m_s2, Some(sample.field_ut), sample.t_ns));
            }
            let same = golden(slot, stage) == Some(digest.0);
            hprintln!("{} {}: {}", slot.name(), stage, if same { "equal bits" } else { "other bits" });
            is_equal &= same;
        }
    }
    debug::exit(if is_equal { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {}
}
