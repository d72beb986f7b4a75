//! Passes the memory map to the linker and writes the sample recording as binary numbers.
use std::{env, error::Error, fs, io::Read as _, path::PathBuf};

use flate2::read::GzDecoder;

const RECORDING: &str = "../../samples/broad.csv.gz";
/// Number of columns that the filter uses: time, and three axes each of rate, specific force and
/// magnetic field.
const COLUMNS: usize = 10;

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::copy("memory.x", out.join("memory.x"))?;
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rerun-if-changed=memory.x");
    println!("cargo::rerun-if-changed={RECORDING}");
    let mut text = String::new();
    GzDecoder::new(fs::File::open(RECORDING)?).read_to_string(&mut text)?;
    let mut bytes = Vec::new();
    for number in text.lines().skip(1).flat_map(|line| line.split(',').take(COLUMNS)) {
        bytes.extend(number.parse::<f64>()?.to_le_bytes());
    }
    fs::write(out.join("recording.bin"), bytes)?;
    Ok(())
}
