//! How many numbers a value is made of, each in its own place.

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, LastReading, CourseReading},
    fuser::{Estimate, Fused, FuserInput},
    gyro::{Motion, RateSample},
    scalars::Scalars,
};

/// The value made of other numbers, each different, and how many there are; each comes back where it was put.
fn assert_each_number_has_its_place<T: Scalars + Default + Copy>(expected: usize) {
    let (mut value, mut count) = (T::default(), 0.0);
    value.visit(&mut |number| {
        count += 1.0;
        *number = count;
    });
    let (mut places, mut of_kind) = (0, 0);
    value.visit(&mut |number| {
        places += 1;
        // A truth or a chart is 0 or 1, a reference at most 2; any other number is the one that was put there.
        of_kind += usize::from(*number == f64::from(places) || [0.0, 1.0, 2.0].contains(number));
    });
    assert_eq!((places, of_kind), (i32::try_from(expected).unwrap_or(0), expected));
}

#[test]
fn what_goes_to_another_process_has_as_many_numbers_as_its_header_says() {
    assert_each_number_has_its_place::<RateSample>(5);
    assert_each_number_has_its_place::<Motion>(12);
    assert_each_number_has_its_place::<Vector3<f64>>(3);
    assert_each_number_has_its_place::<Inclination>(8);
    assert_each_number_has_its_place::<FuserInput>(38);
    assert_each_number_has_its_place::<Fused>(21);
    assert_each_number_has_its_place::<Estimate>(24);
    assert_each_number_has_its_place::<CourseInput>(17);
    assert_each_number_has_its_place::<CourseReading>(13);
    assert_each_number_has_its_place::<LastReading>(8);
}
