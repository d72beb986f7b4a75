//! Publishes readings of a user-defined sensor to a running system.
//!
//! Run it with `cargo run --release --example driver -- NAME`. The launch file of the system must
//! set `[ingest] source = "bus"`.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

fn main() -> Result<(), driver::DriverError> {
    let mut sensor = driver::Sensor::open(&std::env::args().nth(1).unwrap_or("plumbline".into()))?;
    let start = Instant::now();
    loop {
        // Replace these values with the device's measurements, in rad/s and m/s², in the device's
        // own axes. Replace the timestamp with the time of the measurement.
        let (rate_rad_s, force_m_s2) = ([0.0, 0.0, 0.1], [0.0, 0.0, 9.81]);
        if let Err(error) = sensor.send(start.elapsed().as_nanos() as i64, rate_rad_s, force_m_s2, None) {
            eprintln!("{error}");
            sleep(Duration::from_secs(1));
        }
        sleep(Duration::from_millis(1));
    }
}
