//! The fuser `aided` on flights: the synthetic ones of the scenarios over eight seeds, and a real one.
//!
//! `cargo test --release -p attitude flight:: -- --nocapture` prints every figure.
use std::{io::Read, path::PathBuf};

use crate::common::Once;
use attitude::{
    Quaternion, Vector3,
    accel::Projector,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
    state::{Attitude, wrapped_rad},
    rotation::Rotation,
};
use scenario::Scenario;

const SEEDS: core::ops::RangeInclusive<u64> = 1..=8;
/// Time without a fix after which the body is in a gap, s.
const GAP_S: f64 = 1.5;

struct Chain {
    gyro: Gyro,
    accel: Projector,
    fuser: Fuser,
}

impl Chain {
    fn new(name: &str, settings: &[(&str, f64)]) -> Self {
        let mut fuser = Fuser::from_name(name).unwrap();
        settings.iter().for_each(|(name, value)| fuser.set(name, *value).unwrap());
        Self { gyro: Gyro::from_name("mobius").unwrap(), accel: Projector::default(), fuser }
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

/// Root mean square and largest of what was added.
#[derive(Debug, Clone, Copy, Default)]
struct Rms {
    sum: f64,
    count: f64,
    most: f64,
}

impl Rms {
    fn add(&mut self, x: f64) {
        *self = self.with(Self { sum: x * x, count: 1.0, most: x.abs() });
    }

    fn with(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count, most: self.most.max(other.most) }
    }

    fn get(self) -> f64 {
        if self.count > 0.0 { libm::sqrt(self.sum / self.count) } else { 0.0 }
    }
}

/// Errors in degrees: roll and pitch while there are fixes and while there are none, course, and the largest step of the attitude
/// from one sample to the next that was not the body's.
#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    told: [Rms; 2],
    alone: [Rms; 2],
    course: Rms,
    step: Rms,
    /// Found in the end, s.
    latency_s: Rms,
}

impl Errors {
    fn with(self, other: Self) -> Self {
        let both = |one: [Rms; 2], other: [Rms; 2]| [one[0].with(other[0]), one[1].with(other[1])];
        Self {
            told: both(self.told, other.told),
            alone: both(self.alone, other.alone),
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
            let turned = |from: Attitude, to: Attitude| Rotation::between(from, to).quaternion();
            let step = turned(out_before, out).conjugate() * turned(truth_before, truth);
            errors.step.add((2.0 * step.imag().norm()).to_degrees());
            let (got, want) = (out.angles(), truth.angles());
            let level = if since_fix_s > GAP_S { &mut errors.alone } else { &mut errors.told };
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

fn flown(name: &str) -> Errors {
    flown_by("aided", name, &[])
}

/// All seeds of a scenario, two at a time.
fn flown_by(fuser: &str, name: &str, settings: &[(&str, f64)]) -> Errors {
    static FLOWN: Once<Errors> = Once::new();
    FLOWN.of(&format!("{fuser} {name} {settings:?}"), || fly_seeds(fuser, name, settings))
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
        format!("{:.3} / {:.3} (max {:.2} / {:.2})", roll.get(), pitch.get(), roll.most, pitch.most)
    };
    println!(
        "{fuser}, {name}: roll / pitch with fixes {}, without {}; course {:.2}; step {:.4}, deg; latency {:.3} s (max {:.3})",
        pair(errors.told),
        pair(errors.alone),
        errors.course.get(),
        errors.step.most,
        errors.latency_s.get(),
        errors.latency_s.most
    );
    errors
}

fn within(level: [Rms; 2], limit_deg: f64) -> bool {
    level.iter().all(|axis| axis.count > 0.0 && axis.get() <= limit_deg)
}

#[test]
fn with_fixes_all_the_time_roll_and_pitch_are_good_to_a_twentieth_of_a_degree() {
    let errors = flown("cruise");
    assert!(within(errors.told, 0.05) && errors.course.get() < 0.3);
}

#[test]
fn in_gaps_of_a_minute_nothing_is_lost_and_nothing_jumps() {
    let errors = flown("cruise?gnss=gaps");
    assert!(within(errors.told, 0.05) && within(errors.alone, 0.06));
    assert!(errors.step.most < 0.02);
}

#[test]
fn twenty_minutes_without_a_fix_cost_a_tenth_of_a_degree() {
    assert!(within(flown("cruise?gnss=start").alone, 0.15));
}

#[test]
fn without_any_fix_gravity_and_the_turns_level_it() {
    assert!(within(flown("cruise?gnss=never").alone, 0.7));
}

#[test]
fn wind_gusts_slip_scale_error_and_drift_are_borne() {
    assert!(within(flown("cruise-hard").told, 0.15));
    let gaps = flown("cruise-hard?gnss=gaps");
    assert!(within(gaps.told, 0.15) && within(gaps.alone, 0.2));
    assert!(gaps.step.most < 0.02);
    assert!(within(flown("cruise-hard?gnss=start").alone, 0.8));
}

#[test]
fn a_latency_from_a_tenth_to_four_tenths_of_a_second_is_found() {
    for latency_s in [0.1, 0.2, 0.3, 0.4] {
        let errors = flown(&format!("cruise?gnss_latency_s={latency_s}"));
        let off_s = [errors.latency_s.get(), errors.latency_s.most].map(|found_s| (found_s - latency_s).abs());
        assert!(off_s.iter().all(|off_s| *off_s < 0.015), "{latency_s} s: off by {off_s:?} s");
        assert!(within(errors.told, 0.05) && errors.course.get() < 0.3);
    }
}

#[test]
fn the_place_of_the_antenna_takes_off_what_its_lever_arm_adds() {
    let flight = "cruise?antenna_right_m=-3&antenna_forward_m=6&antenna_up_m=2";
    let set =
        |sign: f64| [("antenna_right_m", -3.0 * sign), ("antenna_forward_m", 6.0 * sign), ("antenna_up_m", 2.0 * sign)];
    let [right, none, wrong] = [1.0, 0.0, -1.0].map(|sign| flown_by("aided", flight, &set(sign)));
    assert!(within(right.told, 0.05) && right.course.get() < 0.3);
    let above = |errors: Errors, limit_deg: f64| errors.told.iter().all(|axis| axis.get() > limit_deg);
    assert!(above(none, 0.08) && above(wrong, 0.16));
}

#[test]
fn multiple_model_flies_as_aided_where_a_receiver_tells_the_velocity() {
    for flight in ["cruise", "cruise?gnss=gaps", "cruise?gnss=start"] {
        let [one, both] = ["aided", "multiple-model"].map(|fuser| flown_by(fuser, flight, &[]));
        for (one, both) in one.told.iter().chain(&one.alone).zip(both.told.iter().chain(&both.alone)) {
            assert!(both.get() <= 1.02 * one.get(), "{flight}: {} against {}", both.get(), one.get());
        }
        assert!(both.course.get() <= 1.02 * one.course.get() && both.step.most < 0.02);
    }
}

#[test]
fn multiple_model_is_levelled_by_the_turns_without_a_receiver() {
    assert!(within(flown_by("multiple-model", "cruise?gnss=never", &[]).alone, 2.0));
}

/// A recorded flight: time, rate, force, the autopilot's own attitude where it counts, the fix that arrived.
struct Row {
    t_s: f64,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    reference: Quaternion<f64>,
    flying: bool,
    fix: Option<Fix>,
}

fn recorded() -> Option<Vec<Row>> {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::var_os("PLUMBLINE_DATA").map_or_else(|| here.join("../../../shared/data"), PathBuf::from);
    let Ok(file) = std::fs::File::open(folder.join("flights/apm_plane_log2_imu.csv.gz")) else {
        assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no flight at {}", folder.display());
        eprintln!("skipped: no flight at {} (PLUMBLINE_DATA names another place)", folder.display());
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

/// RMS of inclination and heading from a minute after take-off on, deg; `covered` is told the time since that minute.
fn over_the_flight(fuser: &str, name: &str, rows: &[Row], covered: impl Fn(f64) -> bool) -> [f64; 2] {
    let from_s = rows.iter().find(|row| row.flying).unwrap().t_s + 60.0;
    let (mut chain, mut before_s) = (Chain::new(fuser, &[]), rows[0].t_s);
    let [mut inclination, mut heading] = [Rms::default(); 2];
    for row in rows {
        let sample = RateSample { rate_rad_s: row.rate_rad_s, dt_s: row.t_s - before_s, kind: RateKind::Mean };
        before_s = row.t_s;
        let fix = row.fix.filter(|_| covered(row.t_s - from_s));
        let out = chain.step(&sample, row.force_m_s2, fix);
        if row.flying && row.t_s >= from_s {
            let e = out.attitude.quaternion() * row.reference.conjugate();
            inclination.add(2.0 * libm::acos(libm::hypot(e.w, e.k).min(1.0)).to_degrees());
            heading.add(2.0 * libm::atan(e.k / e.w).to_degrees());
        }
    }
    assert_eq!(chain.fuser.validation_error(), None);
    let rms = [inclination.get(), heading.get()];
    println!("{fuser}, apm_plane_log2, {name}: inclination {:.2}, heading {:.2}, deg", rms[0], rms[1]);
    rms
}

/// Its reference is the solution of an autopilot, good to some 2 to 4°, and the flight is aerobatic.
#[test]
fn a_real_flight_is_followed_without_a_magnetometer() {
    let Some(rows) = recorded() else { return };
    let [inclination, heading] = over_the_flight("aided", "fixes all the time", &rows, |_| true);
    assert!(inclination < 4.8 && heading < 5.5);
    let [inclination, heading] =
        over_the_flight("aided", "gaps of 60 s every 120 s", &rows, |t_s| t_s < 0.0 || t_s % 120.0 < 60.0);
    assert!(inclination < 5.3 && heading < 6.0);
    let [inclination, _] = over_the_flight("aided", "none after the first minute", &rows, |t_s| t_s < 0.0);
    assert!(inclination < 5.0);
    let [inclination, _] = over_the_flight("aided", "none", &rows, |_| false);
    assert!(inclination < 8.6);
}

#[test]
fn a_real_flight_without_a_receiver_is_levelled_by_its_turns() {
    let Some(rows) = recorded() else { return };
    let [told, _] = over_the_flight("multiple-model", "fixes all the time", &rows, |_| true);
    let [alone, _] = over_the_flight("multiple-model", "none", &rows, |_| false);
    assert!(told < 4.8 && alone < 16.0);
}
