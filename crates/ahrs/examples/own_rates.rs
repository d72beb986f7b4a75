//! Uses sensors with different rates: 200 Hz gyro and accelerometer, 25 Hz magnetometer, 5 Hz
//! satellite receiver.
use plumbline_ahrs::{Ahrs, GnssFix};

fn main() {
    let mut ahrs = Ahrs::new();
    for count in 0..2000 {
        let t_s = f64::from(count) / 200.0;
        if count % 8 == 0 {
            // Real magnetometer samples are never exactly equal. A sample that equals the previous
            // one counts as repeated, so the simulated field varies slightly.
            ahrs.update_mag([0.01 * t_s.sin(), 20.0, -40.0]);
        }
        if count % 40 == 0 {
            ahrs.update_gnss(&GnssFix {
                velocity_m_s: [0.0, 8.0, 0.0],
                velocity_sd_m_s: Some(0.1),
                ..GnssFix::default()
            });
        }
        ahrs.update([0.002, 0.0, 0.001], [0.01 * t_s.cos(), 0.0, 9.81], None, 1.0 / 200.0);
    }
    println!("{:?}", ahrs.attitude().angles());
}
