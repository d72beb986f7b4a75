//! Where the motion does not show which axis of the gyro is which: it shows once the body has been turned by 90° about each axis.

use std::f64::consts::FRAC_PI_2;

use crate::common::{MISTAKES, data, judged, rate_hz, readings};
use attitude::Vector3;
use ingest::source::Reading;

/// Recordings with mere translation, at rest, and of coordinated turns.
const SHOW_NO_AXES: [&str; 5] = [
    "broad/11_undisturbed_slow_translation_B.csv.gz",
    "broad/15_undisturbed_fast_translation_A.csv.gz",
    "broad/27_disturbed_phone_vibration_B.csv.gz",
    "broad/29_disturbed_stationary_magnet_B.csv.gz",
    "flights/apm_plane_log2_imu.csv.gz",
];
/// Mistakes that are seen by turns alone.
const BY_TURNS: [&str; 7] = [
    "rates converted twice",
    "left-handed axes",
    "a negated gyro",
    "an axis of the gyro negated",
    "axes of the gyro exchanged",
    "an axis stuck",
    "an axis of the force stuck",
];
/// A turn by 90°, and the rest after it, s.
const TURN_S: f64 = 2.0;
const REST_S: f64 = 0.5;
const GRAVITY_M_S2: f64 = 9.81;

/// Readings of a level body that is turned by 90° about x, z and y in turn, each level then, and back.
fn turns(rate_hz: f64) -> Vec<Reading> {
    let about = [Vector3::x(), Vector3::z(), Vector3::y(), -Vector3::y(), -Vector3::z(), -Vector3::x()];
    let mut up = Vector3::z();
    let mut all = Vec::new();
    for axis in about {
        for step in 0..((TURN_S + REST_S) * rate_hz) as u32 {
            // As a hand turns: it begins and ends slowly.
            let turned_rad = |t_s: f64| FRAC_PI_2 * (1.0 - (FRAC_PI_2 * 2.0 * (t_s / TURN_S).min(1.0)).cos()) / 2.0;
            let t_s = f64::from(step) / rate_hz;
            let turn_rad = turned_rad(t_s + 1.0 / rate_hz) - turned_rad(t_s);
            // The axis is level: up turns the other way in a plane across it.
            up = up * turn_rad.cos() - axis.cross(&up) * turn_rad.sin();
            // No axis of a real sensor stands still.
            let noise = Vector3::new(31.0, 37.0, 41.0).map(|rad_s| (rad_s * t_s).sin());
            let rate = axis * turn_rad * rate_hz + noise * 1e-3;
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

/// The recording after these turns.
fn after_turns(readings: &[Reading], rate_hz: f64) -> Vec<Reading> {
    let mut all = turns(rate_hz);
    let later_ns = (all.len() as f64 * 1e9 / rate_hz) as i64 - readings[0].t_ns;
    all.extend(readings.iter().map(|reading| Reading { t_ns: reading.t_ns + later_ns, ..*reading }));
    all
}

#[test]
fn mistakes_that_the_motion_does_not_show_are_named_once_the_body_was_turned_about_each_axis() {
    let mut failures = Vec::new();
    for name in SHOW_NO_AXES {
        let path = data().join(name);
        if !path.is_file() {
            eprintln!("skipped: no {}; set PLUMBLINE_DATA", path.display());
            continue;
        }
        let recorded = readings(&path);
        let rate_hz = rate_hz(&recorded);
        let all = after_turns(&recorded, rate_hz);
        let found = judged(all.iter().copied(), rate_hz);
        assert!(found.is_empty(), "{name} with turns: {found:#?}");
        for (made, change, mistake, cause) in MISTAKES.into_iter().filter(|(made, ..)| BY_TURNS.contains(made)) {
            let of = |readings: &[Reading]| judged(readings.iter().map(|reading| change(*reading)), rate_hz);
            let turned = of(&all);
            let is_named = turned.iter().any(|(_, finding)| {
                finding.mistake == mistake && finding.candidates.iter().any(|candidate| candidate.cause.contains(cause))
            });
            if !is_named || turned.len() > 1 {
                failures.push(format!("{name}: {made}: {turned:#?}"));
            }
            // Without them nothing that is wrong is said.
            let unturned = of(&recorded);
            if unturned.iter().any(|(_, finding)| finding.mistake != mistake) {
                failures.push(format!("{name}: {made}, not turned: {unturned:#?}"));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
