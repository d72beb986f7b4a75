//! Calibration and mounting: errors added to a true vector are removed.
use attitude::{
    Matrix3, Quaternion, Vector3,
    angles::Angles,
    calibration::{Calibration, CalibrationError, Mounting},
    frames::Body,
};
use proptest::prelude::*;

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
}

fn unit_quaternion() -> impl Strategy<Value = Quaternion<f64>> {
    [-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0]
        .prop_filter("non-zero length", |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
        .prop_map(|[w, i, j, k]| Quaternion::new(w, i, j, k).normalize())
}

fn rotated(q: Quaternion<f64>, v: Vector3<f64>) -> Vector3<f64> {
    (q * Quaternion::from_parts(0.0, v) * q.conjugate()).imag()
}

proptest! {
    #[test]
    fn calibration_inverts_sensor_errors(
        truth in vector(100.0),
        bias in vector(50.0),
        scale in vector(0.3),
        skew in [vector(0.1), vector(0.1), vector(0.1)],
    ) {
        let scale = scale.add_scalar(1.0);
        let axes = Matrix3::identity() + Matrix3::from_rows(&skew.map(|row| row.transpose()));
        let raw = (axes * truth).component_div(&scale) + bias;
        let calibration = Calibration::from_parts(bias, scale, axes.try_inverse().unwrap()).unwrap();
        prop_assert!((calibration.apply(raw) - truth).amax() < 1e-11);
    }

    #[test]
    fn quaternion_and_matrix_mountings_agree(q in unit_quaternion(), v in vector(20.0)) {
        let mounting = Mounting::from_quaternion(q).unwrap();
        prop_assert!((mounting.apply(v) - rotated(q, v)).amax() < 1e-12);
        let same = Mounting::from_matrix(*mounting.matrix()).unwrap();
        prop_assert!((same.apply(v) - mounting.apply(v)).amax() < 1e-12);
    }

    #[test]
    fn mounting_angles_are_successive_rotations(yaw_rad in -3.0..3.0, pitch_rad in -1.5..1.5, roll_rad in -3.0..3.0, v in vector(20.0)) {
        let about = |axis: Vector3<f64>, angle_rad: f64| {
            Quaternion::from_parts((0.5 * angle_rad).cos(), axis * (0.5 * angle_rad).sin())
        };
        let q = about(Vector3::z(), yaw_rad) * about(Vector3::x(), pitch_rad) * about(Vector3::y(), roll_rad);
        let mounting = Mounting::from_angles(Angles { yaw_rad, pitch_rad, roll_rad }).unwrap();
        prop_assert!((mounting.apply(v) - rotated(q, v)).amax() < 1e-12);
    }

    #[test]
    fn matrix_of_three_decimals_is_orthonormalised(q in unit_quaternion()) {
        let rounded = Mounting::from_quaternion(q).unwrap().matrix().map(|x| (x * 1000.0).round() / 1000.0);
        let accepted = *Mounting::from_matrix(rounded).unwrap().matrix();
        prop_assert!((accepted * accepted.transpose() - Matrix3::identity()).amax() < 1e-14);
        prop_assert!((accepted - rounded).amax() < 2e-3);
    }
}

#[test]
fn mounting_has_24_names_with_matching_axes() {
    let mut found: Vec<Mounting> = Vec::new();
    for x in Mounting::DIRECTIONS {
        for y in Mounting::DIRECTIONS {
            let Ok(mounting) = Mounting::from_name(&format!("x-{x}-y-{y}")) else { continue };
            assert_eq!(mounting.matrix().determinant(), 1.0);
            assert!(!found.contains(&mounting));
            found.push(mounting);
        }
    }
    assert_eq!(found.len(), 24);
    assert_eq!(Mounting::from_name("x-right-y-forward"), Ok(Mounting::default()));
    let aircraft = Mounting::from_name("x-forward-y-right").unwrap();
    assert_eq!(aircraft.apply(Vector3::new(1.0, 2.0, 3.0)), Vector3::new(2.0, 1.0, -3.0));
}

#[test]
fn short_names_match_body_frames() {
    let body = [1.0, 2.0, 3.0];
    assert_eq!(Body::NAMES.map(|(name, _)| name), Mounting::SHORT_NAMES.map(|(name, _)| name));
    for (name, axes) in Body::NAMES {
        assert_eq!(Mounting::from_name(name).unwrap().apply(axes.vector(body).into()), Vector3::from(body), "{name}");
    }
}

#[test]
fn body_attitude_follows_from_sensor_attitude() {
    let sensor = Quaternion::new(0.3, -0.5, 0.7, 0.4).normalize();
    assert_eq!(Mounting::default().attitude(sensor), sensor);
    let into_earth = |q: Quaternion<f64>, v: Vector3<f64>| (q * Quaternion::from_imag(v) * q.conjugate()).imag();
    let vector = Vector3::new(0.2, -1.3, 0.8);
    let tilted = Angles { yaw_rad: 0.4, pitch_rad: -0.3, roll_rad: 1.9 };
    for mounting in [Mounting::from_name("frd"), Mounting::from_name("x-down-y-back"), Mounting::from_angles(tilted)] {
        let mounting = mounting.unwrap();
        let body = mounting.attitude(sensor);
        assert!((into_earth(body, mounting.apply(vector)) - into_earth(sensor, vector)).norm() < 1e-15);
    }
}

#[test]
fn yaw_of_90_degrees_is_x_forward_y_left() {
    let from_angles =
        Mounting::from_angles(Angles { yaw_rad: std::f64::consts::FRAC_PI_2, ..Angles::default() }).unwrap();
    let from_name = Mounting::from_name("x-forward-y-left").unwrap();
    assert!((from_angles.matrix() - from_name.matrix()).amax() < 1e-15);
}

#[test]
fn invalid_rotation_is_rejected_with_cause() {
    let message = |result: Result<Mounting, CalibrationError>| result.unwrap_err().to_string();
    for name in
        ["", "x-right", "x-right-y-right", "x-right-y-left", "y-forward-x-right", "x-right-y-ahead", "right-forward"]
    {
        assert!(message(Mounting::from_name(name)).contains("x-right-y-forward"), "{name}");
    }
    assert!(
        message(Mounting::from_matrix(Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0)))).contains("reflection")
    );
    assert!(message(Mounting::from_matrix(Matrix3::identity() * 1.01)).contains("orthogonal"));
    assert!(message(Mounting::from_matrix(Matrix3::identity() * 1e200)).contains("orthogonal"));
    assert!(message(Mounting::from_quaternion(Quaternion::new(0.5, 0.5, 0.5, 0.0))).contains("length 0.866"));
    for bad in [f64::NAN, f64::INFINITY] {
        assert_eq!(Mounting::from_matrix(Matrix3::identity() * bad), Err(CalibrationError::NotFinite));
        assert_eq!(Mounting::from_quaternion(Quaternion::new(bad, 0.0, 0.0, 0.0)), Err(CalibrationError::NotFinite));
        assert_eq!(
            Mounting::from_angles(Angles { roll_rad: bad, ..Angles::default() }),
            Err(CalibrationError::NotFinite)
        );
    }
}

#[test]
fn singular_calibration_is_rejected() {
    let with_scale = |scale| Calibration::from_parts(Vector3::zeros(), scale, Matrix3::identity());
    assert_eq!(with_scale(Vector3::new(1.0, 0.0, 1.0)), Err(CalibrationError::Singular));
    assert_eq!(with_scale(Vector3::new(1.0, f64::NAN, 1.0)), Err(CalibrationError::NotFinite));
    assert_eq!(Calibration::new(Vector3::zeros(), Matrix3::repeat(1.0)), Err(CalibrationError::Singular));
    // A raw unit of 1e-4 and a left-handed sensor are valid.
    assert!(with_scale(Vector3::new(1e-4, 1e-4, -1e-4)).is_ok());
}
