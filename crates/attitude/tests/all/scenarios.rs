//! Stages on simulated motions: tables of the article, tumbling through the inverted attitude,
//! steady spin, snapshots.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    fuser::{Fused, Fuser, FuserInput},
    gyro::{Gyro, GyroStage, RateKind, RateSample},
    kinematics,
    point::Chart,
    stage::{RestoreError, Stage},
    state::Attitude,
};
use scenario::{Motion, SensorErrors, Sensors};

/// Gyro, accelerometer and fuser stages of one body.
#[derive(Clone)]
struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
    ticks: u64,
}

impl Chain {
    fn new(gyro: &str, fuser: &str) -> Self {
        Self {
            gyro: Gyro::from_name(gyro).unwrap(),
            accel: Accelerometer::default(),
            fuser: Fuser::from_name(fuser).unwrap(),
            ticks: 0,
        }
    }

    fn step(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>, dt_s: f64) -> (Attitude, Fused) {
        let inclination = self.accel.step(&force_m_s2);
        let first = self.ticks == 0;
        if first {
            self.gyro.align(Attitude::from_up(inclination.up));
        }
        self.ticks += 1;
        let dt_s = if first { 0.0 } else { dt_s };
        let motion = self.gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Instant });
        let input = FuserInput {
            motion: Some(motion),
            inclination: Some(inclination),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        };
        (motion.attitude, self.fuser.step(&input))
    }
}

fn inclination_error_deg(estimate: Attitude, truth: Attitude) -> f64 {
    estimate
        .horizontal(truth.up.direction())
        .norm_sqr()
        .sqrt()
        .atan2(estimate.up.direction().dot(&truth.up.direction()))
        .to_degrees()
}

fn total_error_deg(estimate: Attitude, truth: Attitude) -> f64 {
    let d = estimate.quaternion().conjugate() * truth.quaternion();
    (2.0 * d.imag().norm().atan2(d.w.abs())).to_degrees()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    (sum / count).sqrt()
}

/// Root-mean-square inclination errors from 5 s onwards, degrees.
struct S1Errors {
    gyro: f64,
    fused: f64,
    bias_error_deg_s: f64,
}

/// Runs scenario S1 with its sensor errors.
fn s1_with_errors(fuser: &str, rate_hz: f64, duration_s: f64, seed: u64) -> S1Errors {
    let mut chain = Chain::new("mobius", fuser);
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, seed);
    let (mut gyro, mut fused, mut bias_error_deg_s) = (Vec::new(), Vec::new(), 0.0);
    for tick in 0..=(duration_s * rate_hz) as u64 {
        let t_s = tick as f64 / rate_hz;
        let reading = sensors.read(t_s);
        let (open, out) = chain.step(reading.rate_rad_s, reading.force_m_s2, 1.0 / rate_hz);
        if t_s >= 5.0 {
            gyro.push(inclination_error_deg(open, reading.truth.attitude));
            fused.push(inclination_error_deg(out.attitude, reading.truth.attitude));
            bias_error_deg_s = out.bias_rad_s.add_scalar(-SensorErrors::S1.gyro_bias_rad_s).norm().to_degrees();
        }
    }
    S1Errors { gyro: rms(gyro.into_iter()), fused: rms(fused.into_iter()), bias_error_deg_s }
}

#[test]
fn rk4_matches_table_of_article() {
    let table = include_str!("golden/s1.csv");
    let mut attitude = Motion::S1.at(0.0).attitude;
    let mut tick = 0;
    for row in table.lines().filter(|line| !line.starts_with(['#', 't'])) {
        let [t_s, u, v, z_rad] = row.split(',').map(|x| x.parse::<f64>().unwrap()).collect::<Vec<_>>()[..] else {
            panic!("expected four columns: {row}")
        };
        while tick < (t_s * 100.0).round() as u64 {
            let t = tick as f64 / 100.0;
            attitude = kinematics::rk4(attitude, |fraction| Motion::S1.at(t + 0.01 * fraction).rate_rad_s, 0.01);
            tick += 1;
        }
        assert_eq!(attitude.up.chart, Chart::Upright);
        for (got, want) in [(attitude.up.w.re, u), (attitude.up.w.im, v), (attitude.z_rad, z_rad)] {
            assert!((got - want).abs() < 1e-9, "t = {t_s}: got {got}, expected {want}");
        }
    }
    assert_eq!(tick, 10_000);
}

#[test]
fn noise_free_rk4_keeps_angles_within_1e_9_degrees() {
    let mut attitude = Motion::S1.at(0.0).attitude;
    for tick in 0..10_000 {
        let t_s = tick as f64 / 100.0;
        attitude = kinematics::rk4(attitude, |fraction| Motion::S1.at(t_s + 0.01 * fraction).rate_rad_s, 0.01);
        let (got, want) = (attitude.angles(), Motion::S1.at(t_s + 0.01).attitude.angles());
        for (got, want) in [(got.yaw_rad, want.yaw_rad), (got.pitch_rad, want.pitch_rad), (got.roll_rad, want.roll_rad)]
        {
            assert!((got - want).to_degrees().abs() < 1e-9);
        }
    }
}

#[test]
fn s1_errors_match_article() {
    let mean = |fuser: &str, pick: fn(&S1Errors) -> f64| {
        (1..=3).map(|seed| pick(&s1_with_errors(fuser, 100.0, 100.0, seed))).sum::<f64>() / 3.0
    };
    let (gyro, open, closed, wz) = (
        mean("wz-open", |e| e.gyro),
        mean("wz-open", |e| e.fused),
        mean("wz-closed", |e| e.fused),
        mean("wz", |e| e.fused),
    );
    println!("S1, 100 s, 100 Hz: gyro {gyro:.3}, open {open:.3}, closed {closed:.3}, wz {wz:.3}");
    assert!((6.2..8.3).contains(&gyro), "gyro alone {gyro}");
    assert!((0.19..0.26).contains(&open), "open loop {open}");
    assert!((0.13..0.18).contains(&closed), "closed loop {closed}");
    assert!(wz < 0.08, "wz {wz}");
}

#[test]
fn wz_finds_gyro_bias_within_30_s() {
    for seed in 1..=3 {
        let found = s1_with_errors("wz", 100.0, 30.0, seed);
        println!("seed {seed}: bias error {:.4} °/s", found.bias_error_deg_s);
        assert!(found.bias_error_deg_s < 0.02, "seed {seed}: {} °/s", found.bias_error_deg_s);
    }
}

#[test]
fn tumbling_through_inverted_attitude_adds_no_error() {
    let rate_rad_s = 500f64.to_radians();
    let axes = [
        Vector3::x(),
        Vector3::y(),
        Vector3::z(),
        Vector3::new(1.0, 1.0, 0.0).normalize(),
        Vector3::new(1.0, -2.0, 3.0).normalize(),
        Vector3::new(-0.3, 0.9, 0.01).normalize(),
    ];
    for fuser in Fuser::NAMES {
        for axis in axes {
            let motion = Motion::Tumble(axis * rate_rad_s);
            let mut chain = Chain::new("mobius", fuser);
            let mut inverted = 0;
            for tick in 0..=60_000u64 {
                let truth = motion.at(tick as f64 / 1000.0);
                let (open, out) = chain.step(truth.rate_rad_s, truth.force_m_s2, 1e-3);
                let worst = total_error_deg(open, truth.attitude).max(total_error_deg(out.attitude, truth.attitude));
                // The original filter compares the force with the attitude of the previous
                // interval, so the rotation during one interval appears as an error.
                let limit_deg = if fuser == "madgwick" { 1.0 } else { 1e-6 };
                assert!(worst < limit_deg, "{fuser}, axis {axis:?}, tick {tick}: {worst}°");
                inverted += u64::from(out.attitude.up.chart == Chart::Inverted);
            }
            assert!(axis.z.abs() > 0.7 || inverted > 10_000, "{fuser}, axis {axis:?}: only {inverted} ticks inverted");
        }
    }
}

#[test]
fn euler_drifts_and_mobius_does_not() {
    let motion = Motion::Tumble(Vector3::new(1.0, -2.0, 3.0));
    let drift_deg = |gyro: &str| {
        let mut chain = Chain::new(gyro, "wz");
        let mut last = 0.0;
        for tick in 0..=(60.0 / 0.0035) as u64 {
            let truth = motion.at(tick as f64 * 0.0035);
            last = total_error_deg(chain.step(truth.rate_rad_s, truth.force_m_s2, 0.0035).0, truth.attitude);
        }
        last
    };
    let (mobius, rk4, euler) = (drift_deg("mobius"), drift_deg("rk4"), drift_deg("euler"));
    println!("after 60 s at 3.7 rad/s, 286 Hz: mobius {mobius:.1e}°, rk4 {rk4:.1e}°, euler {euler:.1}°");
    assert!(mobius < 1e-9 && rk4 < 1e-3 && euler > 1.0);
}

#[test]
fn steady_spin_does_not_disturb_bias_estimate() {
    for spin_rad_s in [0.2, 0.5, 3.0] {
        let tilt =
            Attitude::from_angles(attitude::angles::Angles { pitch_rad: 20f64.to_radians(), ..Default::default() });
        let rate_rad_s = tilt.up.direction() * spin_rad_s;
        let mut noise = Sensors::new(Motion::S1, SensorErrors::S1, 7);
        let mut chain = Chain::new("mobius", "wz");
        let mut errors = Vec::new();
        for tick in 0..=100_000u64 {
            let reading = noise.read(0.0);
            let force_noise = reading.force_m_s2 - reading.truth.force_m_s2;
            let force_m_s2 = tilt.up.direction() * GRAVITY_M_S2 + force_noise;
            let out = chain.step(rate_rad_s.add_scalar(SensorErrors::S1.gyro_bias_rad_s), force_m_s2, 0.01).1;
            if tick > 500 {
                errors.push(inclination_error_deg(out.attitude, tilt));
            }
        }
        let error = rms(errors.into_iter());
        println!("spin {spin_rad_s} rad/s, 1000 s: inclination RMSE {error:.3}°");
        assert!(error < 0.06, "spin {spin_rad_s} rad/s: {error}°");
    }
}

#[test]
fn restored_chain_continues_bit_for_bit() {
    for (gyro, fuser) in Gyro::NAMES.into_iter().zip(Fuser::NAMES) {
        let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 1);
        let mut chain = Chain::new(gyro, fuser);
        let mut next = |chain: &mut Chain, tick: u64| {
            let reading = sensors.read(tick as f64 / 100.0);
            chain.step(reading.rate_rad_s, reading.force_m_s2, 0.01)
        };
        for tick in 0..1000 {
            next(&mut chain, tick);
        }
        let mut other = Chain::new(gyro, fuser);
        other.ticks = chain.ticks;
        other.gyro.restore(&chain.gyro.snapshot()).unwrap();
        other.accel.restore(&chain.accel.snapshot()).unwrap();
        other.fuser.restore(&chain.fuser.snapshot()).unwrap();
        for tick in 1000..2000 {
            let reading = ideal_reading(tick);
            assert_eq!(
                chain.step(reading.0, reading.1, 0.01),
                other.step(reading.0, reading.1, 0.01),
                "{gyro} {fuser} {tick}"
            );
        }
    }
}

fn ideal_reading(tick: u64) -> (Vector3<f64>, Vector3<f64>) {
    let truth = Motion::S1.at(tick as f64 / 100.0);
    (truth.rate_rad_s, truth.force_m_s2)
}

#[test]
fn foreign_or_damaged_record_is_rejected_unchanged() {
    let mut fuser = Fuser::from_name("wz").unwrap();
    let untouched = fuser.clone();
    let mut record = fuser.snapshot();
    record.values[3] = f64::NAN;
    assert_eq!(fuser.restore(&record), Err(RestoreError::NotFinite { index: 3 }));
    let foreign = Fuser::from_name("wz-open").unwrap().snapshot();
    assert!(matches!(fuser.restore(&foreign), Err(RestoreError::OtherStage { .. })));
    record.len -= 1;
    assert!(matches!(fuser.restore(&record), Err(RestoreError::OtherLength { .. })));
    assert_eq!(fuser, untouched);
}
