//! Motions that hide errors in the gyro's axes. The errors are found once the body has rotated by
//! 90° about each axis.

use std::f64::consts::FRAC_PI_2;

use crate::common::{INPUT_ERRORS, data, diagnose, rate_hz, readings};
use attitude::Vector3;
use readings::source::Reading;

/// Recordings in which the body only translates, is at rest or makes coordinated turns.
const WITHOUT_ROTATION: [&str; 5] = [
    "broad/11_undisturbed_slow_translation_B.csv.gz",
    "broad/15_undisturbed_fast_translation_A.csv.gz",
    "broad/27_disturbed_phone_vibration_B.csv.gz",
    "broad/29_disturbed_stationary_magnet_B.csv.gz",
    "flights/apm_plane_log2_imu.csv.gz",
];
/// Names of the errors that only rotation reveals.
const NEED_ROTATION: [&str; 7] = [
    "rates converted twice",
    "left-handed axes",
    "a negated gyro",
    "an axis of the gyro negated",
    "axes of the gyro exchanged",
    "an axis stuck",
    "an axis of the force stuck",
];
/// Duration of a rotation by 90°, and of the rest that follows it, s.
const ROTATION_S: f64 = 2.0;
const REST_S: f64 = 0.5;
const GRAVITY_M_S2: f64 = 9.81;

/// Returns readings of a level body that rotates by 90° and back about x, z and y in turn, each
/// time about a level axis.
fn rotations(rate_hz: f64) -> Vec<Reading> {
    let axes = [Vector3::x(), Vector3::z(), Vector3::y(), -Vector3::y(), -Vector3::z(), -Vector3::x()];
    let mut up = Vector3::z();
    let mut all = Vec::new();
    for axis in axes {
        for step in 0..((ROTATION_S + REST_S) * rate_hz) as u32 {
            // The rotation starts and ends smoothly, as if the body were turned by hand.
            let angle_rad = |t_s: f64| FRAC_PI_2 * (1.0 - (FRAC_PI_2 * 2.0 * (t_s / ROTATION_S).min(1.0)).cos()) / 2.0;
            let t_s = f64::from(step) / rate_hz;
            let step_rad = angle_rad(t_s + 1.0 / rate_hz) - angle_rad(t_s);
            // The body rotates about a level axis. In body axes, the up vector therefore rotates
            // about the same axis by the opposite angle.
            up = up * step_rad.cos() - axis.cross(&up) * step_rad.sin();
            // A real sensor has noise on every axis.
            let noise = Vector3::new(31.0, 37.0, 41.0).map(|rad_s| (rad_s * t_s).sin());
            let rate = axis * step_rad * rate_hz + noise * 1e-3;
            let force = up * GRAVITY_M_S2 + noise * 1e-2;
            all.push(Reading {
                t_ns: (all.len() as f64 * 1e9 / rate_hz) as i64,
                rate_rad_s: rate.into(),
                force_m_s2: force.into(),
                field_ut: None,
                fix: None,
                reference: None,
            });
        }
    }
    all
}

/// Returns the readings, preceded by the rotations.
fn after_rotations(readings: &[Reading], rate_hz: f64) -> Vec<Reading> {
    let mut all = rotations(rate_hz);
    let offset_ns = (all.len() as f64 * 1e9 / rate_hz) as i64 - readings[0].t_ns;
    all.extend(readings.iter().map(|reading| Reading { t_ns: reading.t_ns + offset_ns, ..*reading }));
    all
}

#[recorded::test]
fn hidden_axis_errors_are_diagnosed_after_90_degree_rotations() {
    let mut failures = Vec::new();
    for name in WITHOUT_ROTATION {
        let path = data().join(name);
        if !path.is_file() {
            eprintln!("skipped: no {}; set PLUMBLINE_DATA", path.display());
            continue;
        }
        let recorded = readings(&path);
        let rate_hz = rate_hz(&recorded);
        let all = after_rotations(&recorded, rate_hz);
        let found = diagnose(all.iter().copied(), rate_hz);
        assert!(found.is_empty(), "{name} with rotations: {found:#?}");
        for (error, change, issue, cause) in
            INPUT_ERRORS.into_iter().filter(|(error, ..)| NEED_ROTATION.contains(error))
        {
            let diagnose_changed =
                |readings: &[Reading]| diagnose(readings.iter().map(|reading| change(*reading)), rate_hz);
            let with_rotations = diagnose_changed(&all);
            let is_diagnosed = with_rotations.iter().any(|(_, diagnosis)| {
                diagnosis.issue == issue && diagnosis.causes.iter().any(|possible| possible.cause.contains(cause))
            });
            if !is_diagnosed || with_rotations.len() > 1 {
                failures.push(format!("{name}: {error}: {with_rotations:#?}"));
            }
            // Without the rotations, no false diagnosis is made.
            let without_rotations = diagnose_changed(&recorded);
            if without_rotations.iter().any(|(_, diagnosis)| diagnosis.issue != issue) {
                failures.push(format!("{name}: {error}, without rotations: {without_rotations:#?}"));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
