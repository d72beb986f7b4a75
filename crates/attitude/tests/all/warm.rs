//! A beginning in motion with a gyro's bias that was known before.
use attitude::{
    Vector3,
    accel::Projector,
    course::Reference,
    fuser::{Fused, Fuser, FuserInput, FuserStage},
    gyro::{Gyro, RateSample},
    stage::Stage,
};
use scenario::Scenario;

/// They take the bias off the rate; how wrong it may be, °/s. `vqf` finds out by itself how well a bias is known, whoever found it.
const ESTIMATE_IT: [(&str, f64); 4] = [("wz", 0.02), ("levelling-pi", 0.02), ("aided", 0.02), ("vqf", 0.08)];
/// Of the gyro, rad/s, on each axis: 0.1 °/s.
const BIAS_RAD_S: f64 = 0.001_745_329_251_994_329_5;
const SD_RAD_S: f64 = 2e-4;

/// The outputs over 2 s of a movement that does not rest, and the fuser after them.
fn moved(mut fuser: Fuser) -> (Vec<Fused>, Fuser) {
    let (mut gyro, mut accel, mut before_s) = (Gyro::named("mobius").unwrap(), Projector::default(), 0.0);
    let scenario = Scenario::named("s1").unwrap();
    let step = |(t_s, reading): (f64, scenario::Reading)| {
        let (rate_rad_s, dt_s, kind) = (reading.rate_rad_s, t_s - before_s, scenario.rate_kind);
        before_s = t_s;
        fuser.step(&FuserInput {
            motion: Some(gyro.step(&RateSample { rate_rad_s, dt_s, kind })),
            inclination: Some(accel.step(&reading.force_m_s2)),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        })
    };
    let outputs = scenario.readings().take(200).map(step).collect();
    (outputs, fuser)
}

fn warm(name: &str) -> Fuser {
    let mut fuser = Fuser::named(name).unwrap();
    fuser.begin_with_bias(Vector3::repeat(BIAS_RAD_S), SD_RAD_S).unwrap();
    fuser
}

fn error_deg_s(bias_rad_s: Vector3<f64>) -> f64 {
    (bias_rad_s - Vector3::repeat(BIAS_RAD_S)).amax().to_degrees()
}

#[test]
fn the_bias_is_there_from_the_first_tick_on_although_the_body_moves() {
    for (name, most_deg_s) in ESTIMATE_IT {
        let worst_deg_s = |(outputs, _): (Vec<Fused>, Fuser)| {
            outputs.iter().map(|out| error_deg_s(out.bias_rad_s)).fold(0.0, f64::max)
        };
        let (cold_deg_s, warm_deg_s) =
            (worst_deg_s(moved(Fuser::named(name).unwrap())), worst_deg_s(moved(warm(name))));
        println!("{name}: bias wrong by at most {cold_deg_s:.4} °/s cold, {warm_deg_s:.4} °/s warm");
        assert!(warm_deg_s < most_deg_s && cold_deg_s > 0.09, "{name}: {warm_deg_s}, {cold_deg_s}");
    }
}

#[test]
fn every_fuser_hands_it_on() {
    for name in Fuser::NAMES {
        let (_, fuser) = moved(warm(name));
        let common = fuser.common();
        println!(
            "{name}: {:.4} °/s off, told {:.4} °/s",
            error_deg_s(common.bias_rad_s),
            common.bias_sd_rad_s.to_degrees()
        );
        let most_deg_s = if name == "vqf" { 0.08 } else { 0.02 };
        assert!(error_deg_s(common.bias_rad_s) < most_deg_s, "{name}: {common:?}");
    }
}

#[test]
fn the_attitude_is_as_unknown_as_without_it() {
    for name in Fuser::NAMES {
        let (cold, warm) = (moved(Fuser::named(name).unwrap()).0, moved(warm(name)).0);
        let (cold, warm) = (&cold[0], &warm[0]);
        assert_eq!(warm.attitude, cold.attitude, "{name}");
        assert!(warm.corrections.aligned, "{name}");
        assert_eq!((warm.reference, warm.heading_sd_rad), (Reference::Arbitrary, cold.heading_sd_rad), "{name}");
        let share = warm.inclination_sd_rad / cold.inclination_sd_rad;
        assert!((share - 1.0).abs() < 1e-2, "{name}: {} and {} rad", warm.inclination_sd_rad, cold.inclination_sd_rad);
    }
}

#[test]
fn what_is_no_bias_leaves_the_fuser_as_it_was() {
    for name in Fuser::NAMES {
        for (bias_rad_s, sd_rad_s) in [(f64::NAN, SD_RAD_S), (11.0, SD_RAD_S), (0.0, f64::NAN), (0.0, -1.0)] {
            let mut fuser = Fuser::named(name).unwrap();
            assert!(fuser.begin_with_bias(Vector3::repeat(bias_rad_s), sd_rad_s).is_err(), "{name}");
            assert_eq!(fuser, Fuser::named(name).unwrap(), "{name}");
        }
    }
}
