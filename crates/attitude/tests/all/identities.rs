//! Identities between the representations of an attitude, anywhere on the sphere.
use std::f64::consts::{FRAC_PI_2, PI};

use attitude::{
    Complex, Matrix3, Quaternion, Vector3,
    accel::Accelerometer,
    angles::Angles,
    kinematics,
    point::{Chart, Point},
    rotation::Rotation,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};
use proptest::prelude::*;

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
}

/// Generates unit quaternions, including those of level, vertical and inverted attitudes.
fn quaternion() -> impl Strategy<Value = Quaternion<f64>> {
    let plain = [-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0]
        .prop_filter("non-zero length", |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
        .prop_map(|[w, i, j, k]| Quaternion::new(w, i, j, k).normalize());
    let special = prop_oneof![
        Just(Quaternion::new(1.0, 0.0, 0.0, 0.0)),
        Just(Quaternion::new(0.0, 1.0, 0.0, 0.0)),
        Just(Quaternion::new(0.0, 0.0, 1.0, 0.0)),
        Just(Quaternion::new(0.0, 0.0, 0.0, 1.0)),
        Just(Quaternion::new(0.5f64.sqrt(), 0.5f64.sqrt(), 0.0, 0.0)),
    ];
    prop_oneof![8 => plain, 1 => special]
}

/// Returns the matrix A of v_body = A v_ref, with v_ref = q v_body q*.
fn matrix_of(q: Quaternion<f64>) -> Matrix3<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    Matrix3::new(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y + w * z),
        2.0 * (x * z - w * y),
        2.0 * (x * y - w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z + w * x),
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
}

/// Returns the matrix A of the angles — Matveev 2025, (22).
fn matrix_of_angles(angles: Angles) -> Matrix3<f64> {
    let ((s_psi, c_psi), (s_theta, c_theta), (s_gamma, c_gamma)) =
        (angles.yaw_rad.sin_cos(), angles.pitch_rad.sin_cos(), angles.roll_rad.sin_cos());
    Matrix3::new(
        c_gamma * c_psi - s_gamma * s_psi * s_theta,
        c_gamma * s_psi + s_gamma * c_psi * s_theta,
        -s_gamma * c_theta,
        -c_theta * s_psi,
        c_theta * c_psi,
        s_theta,
        s_gamma * c_psi + c_gamma * s_psi * s_theta,
        s_gamma * s_psi - c_gamma * c_psi * s_theta,
        c_gamma * c_theta,
    )
}

fn modulus(w: Complex<f64>) -> f64 {
    w.norm_sqr().sqrt()
}

fn angle_between(a: Quaternion<f64>, b: Quaternion<f64>) -> f64 {
    let d = a.conjugate() * b;
    2.0 * d.imag().norm().atan2(d.w.abs())
}

proptest! {
    #[test]
    fn quaternion_matrix_and_angles_of_point_agree(q in quaternion()) {
        let attitude = Attitude::from_quaternion(q);
        prop_assert!(modulus(attitude.up.w) <= 1.0 + 1e-15);
        prop_assert!((attitude.quaternion().norm() - 1.0).abs() < 1e-15);
        prop_assert!(angle_between(attitude.quaternion(), q) < 1e-14);
        prop_assert!((attitude.matrix() - matrix_of(q)).amax() < 1e-14);
        prop_assert!((matrix_of_angles(attitude.angles()) - matrix_of(q)).amax() < 1e-12);
        prop_assert!((attitude.up.direction() - matrix_of(q).column(2)).amax() < 1e-14);
    }

    #[test]
    fn angles_survive_round_trip_through_point(
        yaw_rad in -PI..PI, pitch_rad in -FRAC_PI_2..FRAC_PI_2, roll_rad in -PI..PI,
    ) {
        let back = Attitude::from_angles(Angles { yaw_rad, pitch_rad, roll_rad }).angles();
        let near_vertical = FRAC_PI_2 - pitch_rad.abs();
        prop_assert!((back.pitch_rad - pitch_rad).abs() < 1e-12);
        prop_assert!(wrapped_rad(back.yaw_rad - yaw_rad).abs() * near_vertical < 1e-12);
        prop_assert!(wrapped_rad(back.roll_rad - roll_rad).abs() * near_vertical < 1e-12);
    }

    #[test]
    fn initial_point_of_article_matches_angles(
        pitch_rad in -1.5..1.5f64, roll_rad in -1.5..1.5f64,
    ) {
        let w = Attitude::from_angles(Angles { yaw_rad: 0.0, pitch_rad, roll_rad }).up.w_in_chart(Chart::Upright, 1e6);
        let k = 1.0 + roll_rad.cos() * pitch_rad.cos();
        let w0 = Complex::new(-roll_rad.sin() * pitch_rad.cos() / k, pitch_rad.sin() / k);
        prop_assert!(modulus(w - w0) < 1e-13);
    }

    #[test]
    fn other_chart_holds_inverse_point(q in quaternion()) {
        let point = Attitude::from_quaternion(q).up;
        prop_assume!(modulus(point.w) > 1e-3);
        let other = Point { w: point.w_in_chart(point.chart.other(), 1e6), chart: point.chart.other() };
        prop_assert!(modulus(other.w * point.w - 1.0) < 1e-15);
        prop_assert!((other.direction() - point.direction()).amax() < 1e-14);
    }

    #[test]
    fn rotation_acts_as_quaternion_product(q in quaternion(), rotation_vector in vector(7.0)) {
        let rotation = Rotation::from_rotation_vector(rotation_vector);
        let before = Attitude::from_quaternion(q);
        let moved = before.rotated(rotation);
        prop_assert!(modulus(moved.attitude.up.w) <= 1.2 + 1e-12);
        prop_assert!(angle_between(moved.attitude.quaternion(), q * rotation.quaternion()) < 1e-13);
        prop_assert!(angle_between(before.quaternion() * Rotation::between(before, moved.attitude).quaternion(), moved.attitude.quaternion()) < 1e-13);
    }

    #[test]
    fn rotations_compose(q in quaternion(), first in vector(3.0), second in vector(3.0)) {
        let (first, second) = (Rotation::from_rotation_vector(first), Rotation::from_rotation_vector(second));
        let attitude = Attitude::from_quaternion(q);
        let successive = attitude.rotated(first).attitude.rotated(second).attitude;
        let composed = attitude.rotated(first.then(second)).attitude;
        prop_assert!(angle_between(successive.quaternion(), composed.quaternion()) < 1e-13);
    }

    #[test]
    fn fixed_vector_rotates_with_level_frame(q in quaternion(), rotation_vector in vector(7.0), fixed in vector(1.0)) {
        let before = Attitude::from_quaternion(q);
        let rotation = Rotation::from_rotation_vector(rotation_vector);
        let moved = before.rotated(rotation);
        let horizontal_before = before.horizontal(before.matrix() * fixed);
        let horizontal_after = moved.attitude.horizontal(moved.attitude.matrix() * fixed);
        prop_assert!(modulus(horizontal_before * moved.level_frame_rotation - horizontal_after) < 1e-13);
    }

    #[test]
    fn tilt_rotates_about_horizontal_axis(q in quaternion(), tilt in [-0.3..0.3f64, -0.3..0.3f64]) {
        let tilt = Complex::new(tilt[0], tilt[1]);
        let before = Attitude::from_quaternion(q);
        let moved = before.tilted(tilt);
        let change = moved.attitude.quaternion() * before.quaternion().conjugate();
        prop_assert!(change.k.abs() < 1e-14);
        let up_before = before.horizontal(moved.attitude.up.direction());
        let length = 2.0 / (1.0 + tilt.norm_sqr());
        prop_assert!(modulus(up_before - tilt * length) < 1e-14);
    }

    #[test]
    fn realign_sets_up_and_keeps_heading(q in quaternion(), up in quaternion()) {
        let (before, up) = (Attitude::from_quaternion(q), Attitude::from_quaternion(up).up);
        let moved = before.realigned(up);
        prop_assert!((moved.attitude.up.direction() - up.direction()).amax() < 1e-6);
        let change = moved.attitude.quaternion() * before.quaternion().conjugate();
        prop_assert!(change.k.abs() < 1e-9);
    }

    #[test]
    fn exact_step_is_limit_of_fine_rk4(q in quaternion(), rate in vector(6.0)) {
        let dt_s = 0.01;
        let exact = Attitude::from_quaternion(q).rotated(Rotation::from_rotation_vector(rate * dt_s)).attitude;
        let mut fine = Attitude::from_quaternion(q);
        for _ in 0..100 {
            fine = kinematics::rk4(fine, |_| rate, dt_s / 100.0);
        }
        prop_assert!(angle_between(exact.quaternion(), fine.quaternion()) < 1e-12);
        prop_assert!((exact.up.direction() - fine.up.direction()).amax() < 1e-12);
    }

    #[test]
    fn projector_finds_up_vector(q in quaternion(), norm_m_s2 in 0.6..100.0f64) {
        let attitude = Attitude::from_quaternion(q);
        let inclination = Accelerometer::default().step(&(attitude.up.direction() * norm_m_s2));
        prop_assert!(modulus(inclination.up.w) <= 1.0 + 1e-12);
        prop_assert!((inclination.up.direction() - attitude.up.direction()).amax() < 1e-14);
        prop_assert!((inclination.norm_m_s2 - norm_m_s2).abs() < 1e-12);
    }

    #[test]
    fn inclinometers_match_projector(q in quaternion(), norm_m_s2 in 0.6..100.0f64) {
        let force_m_s2 = Attitude::from_quaternion(q).up.direction() * norm_m_s2;
        let projected = Accelerometer::default().step(&force_m_s2);
        for name in ["inclinometer-matrix", "inclinometer-quaternion"] {
            let measured = Accelerometer::from_name(name).unwrap().step(&force_m_s2);
            prop_assert!((measured.up.direction() - projected.up.direction()).amax() < 1e-12, "{name}: {:?}", measured.up);
            if projected.up.direction().z.abs() > 1e-12 {
                prop_assert_eq!(measured.up.chart, projected.up.chart);
                prop_assert!(modulus(measured.up.w - projected.up.w) < 1e-12);
            }
            prop_assert_eq!((measured.norm_m_s2, measured.trust), (projected.norm_m_s2, projected.trust));
        }
    }
}

#[test]
fn pitch_and_roll_match_paper() {
    let (pitch_rad, roll_rad) = (0.3f64, -0.7f64);
    let n = Attitude::from_angles(Angles { yaw_rad: 1.0, pitch_rad, roll_rad }).up.direction();
    let (gx, gy, gz) = (-n.y, -n.x, n.z);
    let of_paper = (-pitch_rad.sin(), roll_rad.sin() * pitch_rad.cos(), roll_rad.cos() * pitch_rad.cos());
    for (got, want) in [(gx, of_paper.0), (gy, of_paper.1), (gz, of_paper.2)] {
        assert!((got - want).abs() < 1e-15);
    }
}

#[test]
fn half_rotation_from_level_gives_inverted_chart() {
    let moved = Attitude::default().rotated(Rotation::from_quaternion(Quaternion::new(0.0, 1.0, 0.0, 0.0)));
    assert_eq!(moved.attitude.up.chart, Chart::Inverted);
    assert!(modulus(moved.attitude.up.w) < 1e-15);
}

#[test]
fn force_without_direction_keeps_point_without_trust() {
    for name in Accelerometer::NAMES {
        let mut stage = Accelerometer::from_name(name).unwrap();
        let measured = stage.step(&Vector3::new(0.0, 6.0, 8.0));
        for force_m_s2 in [Vector3::new(0.0, 0.01, -0.01), Vector3::zeros(), Vector3::new(1e300, -1e300, 1e300)] {
            let kept = stage.step(&force_m_s2);
            assert_eq!((kept.up, kept.trust), (measured.up, 0.0), "{name}");
        }
    }
}
