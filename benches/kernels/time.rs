//! Time of an update from rate and force to attitude, compared with vqf-rs.
//!
//! Command: `cargo bench -p kernels --bench time [-- ROUNDS]`.
//!
//! Input: scenario S1 at 100 Hz, and a BROAD trial at 286 Hz if the recordings exist in
//! `$PLUMBLINE_DATA` or `../shared/data`.
//!
//! Output: nanoseconds per update, for `mobius`, `projector` and `wz` together and for vqf-rs
//! without magnetometer, and the ratio of the two.
//!
//! Time: CPU time, as medians over interleaved rounds with the same samples. Load from other
//! processes therefore affects both filters equally.
//!
//! Failure: without the recordings, only S1 is timed.

#[path = "../common/median.rs"]
mod median;
#[path = "../common/thread_time.rs"]
mod thread_time;

use std::{env, hint::black_box, path::PathBuf};

use attitude::{
    Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
};
use recording::Reader;
use scenario::{Motion, SensorErrors, Sensors};
use vqf_rs::VQF;

use median::median;
use thread_time::thread_cpu_ns;

const ROUNDS: usize = 31;
const TRIAL: &str = "broad/07_undisturbed_fast_rotation_B.csv.gz";
const SAMPLES: usize = 20_000;

/// Samples that both filters process.
struct Samples {
    name: &'static str,
    dt_s: f64,
    kind: RateKind,
    readings: Vec<[[f64; 3]; 2]>,
}

fn main() {
    let rounds = env::args().filter_map(|argument| argument.parse().ok()).next().unwrap_or(ROUNDS);
    println!("| samples | wz, ns | vqf-rs, ns | ratio |\n| --- | --- | --- | --- |");
    for samples in [Some(s1()), broad()].into_iter().flatten() {
        let mut ns = [Vec::new(), Vec::new()];
        for _ in 0..rounds {
            ns[0].push(time_ns(&samples, wz));
            ns[1].push(time_ns(&samples, vqf));
        }
        let ratio = median(ns[0].iter().zip(&ns[1]).map(|(wz, vqf)| wz / vqf));
        let [wz, vqf] = ns.map(median);
        println!("| {} | {wz:.1} | {vqf:.1} | {ratio:.3} |", samples.name);
    }
}

fn time_ns(samples: &Samples, run: fn(&Samples)) -> f64 {
    let start_ns = thread_cpu_ns();
    run(samples);
    (thread_cpu_ns() - start_ns) as f64 / samples.readings.len() as f64
}

fn wz(samples: &Samples) {
    let (gyro, fuser) = (Gyro::from_name("mobius"), Fuser::from_name("wz"));
    let (mut gyro, mut fuser) = gyro.zip(fuser).expect("the names of built-in stages");
    let mut accel = Accelerometer::default();
    for [rate, force] in &samples.readings {
        let rate_rad_s = Vector3::from(*rate);
        let motion = Some(gyro.step(&RateSample { rate_rad_s, dt_s: samples.dt_s, kind: samples.kind }));
        let inclination = Some(accel.step(&Vector3::from(*force)));
        let input =
            FuserInput { motion, inclination, rest_credible: true, rate_credible: true, ..FuserInput::default() };
        black_box(fuser.step(&input));
    }
}

fn vqf(samples: &Samples) {
    let mut filter = VQF::new(samples.dt_s, None, None, None);
    for [rate, force] in &samples.readings {
        filter.update(*rate, *force, None);
        black_box(filter.quat_6d());
    }
}

fn s1() -> Samples {
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 1);
    let reading = |tick: usize| {
        let reading = sensors.read(tick as f64 * 0.01);
        [reading.rate_rad_s.into(), reading.force_m_s2.into()]
    };
    let readings = (0..SAMPLES).map(reading).collect();
    Samples { name: "S1, 100 Hz", dt_s: 0.01, kind: RateKind::Instant, readings }
}

fn broad() -> Option<Samples> {
    let data = env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")), PathBuf::from);
    let rows = Reader::open(&data.join(TRIAL)).ok()?;
    let readings = rows.filter_map(Result::ok).map(|row| [row.rate_rad_s, row.force_m_s2]).collect();
    Some(Samples { name: "BROAD, 286 Hz", dt_s: 0.0035, kind: RateKind::Mean, readings })
}
