//! Code shared by the programs: the sample recording.
#![no_std]
#![forbid(unsafe_code)]

/// Recording as rows of ten numbers: time, and three axes each of rate, specific force and magnetic
/// field.
static RECORDING: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/recording.bin"));

/// Sample of all sensors.
pub struct Sample {
    /// Timestamp, ns.
    pub t_ns: i64,
    /// Body rate, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force, m/s².
    pub accel_m_s2: [f64; 3],
    /// Magnetic field, µT.
    pub field_ut: [f64; 3],
}

/// Returns the samples of the recording.
pub fn samples() -> impl Iterator<Item = Sample> {
    let (numbers, _) = RECORDING.as_chunks::<8>();
    let (rows, _) = numbers.as_chunks::<10>();
    rows.iter().map(|row| {
        let [t_s, gx, gy, gz, ax, ay, az, mx, my, mz] = row.map(f64::from_le_bytes);
        // The times are positive, so adding one half before the cast rounds them.
        let t_ns = (t_s * 1e9 + 0.5) as i64;
        Sample { t_ns, gyro_rad_s: [gx, gy, gz], accel_m_s2: [ax, ay, az], field_ut: [mx, my, mz] }
    })
}
