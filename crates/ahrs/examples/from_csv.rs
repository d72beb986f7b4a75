//! Computes attitudes from a CSV file with the columns t_s, gyro (3) in rad/s, accel (3) in m/s²
//! and mag (3) in µT; empty columns are missing values.
//!
//! `cargo run --example from_csv -- FILE.csv`; without a file, a short built-in table is used.
use std::{env, fs, io};

use plumbline_ahrs::Ahrs;

const TABLE: &str = "t_s,gx,gy,gz,ax,ay,az,mx,my,mz
0.00,0.01,0.00,0.10,0.00,0.10,9.80,0.0,20.0,-40.0
0.01,0.01,0.01,0.10,0.00,0.11,9.81,,,
0.02,0.02,0.00,0.11,0.01,0.10,9.80,0.1,20.0,-40.1
0.03,,,,0.00,0.10,9.82,,,
";

fn main() -> io::Result<()> {
    let text = env::args().nth(1).map_or_else(|| Ok(TABLE.to_owned()), fs::read_to_string)?;
    let mut ahrs = Ahrs::new();
    println!("t_s,qw,qx,qy,qz,flags");
    for line in text.lines().skip(1) {
        // A missing value is NaN.
        let mut values = line.split(',').map(|value| value.trim().parse().unwrap_or(f64::NAN));
        let mut next = || values.next().unwrap_or(f64::NAN);
        let (t_s, mut vector) = (next(), || [next(), next(), next()]);
        let (gyro_rad_s, accel_m_s2, field_ut) = (vector(), vector(), vector());
        let field_ut = Some(field_ut).filter(|field_ut| field_ut.iter().all(|x| x.is_finite()));
        let attitude = ahrs.update_at(gyro_rad_s, accel_m_s2, field_ut, (t_s * 1e9).round() as i64);
        let [w, x, y, z] = attitude.quaternion();
        println!("{t_s},{w:.6},{x:.6},{y:.6},{z:.6},{}", attitude.flags());
    }
    Ok(())
}
