//! Estimates the gyro bias while the body is at rest, and uses it in the next run.
use plumbline_ahrs::Ahrs;

/// Returns a pseudo-random number in [−0.5, 0.5).
fn noise(count: u32) -> f64 {
    f64::from(count.wrapping_mul(2_654_435_761) >> 16) / 65536.0 - 0.5
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bias_rad_s = [0.01, -0.02, 0.005];
    let mut ahrs = Ahrs::new();
    for count in 0..3000 {
        let gyro_rad_s = bias_rad_s.map(|bias| bias + 1e-3 * noise(count));
        ahrs.update(gyro_rad_s, [0.02 * noise(count + 7), 0.02 * noise(count + 11), 9.81], None, 0.01);
    }
    println!("estimated: {:.4?} rad/s", ahrs.attitude().gyro_bias_rad_s());

    let mut next = Ahrs::new();
    next.seed_sensor_errors(&ahrs.estimate())?;
    let attitude = next.update(bias_rad_s, [0.0, 0.0, 9.81], None, 0.01);
    println!("next run starts with {:.4?} rad/s", attitude.gyro_bias_rad_s());
    Ok(())
}
