//! Tests the number and order of the scalars in each type that is exchanged with a hosted stage.

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, CourseReading, LastReading},
    fuser::{Estimate, Fused, FuserInput},
    gyro::{Motion, RateSample},
    scalars::Scalars,
};

/// Asserts that `T` visits `expected` scalars and reads each back at the position at which it was
/// written.
fn assert_scalar_count<T: Scalars + Default + Copy>(expected: usize) {
    let (mut value, mut count) = (T::default(), 0.0);
    value.visit(&mut |scalar| {
        count += 1.0;
        *scalar = count;
    });
    let (mut index, mut matching) = (0, 0);
    value.visit(&mut |scalar| {
        index += 1;
        // A boolean or a chart always reads back as 0 or 1, and a course reference as at most 2.
        matching += usize::from(*scalar == f64::from(index) || [0.0, 1.0, 2.0].contains(scalar));
    });
    assert_eq!((index, matching), (i32::try_from(expected).unwrap_or(0), expected));
}

#[test]
fn types_of_hosted_stages_have_fixed_scalar_counts() {
    assert_scalar_count::<RateSample>(5);
    assert_scalar_count::<Motion>(12);
    assert_scalar_count::<Vector3<f64>>(3);
    assert_scalar_count::<Inclination>(8);
    assert_scalar_count::<FuserInput>(38);
    assert_scalar_count::<Fused>(21);
    assert_scalar_count::<Estimate>(24);
    assert_scalar_count::<CourseInput>(17);
    assert_scalar_count::<CourseReading>(13);
    assert_scalar_count::<LastReading>(8);
}
