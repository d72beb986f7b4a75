//! Fuser `aided` on flights: scenarios with eight seeds each, and a recorded flight.
//!
//! `cargo test --release -p plumbline-attitude flight:: -- --nocapture` prints every figure.
use std::{io::Read, path::PathBuf};

use crate::common::ResultCache;
use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, RateKind, RateSample},
    rotation::Rotation,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};
use scenario::Scenario;

const SEEDS: core::ops::RangeInclusive<u64> = 1..=8;
/// Time since the last fix above which an error counts towards `without_fixes`, s.
const MIN_GAP_S: f64 = 1.5;

struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
}

impl Chain {
    fn new(name: &str, settings: &[(&str, f64)]) -> Self {
        let mut fuser = Fuser::from_name(name).unwrap();
        settings.iter().for_each(|(name, value)| fuser.set(name, *value).unwrap());
        Self { gyro: Gyro::from_name("mobius").unwrap(), accel: Accelerometer::default(), fuser }
    }

    fn step(&mut self, sample: &RateSample, force_m_s2: Vector3<f64>, fix: Option<Fix>) -> Fused {
        self.fuser.step(&FuserInput {
            motion: Some(self.gyro.step(sample)),
            inclination: Some(self.accel.step(&force_m_s2)),
            field_ut: None,
            fix,
            rest_credible: true,
            rate_credible: true,
        })
    }
}

/// Root mean square and maximum of the added values.
#[derive(Debug, Clone, Copy, Default)]
struct Rms {
    sum: f64,
    count: f64,
    max: f64,
}

impl Rms {
    fn add(&mut self, x: f64) {
        *self = self.with(Self { sum: x * x, count: 1.0, max: x.abs() });
    }

    fn with(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count, max: self.max.max(other.max) }
    }

    fn value(self) -> f64 {
        if self.count > 0.0 { libm::sqrt(self.sum / self.count) } else { 0.0 }
    }
}

/// Errors in degrees.
///
/// `with_fixes` and `without_fixes` hold the errors of roll and pitch. `step` is the part of the
/// attitude change between samples that is not motion of the body.
#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    with_fixes: [Rms; 2],
    without_fixes: [Rms; 2],
    course: Rms,
    step: Rms,
    /// Receiver latency as estimated at the end of the flight, s.
    latency_s: Rms,
}

impl Errors {
    fn with(self, other: Self) -> Self {
        let both = |one: [Rms; 2], other: [Rms; 2]| [one[0].with(other[0]), one[1].with(other[1])];
        Self {
            with_fixes: both(self.with_fixes, other.with_fixes),
            without_fixes: both(self.without_fixes, other.without_fixes),
            course: self.course.with(other.course),
            step: self.step.with(other.step),
            latency_s: self.latency_s.with(other.latency_s),
        }
    }
}

fn fly(scenario: &Scenario, name: &str, settings: &[(&str, f64)]) -> Errors {
    let (mut chain, mut errors, mut since_fix_s) = (Chain::new(name, settings), Errors::default(), f64::INFINITY);
    let mut before: Option<(f64, Attitude, Attitude)> = None;
    for (t_s, reading) in scenario.readings() {
        let dt_s = before.map_or(0.0, |(before_s, ..)| t_s - before_s);
        since_fix_s = if reading.fix.is_some() { 0.0 } else { since_fix_s + dt_s };
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
        let out = chain.step(&sample, reading.force_m_s2, reading.fix).attitude;
        let truth = reading.truth.attitude;
        if let (true, Some((_, out_before, truth_before))) = (t_s > scenario.scored_from_s, before) {
            let rotation = |from: Attitude, to: Attitude| Rotation::between(from, to).quaternion();
            let step = rotation(out_before, out).conjugate() * rotation(truth_before, truth);
            errors.step.add((2.0 * step.imag().norm()).to_degrees());
            let (got, want) = (out.angles(), truth.angles());
            let level = if since_fix_s > MIN_GAP_S { &mut errors.without_fixes } else { &mut errors.with_fixes };
            level[0].add(wrapped_rad(got.roll_rad - want.roll_rad).to_degrees());
            level[1].add((got.pitch_rad - want.pitch_rad).to_degrees());
            errors.course.add(wrapped_rad(got.yaw_rad - want.yaw_rad).to_degrees());
        }
        before = Some((t_s, out, truth));
    }
    assert_eq!(chain.fuser.validation_error(), None);
    if let Fuser::Aided(aided) = &chain.fuser {
        errors.latency_s.add(aided.latency_s());
    }
    errors
}

fn errors_of_aided(name: &str) -> Errors {
    errors_of("aided", name, &[])
}

/// Returns the errors over all seeds of a scenario, computed once.
fn errors_of(fuser: &str, name: &str, settings: &[(&str, f64)]) -> Errors {
    static ERRORS: ResultCache<Errors> = ResultCache::new();
    ERRORS.get_or_compute(&format!("{fuser} {name} {settings:?}"), || fly_seeds(fuser, name, settings))
}

fn fly_seeds(fuser: &str, name: &str, settings: &[(&str, f64)]) -> Errors {
    let seeds: Vec<u64> = SEEDS.collect();
    let fly_all = |seeds: &[u64]| {
        let each = seeds.iter().map(|seed| fly(&Scenario::parse(name).unwrap().with_seed(*seed), fuser, settings));
        each.fold(Errors::default(), Errors::with)
    };
    let (first, second) = seeds.split_at(seeds.len() / 2);
    let errors = std::thread::scope(|scope| {
        let other = scope.spawn(|| fly_all(second));
        fly_all(first).with(other.join().unwrap())
    });
    let pair = |level: [Rms; 2]| {
        let [roll, pitch] = level;
        format!("{:.3} / {:.3} (max {:.2} / {:.2})", roll.value(), pitch.value(), roll.max, pitch.max)
    };
    println!(
        "{fuser}, {name}: roll / pitch with fixes {}, without {}; course {:.2}; step {:.4}, deg; latency {:.3} s (max {:.3})",
        pair(errors.with_fixes),
        pair(errors.without_fixes),
        errors.course.value(),
        errors.step.max,
        errors.latency_s.value(),
        errors.latency_s.max
    );
    errors
}

fn within(level: [Rms; 2], limit_deg: f64) -> bool {
    level.iter().all(|axis| axis.count > 0.0 && axis.value() <= limit_deg)
}

#[test]
fn cruise_with_fixes_is_within_0_05_degrees() {
    let errors = errors_of_aided("cruise");
    assert!(within(errors.with_fixes, 0.05) && errors.course.value() < 0.3);
}

#[test]
fn cruise_through_60_s_gaps_stays_accurate_without_jump() {
    let errors = errors_of_aided("cruise?gnss=gaps");
    assert!(within(errors.with_fixes, 0.05) && within(errors.without_fixes, 0.06));
    assert!(errors.step.max < 0.02);
}

#[test]
fn cruise_20_min_without_fix_is_within_0_15_degrees() {
    assert!(within(errors_of_aided("cruise?gnss=start").without_fixes, 0.15));
}

#[test]
fn cruise_without_any_fix_is_within_0_7_degrees() {
    assert!(within(errors_of_aided("cruise?gnss=never").without_fixes, 0.7));
}

#[test]
fn hard_cruise_stays_within_limits() {
    assert!(within(errors_of_aided("cruise-hard").with_fixes, 0.15));
    let gaps = errors_of_aided("cruise-hard?gnss=gaps");
    assert!(within(gaps.with_fixes, 0.15) && within(gaps.without_fixes, 0.2));
    assert!(gaps.step.max < 0.02);
    assert!(within(errors_of_aided("cruise-hard?gnss=start").without_fixes, 0.8));
}

#[test]
fn receiver_latency_of_0_1_to_0_4_s_is_estimated() {
    for latency_s in [0.1, 0.2, 0.3, 0.4] {
        let errors = errors_of_aided(&format!("cruise?gnss_latency_s={latency_s}"));
        let error_s = [errors.latency_s.value(), errors.latency_s.max].map(|found_s| (found_s - latency_s).abs());
        assert!(error_s.iter().all(|error_s| *error_s < 0.015), "{latency_s} s: error {error_s:?} s");
        assert!(within(errors.with_fixes, 0.05) && errors.course.value() < 0.3);
    }
}

#[test]
fn antenna_position_removes_lever_arm_error() {
    let flight = "cruise?antenna_right_m=-3&antenna_forward_m=6&antenna_up_m=2";
    let set =
        |sign: f64| [("antenna_right_m", -3.0 * sign), ("antenna_forward_m", 6.0 * sign), ("antenna_up_m", 2.0 * sign)];
    let [right, none, wrong] = [1.0, 0.0, -1.0].map(|sign| errors_of("aided", flight, &set(sign)));
    assert!(within(right.with_fixes, 0.05) && right.course.value() < 0.3);
    let above = |errors: Errors, limit_deg: f64| errors.with_fixes.iter().all(|axis| axis.value() > limit_deg);
    assert!(above(none, 0.08) && above(wrong, 0.16));
}

#[test]
fn multiple_model_with_fixes_matches_aided() {
    for flight in ["cruise", "cruise?gnss=gaps", "cruise?gnss=start"] {
        let [aided, both] = ["aided", "multiple-model"].map(|fuser| errors_of(fuser, flight, &[]));
        for (aided, both) in
            aided.with_fixes.iter().chain(&aided.without_fixes).zip(both.with_fixes.iter().chain(&both.without_fixes))
        {
            assert!(both.value() <= 1.02 * aided.value(), "{flight}: {} against {}", both.value(), aided.value());
        }
        assert!(both.course.value() <= 1.02 * aided.course.value() && both.step.max < 0.02);
    }
}

#[test]
fn multiple_model_without_fixes_is_levelled_by_turns() {
    assert!(within(errors_of("multiple-model", "cruise?gnss=never", &[]).without_fixes, 2.0));
}

/// Sample of a recorded flight, with the autopilot's attitude estimate and the fix, if any.
struct Row {
    t_s: f64,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    reference: Quaternion<f64>,
    flying: bool,
    fix: Option<Fix>,
}

fn recorded_flight() -> Option<Vec<Row>> {
    let crate_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let folder =
        std::env::var_os("PLUMBLINE_DATA").map_or_else(|| crate_folder.join("../../../shared/data"), PathBuf::from);
    let Ok(file) = std::fs::File::open(folder.join("flights/apm_plane_log2_imu.csv.gz")) else {
        assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no flight in {}", folder.display());
        eprintln!("skipped: no flight in {}; set PLUMBLINE_DATA to the folder of the recordings", folder.display());
        return None;
    };
    let mut imu = String::new();
    flate2::read::MultiGzDecoder::new(file).read_to_string(&mut imu).unwrap();
    let gnss = std::fs::read_to_string(folder.join("flights/apm_plane_log2_gnss.csv")).unwrap();
    let numbers = |line: &str| line.split(',').map(|x| x.parse().unwrap()).collect::<Vec<f64>>();
    let mut fixes = gnss.lines().skip(1).map(numbers).peekable();
    let row = |line: &str| {
        let x = numbers(line);
        let vector = |x: &[f64]| Vector3::new(x[0], x[1], x[2]);
        let mut fix = None;
        while let Some(arrived) = fixes.next_if(|arrived| arrived[0] <= x[0]) {
            let velocity_m_s = vector(&arrived[1..4]);
            fix = Some(Fix { velocity_m_s, sd_m_s: None, age_s: None, latitude_rad: Some(arrived[4].to_radians()) });
        }
        Row {
            t_s: x[0],
            rate_rad_s: vector(&x[1..4]),
            force_m_s2: vector(&x[4..7]),
            reference: Quaternion::new(x[10], x[11], x[12], x[13]),
            flying: x[14] == 1.0,
            fix,
        }
    };
    Some(imu.lines().skip(1).map(row).collect())
}

/// Returns the RMS errors of inclination and heading in degrees, starting one minute after
/// take-off.
///
/// `is_covered` receives the time (s) since the start of this period. Fixes are used only while it
/// returns `true`.
fn errors_over_flight(fuser: &str, name: &str, rows: &[Row], is_covered: impl Fn(f64) -> bool) -> [f64; 2] {
    let from_s = rows.iter().find(|row| row.flying).unwrap().t_s + 60.0;
    let (mut chain, mut before_s) = (Chain::new(fuser, &[]), rows[0].t_s);
    let [mut inclination, mut heading] = [Rms::default(); 2];
    for row in rows {
        let sample = RateSample { rate_rad_s: row.rate_rad_s, dt_s: row.t_s - before_s, kind: RateKind::Mean };
        before_s = row.t_s;
        let fix = row.fix.filter(|_| is_covered(row.t_s - from_s));
        let out = chain.step(&sample, row.force_m_s2, fix);
        if row.flying && row.t_s >= from_s {
            let e = out.attitude.quaternion() * row.reference.conjugate();
            inclination.add(2.0 * libm::acos(libm::hypot(e.w, e.k).min(1.0)).to_degrees());
            heading.add(2.0 * libm::atan(e.k / e.w).to_degrees());
        }
    }
    assert_eq!(chain.fuser.validation_error(), None);
    let rms = [inclination.value(), heading.value()];
    println!("{fuser}, apm_plane_log2, {name}: inclination {:.2}, heading {:.2}, deg", rms[0], rms[1]);
    rms
}

/// The limits are wide, because the flight is aerobatic and the reference is the solution of an
/// autopilot, with errors of 2 to 4°.
#[recorded::test]
fn real_flight_without_magnetometer_is_within_limits() {
    let Some(rows) = recorded_flight() else { return };
    let [inclination, heading] = errors_over_flight("aided", "fixes all the time", &rows, |_| true);
    assert!(inclination < 4.8 && heading < 5.5);
    let [inclination, heading] =
        errors_over_flight("aided", "gaps of 60 s every 120 s", &rows, |t_s| t_s < 0.0 || t_s % 120.0 < 60.0);
    assert!(inclination < 5.3 && heading < 6.0);
    let [inclination, _] = errors_over_flight("aided", "none after the first minute", &rows, |t_s| t_s < 0.0);
    assert!(inclination < 5.0);
    let [inclination, _] = errors_over_flight("aided", "none", &rows, |_| false);
    assert!(inclination < 8.6);
}

#[recorded::test]
fn real_flight_without_receiver_is_levelled_by_turns() {
    let Some(rows) = recorded_flight() else { return };
    let [with_fixes, _] = errors_over_flight("multiple-model", "fixes all the time", &rows, |_| true);
    let [without_fixes, _] = errors_over_flight("multiple-model", "none", &rows, |_| false);
    assert!(with_fixes < 4.8 && without_fixes < 16.0);
}
