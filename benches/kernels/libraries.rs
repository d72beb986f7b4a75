//! Error and update time of Rust attitude libraries on one recording.
//!
//! Command: `cargo bench -p kernels --bench libraries [-- ROUNDS]`.
//!
//! Input: `samples/broad.csv.gz`, a trial of BROAD with gyro, accelerometer, magnetometer and
//! reference.
//!
//! Output: the table of `docs/reference/libraries.md`, which gives for each library the RMS errors
//! against the reference and the time of an update.
//!
//! Time: CPU time, as medians over interleaved rounds with the same samples.
//!
//! Failure: a missing sample recording ends the run with an error.
//!
//! Each library runs with its default settings, in the number format of its interface, and chooses
//! its own initial attitude. As in BROAD, only the samples in motion are scored, and no heading
//! offset is removed.

#[path = "../common/median.rs"]
mod median;
#[path = "../common/thread_time.rs"]
mod thread_time;

use std::{env, hint::black_box, path::Path, process::ExitCode};

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
};
use recording::{Reader, RecordingError, Row};

use median::median;
use thread_time::thread_cpu_ns;

const ROUNDS: usize = 11;
const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/broad.csv.gz");
const DT_S: f64 = 0.007;

/// Sample of the three sensors: angular rate (rad/s), specific force (m/s²) and magnetic field
/// (µT).
type Sample = [[f64; 3]; 3];
/// Attitude after each sample, as a quaternion (w, x, y, z) from body to ENU.
type Attitudes = Vec<[f64; 4]>;

/// Computes the attitudes of a recording with a library.
type Library = fn(&[Sample]) -> Attitudes;

const LIBRARIES: [(&str, Library); 5] = [
    ("plumbline-ahrs", plumbline),
    ("vqf-rs 0.3", vqf_rs),
    ("uf-ahrs 0.2", uf_ahrs),
    ("ahrs 0.8", ahrs),
    ("imu-fusion 0.2", imu_fusion),
];

fn main() -> ExitCode {
    match compare() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn compare() -> Result<(), RecordingError> {
    let rounds = env::args().filter_map(|argument| argument.parse().ok()).next().unwrap_or(ROUNDS);
    let rows = Reader::open(Path::new(RECORDING))?.collect::<Result<Vec<Row>, _>>()?;
    let samples: Vec<Sample> =
        rows.iter().map(|row| [row.rate_rad_s, row.force_m_s2, row.field_ut.unwrap_or_default()]).collect();
    let mut times_ns = LIBRARIES.map(|_| Vec::new());
    for _ in 0..rounds {
        for ((_, run), times_ns) in LIBRARIES.iter().zip(&mut times_ns) {
            let start_ns = thread_cpu_ns();
            black_box(run(&samples));
            times_ns.push((thread_cpu_ns() - start_ns) as f64 / samples.len() as f64);
        }
    }
    println!("| library | total, ° | heading, ° | inclination, ° | ns per update |\n| --- | --- | --- | --- | --- |");
    for ((name, run), times_ns) in LIBRARIES.iter().zip(times_ns) {
        let AttitudeError { total_deg, heading_deg, inclination_deg } = error(&rows, &run(&samples));
        let ns = median(times_ns);
        println!("| `{name}` | {total_deg:.2} | {heading_deg:.2} | {inclination_deg:.2} | {ns:.0} |");
    }
    Ok(())
}

fn error(rows: &[Row], attitudes: &[[f64; 4]]) -> AttitudeError {
    let mut accuracy = Accuracy::default();
    for (row, attitude) in rows.iter().zip(attitudes) {
        if let Some(reference) = row.reference.filter(|reference| reference.scored) {
            let [estimate, truth] = [*attitude, reference.quaternion].map(|[w, x, y, z]| Quaternion::new(w, x, y, z));
            accuracy.add(AttitudeError::between(estimate, truth));
        }
    }
    accuracy.rmse().unwrap_or_default()
}

/// Converts a quaternion from body to NWU (north, west, up) to a quaternion from body to ENU.
fn enu_from_nwu([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    let half_turn = Quaternion::new(std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2);
    let q = half_turn * Quaternion::new(w, x, y, z);
    [q.w, q.i, q.j, q.k]
}

fn plumbline(samples: &[Sample]) -> Attitudes {
    let mut filter = plumbline_ahrs::Ahrs::new();
    let update = |&[gyro, accel, mag]: &Sample| filter.update(gyro, accel, Some(mag), DT_S).quaternion();
    samples.iter().map(update).collect()
}

fn vqf_rs(samples: &[Sample]) -> Attitudes {
    let mut filter = vqf_rs::VQF::new(DT_S, None, None, None);
    let update = |&[gyro, accel, mag]: &Sample| {
        filter.update(gyro, accel, Some(mag));
        let q = filter.quat_9d();
        [q.0, q.1, q.2, q.3]
    };
    samples.iter().map(update).collect()
}

fn uf_ahrs(samples: &[Sample]) -> Attitudes {
    use uf_ahrs::Ahrs as _;
    let period = std::time::Duration::from_secs_f64(DT_S);
    let mut filter = uf_ahrs::Vqf::new(period, uf_ahrs::VqfParams::default());
    let update = |sample: &Sample| {
        let [gyro, accel, mag] = sample.map(|v| v.map(|x| x as f32).into());
        let q = filter.update(gyro, accel, mag);
        enu_from_nwu([q.w, q.i, q.j, q.k].map(f64::from))
    };
    samples.iter().map(update).collect()
}

fn ahrs(samples: &[Sample]) -> Attitudes {
    use ahrs::Ahrs as _;
    let mut filter = ahrs::Madgwick::new(DT_S, 0.1);
    let update = |sample: &Sample| {
        let [gyro, accel, mag] = sample.map(Into::into);
        // The update fails if the force or the magnetic field is zero.
        let _ = filter.update(&gyro, &accel, &mag);
        enu_from_nwu([filter.quat.w, filter.quat.i, filter.quat.j, filter.quat.k])
    };
    samples.iter().map(update).collect()
}

fn imu_fusion(samples: &[Sample]) -> Attitudes {
    use imu_fusion::{Fusion, FusionAhrsSettings, FusionVector};
    let vector = |v: [f64; 3], scale: f64| {
        let [x, y, z] = v.map(|x| (x * scale) as f32);
        FusionVector::new(x, y, z)
    };
    let mut filter = Fusion::new((1.0 / DT_S) as u32, FusionAhrsSettings::new());
    let update = |&[gyro, accel, mag]: &Sample| {
        // `imu_fusion` expects the rate in °/s and the force in g.
        let (gyro, accel) = (vector(gyro, 180.0 / std::f64::consts::PI), vector(accel, 1.0 / 9.80665));
        filter.update_by_duration_seconds(gyro, accel, vector(mag, 1.0), DT_S as f32);
        let q = filter.quaternion();
        enu_from_nwu([q.w, q.x, q.y, q.z].map(f64::from))
    };
    samples.iter().map(update).collect()
}
