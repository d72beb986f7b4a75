//! The builder validates its values, and its settings have the same effect as those of the system.

use plumbline_ahrs::{Ahrs, Body, CourseReference, Frame, Slot, stages::Wz};

#[test]
fn value_out_of_range_is_rejected_with_its_range() {
    let error = Ahrs::builder().gyro_range_deg_s(0.5).unwrap_err();
    assert_eq!(error.to_string(), "rate_max_deg_s: expected 1 to 100000 °/s, found 0.5");
    assert!(Ahrs::builder().sample_rate_hz(f64::NAN).is_err());
    assert!(Ahrs::builder().declination_deg(181.0).is_err());
}

#[test]
fn unknown_name_is_rejected_with_the_known_ones() {
    let error = Ahrs::builder().fuser_stage("vfq").unwrap_err().to_string();
    assert!(error.starts_with("slot fuser has no stage `vfq`; choose one of multiple-model, wz,"), "{error}");
    let error = Ahrs::builder().parameter(Slot::Course, "declination", 3.0).unwrap_err().to_string();
    assert_eq!(error, "course `declination`: unknown parameter; available: declination_deg");
}

#[test]
fn axes_convert_the_samples_to_the_body() {
    let (rate, force, field) = ([0.1, -0.2, 0.3], [0.5, 1.0, 9.7], [3.0, 20.0, -40.0]);
    let mut native = Ahrs::new();
    let mut frd = Ahrs::builder().axes(Body::Frd).build();
    for _ in 0..50 {
        let expected = native.update(rate, force, Some(field), 0.01);
        let [rate, force, field] = [rate, force, field].map(|vector| Body::Frd.vector(vector));
        let attitude = frd.update(rate, force, Some(field), 0.01);
        assert_eq!(attitude.quaternion_in(Frame::NedFrd), expected.quaternion_in(Frame::NedFrd));
        assert_eq!(attitude.rate_rad_s_in(Frame::NedFrd), Body::Frd.vector(expected.rate_rad_s()));
    }
}

#[test]
fn declination_makes_the_heading_true() {
    let mut ahrs = Ahrs::builder().declination_deg(10.0).unwrap().fuser(Wz::default()).build();
    for count in 0..300 {
        let field_ut = [1e-3 * f64::from(count % 7), 20.0, -40.0];
        ahrs.update(
            [0.0, 0.0, 1e-4 * f64::from(count % 3)],
            [0.0, 1e-3 * f64::from(count % 5), 9.81],
            Some(field_ut),
            0.01,
        );
    }
    let attitude = ahrs.attitude();
    assert_eq!(attitude.heading_reference(), CourseReference::True);
    assert!((attitude.heading_rad().to_degrees() - 10.0).abs() < 0.5, "{attitude:?}");
}
