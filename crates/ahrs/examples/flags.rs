//! Shows the flags of failing sensors, and the attitude jumps that a controller must handle.
use plumbline_ahrs::{Ahrs, Flags};

fn main() {
    let mut ahrs = Ahrs::new();
    let (mut before, mut resets) = (Flags::NONE, 0);
    for count in 0..1500_u32 {
        let varying = 1e-3 * f64::from(count % 7);
        let mut gyro_rad_s = [varying, 0.0, 0.0];
        let mut accel_m_s2 = [0.0, varying, 9.81];
        match count {
            300..400 => gyro_rad_s = [f64::NAN; 3],    // The gyro is dead.
            600..700 => accel_m_s2 = [0.0, 0.0, 0.01], // Free fall.
            900..1000 => accel_m_s2 = [0.0, 3.0, 9.3], // A frozen accelerometer.
            1200 => gyro_rad_s[2] = 40.0,              // Beyond the range.
            _ => {}
        }
        let attitude = ahrs.update(gyro_rad_s, accel_m_s2, None, 0.01);
        if attitude.flags() != before {
            println!("{:5.2} s: {}", f64::from(count) * 0.01, attitude.flags());
            before = attitude.flags();
        }
        if attitude.reset_counter() != resets {
            resets = attitude.reset_counter();
            println!("jump {resets}: {:.3?}", attitude.jump());
        }
    }
}
