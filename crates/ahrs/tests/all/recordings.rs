//! The filter reproduces the attitudes of the system on recordings bit for bit.

use std::path::{Path, PathBuf};

use launch::Launch;
use plumbline_ahrs::Ahrs;
use readings::source::Reading;
use recording::Reader;

use crate::path::{System, bits, system_bits, update};

/// Asserts that the filter and the system have the same outputs on a recording. Returns the number
/// of ticks.
fn compare(path: &Path) -> usize {
    let mut system = System::new(Launch::default(), recording::survey(path).unwrap().rate_hz);
    let (mut stamped, mut timed) = (Ahrs::new(), Ahrs::new());
    let (mut ticks, mut previous_ns) = (0, 0);
    for row in Reader::open(path).unwrap() {
        let reading = Reading::from(row.unwrap());
        let expected = system_bits(&system.step(&reading).unwrap());
        assert_eq!(bits(&update(&mut stamped, &reading)), expected, "{}, tick {ticks}", path.display());
        let dt_s = (reading.t_ns - std::mem::replace(&mut previous_ns, reading.t_ns)) as f64 * 1e-9;
        let by_interval = timed.update(reading.rate_rad_s, reading.force_m_s2, reading.field_ut, dt_s);
        assert_eq!(bits(&by_interval), expected, "{}, tick {ticks}, by interval", path.display());
        ticks += 1;
    }
    ticks
}

#[test]
fn sample_recording_yields_the_bits_of_the_system() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/broad.csv.gz");
    assert!(compare(&path) > 1000);
}

#[recorded::test]
fn broad_yields_the_bits_of_the_system() {
    let data = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let Ok(entries) = std::fs::read_dir(data.join("broad")) else {
        println!("skipped: no folder broad in {}", data.display());
        return;
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    let recordings: Vec<_> = paths.filter(|path| path.to_string_lossy().ends_with(".csv.gz")).collect();
    assert!(!recordings.is_empty());
    for path in recordings {
        let ticks = compare(&path);
        println!("{}: {ticks} ticks", path.display());
    }
}
