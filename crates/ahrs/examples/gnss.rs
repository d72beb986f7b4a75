//! Estimates the attitude of a car that accelerates northwards. Without the receiver, the
//! acceleration looks like a tilt.
use plumbline_ahrs::{Ahrs, GnssFix};

fn main() {
    let [mut with, mut without] = [Ahrs::new(), Ahrs::new()];
    let mut velocity_m_s = 0.0;
    for count in 0..6000 {
        let t_s = f64::from(count) * 0.01;
        // The car accelerates forwards and backwards alternately, with an amplitude of 1.5 m/s².
        let acceleration_m_s2 = 1.5 * (0.3 * t_s).sin();
        velocity_m_s += acceleration_m_s2 * 0.01;
        if count % 20 == 0 {
            with.update_gnss(&GnssFix {
                velocity_m_s: [0.0, velocity_m_s, 0.0],
                velocity_sd_m_s: Some(0.1),
                age_s: Some(0.0),
                ..GnssFix::default()
            });
        }
        let field_ut = [0.01 * t_s.sin(), 20.0, -40.0];
        for ahrs in [&mut with, &mut without] {
            ahrs.update([0.0, 0.0, 1e-4 * (7.0 * t_s).sin()], [0.0, acceleration_m_s2, 9.81], Some(field_ut), 0.01);
        }
    }
    let pitch_deg = |ahrs: &Ahrs| ahrs.attitude().angles().pitch_rad.to_degrees();
    println!("pitch of a level car: {:.2}° with the receiver, {:.2}° without", pitch_deg(&with), pitch_deg(&without));
}
