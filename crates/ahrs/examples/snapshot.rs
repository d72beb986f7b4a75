//! Continues after a restart from the state saved by an earlier process.
use plumbline_ahrs::Ahrs;

fn main() -> Result<(), plumbline_ahrs::SnapshotError> {
    let mut ahrs = Ahrs::new();
    for count in 0..500 {
        ahrs.update([0.0, 0.0, 0.1], [0.0, 1e-3 * f64::from(count % 5), 9.81], None, 0.01);
    }
    let mut bytes = vec![0; ahrs.snapshot_len()];
    ahrs.save(&mut bytes)?;
    println!("snapshot: {} bytes", bytes.len());

    let mut restarted = Ahrs::new();
    restarted.restore(&bytes)?;
    println!("equal: {}", restarted.attitude() == ahrs.attitude());

    bytes[100] ^= 1;
    if let Err(error) = restarted.restore(&bytes) {
        println!("damaged: {error}");
    }
    Ok(())
}
