//! Faulty sensor readings in the complete system: flags, rejected readings, and the recovery time
//! of the attitude.
use std::{fmt::Write, fs, sync::OnceLock};

use crate::common::{Run, System, assert_valid_attitudes, attitudes, inclination_deg, rms};
use scenario::{Motion, SensorErrors, Sensors};

const RATE_HZ: f64 = 200.0;
const ROWS: u64 = 24_000;
/// Time at which every fault starts, s. The estimate has converged by then.
const FAULT_S: f64 = 20.0;
const LAUNCH: &str = "[ingest.replay]\ngyro_samples = \"instants\"\n";

/// Row of a recording.
#[derive(Clone)]
struct Row {
    /// True time of the measurement, s. Its timestamp `t_ns` may differ.
    at_s: f64,
    t_ns: i64,
    rate_rad_s: [f64; 3],
    force_m_s2: [f64; 3],
    /// `true` if ingest must reject the row.
    rejected: bool,
}

impl Row {
    fn truth(&self) -> [f64; 4] {
        let q = Motion::S1.at(self.at_s).attitude.quaternion();
        [q.w, q.i, q.j, q.k]
    }
}

struct Recording {
    rows: Vec<Row>,
    fault_ends_s: f64,
}

impl Recording {
    fn clean() -> Self {
        let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 11);
        let rows = (0..ROWS).map(|count| {
            let at_s = count as f64 / RATE_HZ;
            let reading = sensors.read(at_s);
            Row {
                at_s,
                t_ns: (at_s * 1e9).round() as i64,
                rate_rad_s: reading.rate_rad_s.into(),
                force_m_s2: reading.force_m_s2.into(),
                rejected: false,
            }
        });
        Self { rows: rows.collect(), fault_ends_s: FAULT_S }
    }

    /// Applies `change` to each row during a fault. As its second argument, `change` receives the
    /// last row before the fault.
    fn during(duration_s: f64, change: impl Fn(&mut Row, &Row)) -> Self {
        let mut recording = Self::clean();
        recording.fault_ends_s = FAULT_S + duration_s;
        let before = recording.rows[FAULT - 1].clone();
        let count = (duration_s * RATE_HZ).round() as usize;
        recording.rows[FAULT..].iter_mut().take(count).for_each(|row| change(row, &before));
        recording
    }

    /// Shifts every timestamp after the start of the fault.
    fn with_clock_jump(jump_s: i64) -> Self {
        let mut recording = Self::clean();
        recording.rows[FAULT..].iter_mut().for_each(|row| row.t_ns += jump_s * 1_000_000_000);
        recording
    }

    /// Removes all rows during a fault.
    fn with_gap(duration_s: f64) -> Self {
        let mut recording = Self::during(duration_s, |_, _| ());
        let gap = FAULT_S..recording.fault_ends_s;
        recording.rows.retain(|row| !gap.contains(&row.at_s));
        recording
    }

    fn text(&self) -> String {
        let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz\n");
        for row in &self.rows {
            let ([gx, gy, gz], [ax, ay, az], [qw, qx, qy, qz]) = (row.rate_rad_s, row.force_m_s2, row.truth());
            let t_s = row.t_ns as f64 * 1e-9;
            writeln!(text, "{t_s:.9},{gx},{gy},{gz},{ax},{ay},{az},{qw},{qx},{qy},{qz}").unwrap();
        }
        text
    }

    /// Runs the system and returns the inclination error in degrees at the true time of each tick.
    fn run(&self, arguments: &[&str]) -> (Run, Vec<(f64, f64)>) {
        let system = System::new(LAUNCH);
        let (file, out) = (system.path("bad.csv"), system.path("out.csv"));
        fs::write(&file, self.text()).unwrap();
        let paths = ["--replay", file.to_str().unwrap(), "--out", out.to_str().unwrap(), "--speed", "max"];
        let run = system.run(&[&paths, arguments].concat());
        run.assert_complete();
        let attitudes = attitudes(&out);
        assert_valid_attitudes(&attitudes);
        let ticks: Vec<_> = self.rows.iter().filter(|row| !row.rejected).collect();
        assert_eq!(attitudes.len(), ticks.len(), "{}", run.stderr);
        assert_eq!(run.number("/ticks_out"), ticks.len() as f64);
        let rejected = self.rows.len() - ticks.len();
        let readings = if rejected == 1 { "reading" } else { "readings" };
        assert!(run.line("ticks").ends_with(&format!(" {rejected} {readings} rejected")), "{}", run.stderr);
        let errors = ticks.iter().zip(attitudes).map(|(row, (_, q))| (row.at_s, inclination_deg(q, row.truth())));
        (run, errors.collect())
    }

    /// Runs the system. Asserts that its output has `flags`, and that the error is normal again
    /// within `max_recovery_s` after the fault.
    fn assert_recovers(&self, what: &str, flags: &str, max_recovery_s: f64) {
        let (run, errors) = self.run(&[]);
        let bound_deg = 2.0 * clean_rmse_deg() + 0.05;
        let worst_deg =
            errors.iter().filter(|(at_s, _)| *at_s >= FAULT_S).fold(0.0, |worst: f64, (_, e)| worst.max(*e));
        let below_s = |limit_deg: f64| {
            let last = errors.iter().rfind(|(at_s, error_deg)| *at_s >= FAULT_S && *error_deg > limit_deg);
            last.map_or(0.0, |(at_s, _)| (at_s + 1.0 / RATE_HZ - self.fault_ends_s).max(0.0))
        };
        let recovery_s = below_s(bound_deg);
        println!("| {what} | {worst_deg:.2} | {:.2} | {recovery_s:.2} | {max_recovery_s} |", below_s(1.0));
        let found = run.line("flags").replace(" rate-instant", "").replace(" aligned", "");
        assert_eq!(found.split_whitespace().skip(1).collect::<Vec<_>>().join(" "), flags, "{}", run.stderr);
        assert!(recovery_s <= max_recovery_s, "{what}: recovered below {bound_deg:.3}° after {recovery_s} s");
    }
}

/// Index of the row at which the fault begins.
const FAULT: usize = (FAULT_S * RATE_HZ) as usize;

/// Returns the inclination RMSE in degrees from `FAULT_S` to the end of a fault-free recording.
fn clean_rmse_deg() -> f64 {
    static RMSE_DEG: OnceLock<f64> = OnceLock::new();
    *RMSE_DEG.get_or_init(|| {
        let (_, errors) = Recording::clean().run(&["--in-process"]);
        let largest_deg = errors[FAULT..].iter().fold(0.0, |worst: f64, (_, error_deg)| worst.max(*error_deg));
        let rmse_deg = rms(errors[FAULT..].iter().map(|(_, error_deg)| *error_deg));
        println!("no fault: inclination RMSE {rmse_deg:.3}°, largest {largest_deg:.3}°");
        rmse_deg
    })
}

#[test]
fn clean_recording_has_no_flags() {
    Recording::clean().assert_recovers("no fault", "", 0.0);
}

#[test]
fn single_nan_rate_recovers() {
    Recording::during(0.005, |row, _| row.rate_rad_s[1] = f64::NAN).assert_recovers(
        "one rate NaN",
        "rate-invalid",
        0.0,
    );
}

#[test]
fn nan_rates_for_50_ms_recover() {
    let bad = Recording::during(0.05, |row, _| row.rate_rad_s = [f64::NAN; 3]);
    bad.assert_recovers("rates NaN for 0.05 s", "rate-invalid", 0.0);
}

#[test]
fn nan_rates_for_2_s_recover() {
    let bad = Recording::during(2.0, |row, _| row.rate_rad_s[0] = f64::NAN);
    bad.assert_recovers("rates NaN for 2 s", "rate-invalid", 7.0);
}

#[test]
fn non_finite_forces_for_3_s_recover() {
    let bad = Recording::during(3.0, |row, _| row.force_m_s2 = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
    bad.assert_recovers("forces NaN and infinite for 3 s", "force-invalid", 0.0);
}

#[test]
fn zero_forces_for_1_s_recover() {
    let bad = Recording::during(1.0, |row, _| row.force_m_s2 = [0.0; 3]);
    bad.assert_recovers("|f| = 0 for 1 s", "force-stuck force-small", 0.0);
}

#[test]
fn near_zero_forces_for_1_s_recover() {
    let bad = Recording::during(1.0, |row, _| row.force_m_s2 = row.force_m_s2.map(|x| x * 1e-3));
    bad.assert_recovers("|f| near 0 for 1 s", "force-small", 0.0);
}

#[test]
fn clipped_rates_for_1_s_recover() {
    let bad = Recording::during(1.0, |row, _| row.rate_rad_s[2] = 2000f64.to_radians());
    bad.assert_recovers("rate clipped at 2000 °/s for 1 s", "rate-clipped", 1.0);
}

#[test]
fn values_of_1e300_for_1_s_recover() {
    let bad = Recording::during(1.0, |row, _| (row.rate_rad_s[0], row.force_m_s2[1]) = (1e300, -1e300));
    bad.assert_recovers("rates and forces of 1e300 for 1 s", "rate-invalid force-invalid", 7.0);
}

#[test]
fn duplicated_rows_are_rejected() {
    let mut bad = Recording::during(1.0, |_, _| ());
    for index in (FAULT..FAULT + 200).rev() {
        let duplicate = Row { rejected: true, ..bad.rows[index].clone() };
        bad.rows.insert(index + 1, duplicate);
    }
    bad.assert_recovers("every row twice for 1 s", "refused-before", 0.0);
}

#[test]
fn swapped_rows_are_rejected() {
    let mut bad = Recording::during(1.0, |_, _| ());
    for index in (FAULT..FAULT + 200).step_by(4) {
        bad.rows.swap(index, index + 1);
        bad.rows[index + 1].rejected = true;
    }
    bad.assert_recovers("every second pair swapped for 1 s", "refused-before", 0.0);
}

#[test]
fn stopped_clock_for_1_s_recovers() {
    let bad = Recording::during(1.0, |row, before| row.t_ns = before.t_ns);
    bad.assert_recovers("the clock stopped for 1 s", "clock-leap", 0.0);
}

#[test]
fn clock_jump_by_minus_100_s_starts_segment() {
    let mut bad = Recording::with_clock_jump(-100);
    bad.rows.drain(..FAULT - 200);
    let system = System::new(LAUNCH);
    let file = system.path("bad.csv");
    fs::write(&file, bad.text()).unwrap();
    for (segment, rows) in [(&[][..], bad.rows.len() - 200), (&["--segment", "1"], 200)] {
        let arguments = ["--replay", file.to_str().unwrap(), "--speed", "max", "--in-process"];
        let run = system.run(&[&arguments[..], segment].concat());
        assert!(run.stderr.contains("the log has 2 segments"), "{}", run.stderr);
        assert_eq!(run.number("/ticks_out"), rows as f64, "{}", run.stderr);
    }
}

#[test]
fn clock_jump_by_1000_s_recovers() {
    Recording::with_clock_jump(1000).assert_recovers("the clock set by +1000 s", "clock-leap", 0.0);
}

#[test]
fn gap_of_half_a_second_recovers() {
    Recording::with_gap(0.5).assert_recovers("a gap of 0.5 s", "gap", 5.0);
}

#[test]
fn gap_of_5_s_recovers() {
    Recording::with_gap(5.0).assert_recovers("a gap of 5 s", "gap", 5.0);
}

#[test]
fn stuck_gyro_for_3_s_recovers() {
    let bad = Recording::during(3.0, |row, before| row.rate_rad_s = before.rate_rad_s);
    bad.assert_recovers("the gyro stuck for 3 s", "rate-stuck", 1.0);
}

#[test]
fn stuck_accelerometer_for_3_s_recovers() {
    let bad = Recording::during(3.0, |row, before| row.force_m_s2 = before.force_m_s2);
    bad.assert_recovers("the accelerometer stuck for 3 s", "force-stuck", 15.0);
}

/// The noise is lower than the resolution of 0.01 g, so at rest the force can stay constant
/// indefinitely.
#[test]
fn coarse_accelerometer_at_rest_is_accepted() {
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 5);
    let mut bad = Recording::clean();
    let force_m_s2 = Motion::S1.at(0.0).force_m_s2.map(|x| (x / 0.1).round() * 0.1).into();
    for row in &mut bad.rows {
        let reading = sensors.read(0.0);
        let noise = (reading.force_m_s2 - reading.truth.force_m_s2) * 1e-3;
        row.rate_rad_s = noise.add_scalar(SensorErrors::S1.gyro_bias_rad_s).into();
        row.force_m_s2 = force_m_s2;
        row.at_s = 0.0;
    }
    let (run, errors) = bad.run(&[]);
    assert!(run.line("flags").contains("force-stuck"), "{}", run.stderr);
    let worst_deg = errors.iter().fold(0.0, |worst: f64, (_, error_deg)| worst.max(*error_deg));
    println!("a coarse accelerometer at rest for 120 s: largest error {worst_deg:.2}°");
    assert!(worst_deg < 1.0, "{worst_deg}°");
}

#[test]
fn random_bits_give_valid_attitudes() {
    let mut bits = 1u64;
    let mut number = || {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from_bits(bits ^ (bits >> 29))
    };
    let mut bad = Recording::clean();
    for row in &mut bad.rows {
        row.rate_rad_s = [number(), number(), number()];
        row.force_m_s2 = [number(), number(), number()];
    }
    let (run, _) = bad.run(&[]);
    assert!(run.line("flags").contains("rate-invalid force-invalid"), "{}", run.stderr);
}
