//! The filters of others as stages: their published figures.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use attitude::{
    accel::Projector,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
};
use common::{Rmse, broad, mean};
use scenario::{Errors, Motion, Scenario, Sensors};

fn set(name: &str, parameter: &str, value: f64) -> Fuser {
    let mut fuser = Fuser::named(name).unwrap();
    fuser.set(parameter, value).unwrap();
    fuser
}

/// RMS of the rotation between estimate and truth over S3's simulation, degrees.
fn s3_rms_deg(name: &str, parameter: &str, beta: f64, seed: u64) -> f64 {
    let (mut fuser, mut gyro, mut accel) =
        (set(name, parameter, beta), Gyro::named("mobius").unwrap(), Projector::default());
    let scenario = Scenario::named("s3").unwrap().with_seed(seed);
    let (mut sum, mut count, mut before_s) = (0.0, 0.0, 0.0);
    for (t_s, reading) in scenario.readings() {
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: t_s - before_s, kind: scenario.rate_kind };
        before_s = t_s;
        let out = fuser.step(&FuserInput {
            motion: Some(gyro.step(&sample)),
            inclination: Some(accel.step(&reading.force_m_s2)),
            field_ut: reading.field_ut,
            rest_credible: true,
            ..FuserInput::default()
        });
        let e = out.attitude.quaternion() * reading.truth.attitude.quaternion().conjugate();
        let error_deg = (2.0 * e.imag().norm().atan2(e.w.abs())).to_degrees();
        sum += error_deg * error_deg;
        count += 1.0;
    }
    (sum / count as f64).sqrt()
}

#[test]
fn sweep_s3() {
    for seed in 1..=3 {
        for (name, parameter, values) in [
            ("madgwick", "beta_rad_s", [0.0025, 0.005, 0.01, 0.021, 0.04]),
            ("madgwick-improved", "beta_1_s", [0.029, 0.07, 0.1, 0.15, 0.3]),
        ] {
            for value in values {
                println!("{seed} {name} {value} {:.3}", s3_rms_deg(name, parameter, value, seed));
            }
        }
    }
}

/// Drift over a coning motion of one minute, °/s.
fn coning_drift_deg_s(name: &str, kind: RateKind, rate_hz: f64) -> f64 {
    let motion = Motion::named("coning").unwrap();
    let mut sensors = Sensors::new(motion, Errors::NONE, 1);
    if kind == RateKind::Mean {
        sensors = sensors.integrating();
    }
    let mut gyro = Gyro::named(name).unwrap();
    gyro.align(motion.at(0.0).attitude);
    let mut last = 0.0;
    for tick in 0..=(60.0 * rate_hz) as u64 {
        let t_s = tick as f64 / rate_hz;
        let dt_s = if tick == 0 { 0.0 } else { 1.0 / rate_hz };
        let reading = sensors.read(t_s);
        let out = gyro.step(&RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind });
        let e = out.attitude.quaternion() * reading.truth.attitude.quaternion().conjugate();
        last = (2.0 * e.imag().norm().atan2(e.w.abs())).to_degrees();
    }
    last / 60.0
}

#[test]
fn sweep_coning() {
    for rate_hz in [100.0, 200.0, 400.0, 1000.0] {
        for kind in [RateKind::Mean, RateKind::Instant] {
            for name in Gyro::NAMES {
                println!("{rate_hz} Hz {kind:?} {name} {:.2e} °/s", coning_drift_deg_s(name, kind, rate_hz));
            }
        }
    }
}

#[test]
fn sweep() {
    let Some(trials) = broad() else { return };
    for magnetic in [false, true] {
        println!("vqf {:?}", mean(&Fuser::named("vqf").unwrap(), &trials, magnetic));
    }
    for (name, parameter, values) in
        [("madgwick", "beta_rad_s", [0.06, 0.08, 0.12]), ("madgwick-improved", "beta_1_s", [0.15, 0.2, 0.3])]
    {
        for value in values {
            let Rmse { total, heading, inclination } = mean(&set(name, parameter, value), &trials, true);
            println!("{name} {value}: {total:.2}/{heading:.2}/{inclination:.2}");
        }
    }
}
