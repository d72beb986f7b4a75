//! A sensor of your own on the bus of a running system, whose launch file says `[ingest] source = "bus"`:
//! `cargo run --release --example driver -- NAME`.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

fn main() -> Result<(), driver::DriverError> {
    let mut sensor = driver::Sensor::open(&std::env::args().nth(1).unwrap_or("plumbline".into()))?;
    let began = Instant::now();
    loop {
        // In place of these: what the device says, rad/s and m/s², in its own axes, and when it measured.
        let (rate_rad_s, force_m_s2) = ([0.0, 0.0, 0.1], [0.0, 0.0, 9.81]);
        if let Err(error) = sensor.send(began.elapsed().as_nanos() as i64, rate_rad_s, force_m_s2, None) {
            eprintln!("{error}");
            sleep(Duration::from_secs(1));
        }
        sleep(Duration::from_millis(1));
    }
}
