//! Shows one attitude in the frames of Plumbline, ROS and PX4. The sensor axes are forward, right,
//! down.
use plumbline_ahrs::{Ahrs, Body, Frame};

fn main() {
    let mut ahrs = Ahrs::builder().axes(Body::Frd).build();
    // The nose is up by 0.1 rad. At rest the specific force points up, so its forward component is
    // positive and its downward component negative.
    let accel_m_s2 = [9.81 * 0.1_f64.sin(), 0.0, -9.81 * 0.1_f64.cos()];
    let attitude = ahrs.update([0.0; 3], accel_m_s2, None, 0.01);
    for (name, frame) in Frame::NAMES {
        let [w, x, y, z] = attitude.quaternion_in(frame);
        let angles = attitude.angles_in(frame);
        println!("{name}: quaternion {w:.4} {x:.4} {y:.4} {z:.4}, pitch {:.4} rad", angles.pitch_rad);
    }
}
