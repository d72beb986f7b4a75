//! Inclination of the fuser `wz` on recordings with reference attitudes from motion capture.
//!
//! Input: trials of BROAD in `$PLUMBLINE_DATA` or `../shared/data`.
//!
//! Output: inclination error in the scored rows.
//!
//! Failure: without the recordings the test is skipped with a message.
use std::path::PathBuf;

use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
    state::Attitude,
};
use recording::Reader;

/// Largest accepted mean over the ten trials, in degrees. VQF without the magnetometer reaches
/// 0.665°.
const MAX_MEAN_RMSE_DEG: f64 = 0.56;
const DT_S: f64 = 0.0035;

fn trials() -> Vec<PathBuf> {
    let data = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")), PathBuf::from);
    let Ok(entries) = std::fs::read_dir(data.join("broad")) else {
        println!("skipped: no recordings in {}", data.display());
        return Vec::new();
    };
    let mut trials: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    trials.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
    trials.sort();
    trials
}

/// Returns the angle between the up directions of two attitudes, rad.
fn inclination_rad(a: Quaternion<f64>, b: Quaternion<f64>) -> f64 {
    let difference = a * b.conjugate();
    2.0 * difference.i.hypot(difference.j).atan2(difference.w.hypot(difference.k))
}

#[recorded::test]
fn wz_inclination_on_broad_is_within_limit() {
    let mut rmses_deg = Vec::new();
    for trial in trials() {
        let mut gyro = Gyro::from_name("mobius").unwrap();
        let (mut accel, mut fuser) = (Accelerometer::default(), Fuser::from_name("wz").unwrap());
        let (mut sum, mut count, mut sd2) = (0.0, 0.0, 0.0);
        for (tick, row) in Reader::open(&trial).unwrap().enumerate() {
            let row = row.unwrap();
            let rate_rad_s = Vector3::from(row.rate_rad_s);
            let dt_s = if tick == 0 { 0.0 } else { DT_S };
            let motion = Some(gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean }));
            let inclination = Some(accel.step(&Vector3::from(row.force_m_s2)));
            let fused = fuser.step(&FuserInput {
                motion,
                inclination,
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            let Some(reference) = row.reference.filter(|reference| reference.scored) else { continue };
            let [w, x, y, z] = reference.quaternion;
            let error = inclination_rad(fused.attitude.quaternion(), Quaternion::new(w, x, y, z));
            (sum, count) = (sum + error * error, count + 1.0);
            sd2 += fused.inclination_sd_rad * fused.inclination_sd_rad;
        }
        let rmse_deg = f64::sqrt(sum / count).to_degrees();
        let name = trial.file_stem().unwrap().to_string_lossy().into_owned();
        println!("{name}: {rmse_deg:.3}°, reported sd {:.3}°", f64::sqrt(sd2 / count).to_degrees());
        rmses_deg.push(rmse_deg);
    }
    if rmses_deg.is_empty() {
        return;
    }
    let mean_deg = rmses_deg.iter().sum::<f64>() / rmses_deg.len() as f64;
    println!("mean of {}: {mean_deg:.4}°", rmses_deg.len());
    assert!(mean_deg <= MAX_MEAN_RMSE_DEG, "{mean_deg}°");
}

#[test]
fn inclination_angle_ignores_heading() {
    let rotated = Attitude { z_rad: 2.0, ..Attitude::default() };
    assert!(inclination_rad(rotated.quaternion(), Attitude::default().quaternion()) < 1e-12);
}
