//! Calibration and mounting: errors put onto a true vector are taken off again.
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
        .prop_filter("a length", |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
        .prop_map(|[w, i, j, k]| Quaternion::new(w, i, j, k).normalize())
}

fn rotated(q: Quaternion<f64>, v: Vector3<f64>) -> Vector3<f64> {
    (q * Quaternion::from_parts(0.0, v) * q.conjugate()).imag()
}

proptest! {
    #[test]
    fn a_calibration_takes_off_what_the_sensor_puts_on(
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
    fn quaternion_and_matrix_mount_alike(q in unit_quaternion(), v in vector(20.0)) {
        let mounting = Mounting::from_quaternion(q).unwrap();
        prop_assert!((mounting.apply(v) - rotated(q, v)).amax() < 1e-12);
        let same = Mounting::from_matrix(*mounting.matrix()).unwrap();
        prop_assert!((same.apply(v) - mounting.apply(v)).amax() < 1e-12);
    }

    #[test]
    fn angles_mount_as_turns_one_after_the_other(yaw_rad in -3.0..3.0, pitch_rad in -1.5..1.5, roll_rad in -3.0..3.0, v in vector(20.0)) {
        let about = |axis: Vector3<f64>, angle_rad: f64| {
            Quaternion::from_parts((0.5 * angle_rad).cos(), axis * (0.5 * angle_rad).sin())
        };
        let q = about(Vector3::z(), yaw_rad) * about(Vector3::x(), pitch_rad) * about(Vector3::y(), roll_rad);
        let mounting = Mounting::from_angles(Angles { yaw_rad, pitch_rad, roll_rad }).unwrap();
        prop_assert!((mounting.apply(v) - rotated(q, v)).amax() < 1e-12);
    }

    #[test]
    fn three_decimals_make_a_rotation_to_the_last_digit(q in unit_quaternion()) {
        let typed = Mounting::from_quaternion(q).unwrap().matrix().map(|x| (x * 1000.0).round() / 1000.0);
        let taken = *Mounting::from_matrix(typed).unwrap().matrix();
        prop_assert!((taken * taken.transpose() - Matrix3::identity()).amax() < 1e-14);
        prop_assert!((taken - typed).amax() < 2e-3);
    }
}

#[test]
fn there_are_24_names_and_each_points_where_it_says() {
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
fn three_mountings_have_a_short_name() {
    let body = [1.0, 2.0, 3.0];
    assert_eq!(Body::NAMES.map(|(name, _)| name), Mounting::SHORT_NAMES.map(|(name, _)| name));
    for (name, axes) in Body::NAMES {
        assert_eq!(Mounting::from_name(name).unwrap().apply(axes.vector(body).into()), Vector3::from(body), "{name}");
    }
}

#[test]
fn the_attitude_of_a_body_follows_from_that_of_its_sensor() {
    let sensor = Quaternion::new(0.3, -0.5, 0.7, 0.4).normalize();
    assert_eq!(Mounting::default().attitude(sensor), sensor);
    let turned = |q: Quaternion<f64>, v: Vector3<f64>| (q * Quaternion::from_imag(v) * q.conjugate()).imag();
    let vector = Vector3::new(0.2, -1.3, 0.8);
    let tilted = Angles { yaw_rad: 0.4, pitch_rad: -0.3, roll_rad: 1.9 };
    for mounting in [Mounting::from_name("frd"), Mounting::from_name("x-down-y-back"), Mounting::from_angles(tilted)] {
        let mounting = mounting.unwrap();
        let body = mounting.attitude(sensor);
        assert!((turned(body, mounting.apply(vector)) - turned(sensor, vector)).norm() < 1e-15);
    }
}

#[test]
fn a_yaw_of_90_degrees_is_x_forward_y_left() {
    let turned = Mounting::from_angles(Angles { yaw_rad: std::f64::consts::FRAC_PI_2, ..Angles::default() }).unwrap();
    let named = Mounting::from_name("x-forward-y-left").unwrap();
    assert!((turned.matrix() - named.matrix()).amax() < 1e-15);
}

#[test]
fn what_is_no_rotation_is_refused_and_told() {
    let told = |result: Result<Mounting, CalibrationError>| result.unwrap_err().to_string();
    for name in
        ["", "x-right", "x-right-y-right", "x-right-y-left", "y-forward-x-right", "x-right-y-ahead", "right-forward"]
    {
        assert!(told(Mounting::from_name(name)).contains("x-right-y-forward"), "{name}");
    }
    assert!(told(Mounting::from_matrix(Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0)))).contains("mirror"));
    assert!(told(Mounting::from_matrix(Matrix3::identity() * 1.01)).contains("orthogonal"));
    assert!(told(Mounting::from_matrix(Matrix3::identity() * 1e200)).contains("orthogonal"));
    assert!(told(Mounting::from_quaternion(Quaternion::new(0.5, 0.5, 0.5, 0.0))).contains("length 0.866"));
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
fn a_calibration_that_loses_a_direction_is_refused() {
    let make = |scale| Calibration::from_parts(Vector3::zeros(), scale, Matrix3::identity());
    assert_eq!(make(Vector3::new(1.0, 0.0, 1.0)), Err(CalibrationError::Singular));
    assert_eq!(make(Vector3::new(1.0, f64::NAN, 1.0)), Err(CalibrationError::NotFinite));
    assert_eq!(Calibration::new(Vector3::zeros(), Matrix3::repeat(1.0)), Err(CalibrationError::Singular));
    // A raw unit of a ten-thousandth, and a left-handed sensor.
    assert!(make(Vector3::new(1e-4, 1e-4, -1e-4)).is_ok());
}
