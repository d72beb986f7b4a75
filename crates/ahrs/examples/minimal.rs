//! Estimates the attitude of a turning body from gyro, accelerometer and magnetometer.
use plumbline_ahrs::Ahrs;

const DT_S: f64 = 0.01;

fn main() {
    let mut ahrs = Ahrs::new();
    for count in 0..1000 {
        // For a body that turns left at 0.1 rad/s, the magnetic field in body axes turns right.
        let yaw_rad = 0.1 * DT_S * f64::from(count);
        let field_ut = [20.0 * yaw_rad.sin(), 20.0 * yaw_rad.cos(), -40.0];
        let attitude = ahrs.update([0.0, 0.0, 0.1], [0.0, 0.0, 9.81], Some(field_ut), DT_S);
        if count % 100 == 99 {
            let angles = attitude.angles();
            println!(
                "yaw {:6.2}°, pitch {:6.2}°, roll {:6.2}°, heading {:6.2}°",
                angles.yaw_rad.to_degrees(),
                angles.pitch_rad.to_degrees(),
                angles.roll_rad.to_degrees(),
                attitude.heading_rad().to_degrees(),
            );
        }
    }
}
