//! Tests that the separate update methods give the same result as `update_at`.

use plumbline_ahrs::{Ahrs, GnssFix};

#[test]
fn own_rates_equal_the_call_for_all_sensors() {
    let (mut all, mut own) = (Ahrs::new(), Ahrs::new());
    for count in 0..1000_i64 {
        let t_s = count as f64 * 0.01;
        let (rate, force) = ([0.1 * t_s.sin(), 0.0, 0.3], [0.0, 0.2 * t_s.cos(), 9.8]);
        let field_ut = (count % 4 == 0).then_some([20.0 * (0.3 * t_s).sin(), 20.0 * (0.3 * t_s).cos(), -40.0]);
        if let Some(field_ut) = field_ut {
            own.update_mag([0.0; 3]);
            own.update_mag(field_ut);
        }
        if count % 10 == 0 {
            let fix = GnssFix { velocity_m_s: [t_s, 1.0, 0.0], velocity_sd_m_s: Some(0.1), ..GnssFix::default() };
            own.update_gnss(&fix);
            all.update_gnss(&fix);
        }
        let expected = all.update_at(rate, force, field_ut, count * 10_000_000);
        assert_eq!(own.update_at(rate, force, None, count * 10_000_000), expected);
    }
}

#[test]
fn size_is_that_of_the_documentation() {
    assert!((60_000..70_000).contains(&size_of::<Ahrs>()), "{}", size_of::<Ahrs>());
}
