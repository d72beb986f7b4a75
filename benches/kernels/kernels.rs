//! Instruction counts of the stages and of widely used filters, measured with callgrind.
//!
//! Command: `cargo bench -p kernels`.
//!
//! Input: 1000 samples of scenario S1 at 100 Hz, generated before counting starts.
//!
//! Output: the number of instructions (`Ir`) for 1000 calls, including the loop and the stores. The
//! measured code does not allocate memory.
//!
//! Time: the counts do not depend on the load of the machine.
//!
//! Failure: valgrind and gungraun-runner 0.20 are required.
//!
//! | group | one call |
//! | --- | --- |
//! | `gyros` | step of an integrator |
//! | `fusers` | step of a fuser, with precomputed outputs of `mobius` and `projector` |
//! | `filters` | from rate and force to attitude |
//!
//! A call in `filters` is either one step each of `mobius`, `projector` and a fuser, or one update
//! of another library. All filters run with their own defaults and in f64, except imu-fusion, which
//! supports only f32.
#![allow(missing_docs, reason = "gungraun makes public modules of the functions and groups")]

use std::hint::black_box;

use ahrs::{Ahrs, Madgwick, Mahony};
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, GyroStage, RateKind, RateSample},
    stage::Stage,
    state::Attitude,
};
use gungraun::prelude::*;
use imu_fusion::{FusionAhrs, FusionVector};
use nalgebra_of_ahrs::Vector3 as AhrsVector3;
use scenario::{Motion, SensorErrors, Sensors};
use vqf_rs::VQF;

const CALLS: usize = 1000;
const DT_S: f64 = 0.01;
/// Default gain of ahrs's Madgwick filter. All default gains of ahrs are given explicitly, because
/// its default constructors also assume a sampling interval, which differs from [`DT_S`].
const MADGWICK_BETA: f64 = 0.1;
/// Default proportional gain of ahrs's Mahony filter.
const MAHONY_KP: f64 = 0.5;
/// Default integral gain of ahrs's Mahony filter.
const MAHONY_KI: f64 = 0.0;

#[library_benchmark(setup = gyro_inputs)]
#[bench::mobius("mobius")]
#[bench::mobius_coning("mobius-coning")]
#[bench::rk4("rk4")]
#[bench::euler("euler")]
fn gyro((mut stage, samples): (Gyro, Vec<RateSample>)) -> (Gyro, Vec<RateSample>) {
    for sample in &samples {
        black_box(stage.step(sample));
    }
    (stage, samples)
}

#[library_benchmark(setup = fuser_inputs)]
#[bench::wz("wz")]
#[bench::wz_closed("wz-closed")]
#[bench::wz_open("wz-open")]
#[bench::madgwick("madgwick")]
#[bench::madgwick_improved("madgwick-improved")]
#[bench::vqf("vqf")]
fn fuser((mut stage, inputs): (Fuser, Vec<FuserInput>)) -> (Fuser, Vec<FuserInput>) {
    for input in &inputs {
        black_box(stage.step(input));
    }
    (stage, inputs)
}

#[library_benchmark(setup = chain)]
#[bench::wz("wz")]
#[bench::wz_closed("wz-closed")]
#[bench::wz_open("wz-open")]
#[bench::madgwick("madgwick")]
#[bench::madgwick_improved("madgwick-improved")]
#[bench::vqf("vqf")]
fn plumbline((mut chain, samples): (Chain, Vec<Sample>)) -> (Chain, Vec<Sample>) {
    for sample in &samples {
        let input = chain.input(sample);
        black_box(chain.fuser.step(&input));
    }
    (chain, samples)
}

#[library_benchmark]
#[bench::update_6d(vqf_inputs())]
fn vqf((mut filter, samples): (VQF, Vec<[[f64; 3]; 2]>)) -> (VQF, Vec<[[f64; 3]; 2]>) {
    for [rate_rad_s, force_m_s2] in &samples {
        filter.update(*rate_rad_s, *force_m_s2, None);
        black_box(filter.quat_6d());
    }
    (filter, samples)
}

#[library_benchmark]
#[bench::update_6d(ahrs_inputs(Madgwick::new(DT_S, MADGWICK_BETA)))]
fn madgwick(input: AhrsInput<Madgwick<f64>>) -> AhrsInput<Madgwick<f64>> {
    update_all(input)
}

#[library_benchmark]
#[bench::update_6d(ahrs_inputs(Mahony::new(DT_S, MAHONY_KP, MAHONY_KI)))]
fn mahony(input: AhrsInput<Mahony<f64>>) -> AhrsInput<Mahony<f64>> {
    update_all(input)
}

#[library_benchmark]
#[bench::update_6d_f32(imu_fusion_inputs())]
fn fusion((mut filter, samples): (FusionAhrs, Vec<[FusionVector; 2]>)) -> (FusionAhrs, Vec<[FusionVector; 2]>) {
    for [rate_deg_s, force_g] in &samples {
        filter.update_no_mag(*rate_deg_s, *force_g, DT_S as f32);
        black_box(filter.quaternion);
    }
    (filter, samples)
}

library_benchmark_group!(name = gyros, benchmarks = [gyro]);
library_benchmark_group!(name = fusers, benchmarks = [fuser]);
library_benchmark_group!(name = filters, benchmarks = [plumbline, vqf, madgwick, mahony, fusion]);
main!(library_benchmark_groups = [gyros, fusers, filters]);

/// Sensor readings at a tick.
#[derive(Clone, Copy)]
struct Sample {
    rate: RateSample,
    force_m_s2: Vector3<f64>,
}

/// Gyro and accelerometer stages with a fuser.
struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
}

impl Chain {
    fn new(gyro: &str, fuser: &str, first: &Sample) -> Self {
        let (gyro, fuser) = (Gyro::from_name(gyro), Fuser::from_name(fuser));
        let (mut gyro, fuser) = gyro.zip(fuser).expect("the names of built-in stages");
        let mut accel = Accelerometer::default();
        gyro.align(Attitude::from_up(accel.step(&first.force_m_s2).up));
        Self { gyro, accel, fuser }
    }

    fn input(&mut self, sample: &Sample) -> FuserInput {
        let motion = Some(self.gyro.step(&sample.rate));
        let inclination = Some(self.accel.step(&sample.force_m_s2));
        FuserInput { motion, inclination, rest_credible: true, rate_credible: true, ..FuserInput::default() }
    }
}

fn samples() -> Vec<Sample> {
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 1);
    let sample = |tick: usize| {
        let reading = sensors.read(tick as f64 * DT_S);
        let dt_s = if tick == 0 { 0.0 } else { DT_S };
        let rate = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: RateKind::Instant };
        Sample { rate, force_m_s2: reading.force_m_s2 }
    };
    (0..CALLS).map(sample).collect()
}

fn gyro_inputs(name: &str) -> (Gyro, Vec<RateSample>) {
    let samples = samples();
    (Chain::new(name, "wz", &samples[0]).gyro, samples.iter().map(|sample| sample.rate).collect())
}

fn fuser_inputs(name: &str) -> (Fuser, Vec<FuserInput>) {
    let (mut chain, samples) = chain(name);
    let inputs = samples.iter().map(|sample| chain.input(sample)).collect();
    (chain.fuser, inputs)
}

fn chain(fuser: &str) -> (Chain, Vec<Sample>) {
    let samples = samples();
    (Chain::new("mobius", fuser, &samples[0]), samples)
}

fn vqf_inputs() -> (VQF, Vec<[[f64; 3]; 2]>) {
    let pair = |sample: Sample| [sample.rate.rate_rad_s.into(), sample.force_m_s2.into()];
    (VQF::new(DT_S, None, None, None), samples().into_iter().map(pair).collect())
}

type AhrsInput<F> = (F, Vec<[AhrsVector3<f64>; 2]>);

fn ahrs_inputs<F: Ahrs<f64>>(filter: F) -> AhrsInput<F> {
    let vector = |v: Vector3<f64>| AhrsVector3::new(v.x, v.y, v.z);
    let pair = |sample: Sample| [vector(sample.rate.rate_rad_s), vector(sample.force_m_s2)];
    (filter, samples().into_iter().map(pair).collect())
}

#[inline(always)]
fn update_all<F: Ahrs<f64>>((mut filter, samples): AhrsInput<F>) -> AhrsInput<F> {
    for [rate_rad_s, force_m_s2] in &samples {
        black_box(filter.update_imu(rate_rad_s, force_m_s2).expect("the force is not zero"));
    }
    (filter, samples)
}

fn imu_fusion_inputs() -> (FusionAhrs, Vec<[FusionVector; 2]>) {
    let vector = |v: Vector3<f64>| FusionVector::new(v.x as f32, v.y as f32, v.z as f32);
    let pair = |sample: Sample| {
        [vector(sample.rate.rate_rad_s.map(f64::to_degrees)), vector(sample.force_m_s2 / GRAVITY_M_S2)]
    };
    (FusionAhrs::new(), samples().into_iter().map(pair).collect())
}
