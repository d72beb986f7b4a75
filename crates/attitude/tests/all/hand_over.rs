//! Hand-over between any two fusers in the middle of a recorded movement, as in a swap.
//!
//! Input: trials of BROAD without magnetic disturbance, and one next to a magnet. Each trial has
//! swaps after 30, 50 and 70 % of its scored rows.
//!
//! Output: errors with the swap, compared with the errors of each fuser that runs alone. Two errors
//! are compared: that from the swap on and that over the whole trial.
//!
//! Even a faultless hand-over may have a larger error over the whole trial than either fuser alone.
//! This happens if the first fuser is the worse one before the swap and the second fuser is the
//! worse one after it. The error over the whole trial is therefore also accepted if it does not
//! exceed the error of the first fuser before the swap combined with that of the second fuser after
//! it.
//!
//! Failure: without the recordings the tests are skipped with a message.
//!
//! # Handed-over values
//!
//! - Every fuser hands over a gyro bias: its own estimate, the one received, or the mean rate at
//!   rest. The scale is handed over as received.
//! - `wz`, `multiple-model` and `vqf` hand over the leaky velocity that tilts their level.
//!
//! # Margins
//!
//! A margin is the amount by which the error with the swap may exceed that of the worse fuser. The
//! margins apply to the level, and to the whole attitude if both fusers refer to magnetic north.
//!
//! For a first fuser with a small error (`wz`, `multiple-model` or `vqf`), on all six trials:
//!
//! - The margin of the error over the whole trial is 0.05°. For a swap to `vqf`, which does not
//!   estimate the error of a received velocity, it is 0.07° for the level and 0.1° for the heading.
//!   For swaps between `wz` and `multiple-model`, which have equal errors on these trials, the
//!   margins are in `SAME_FUSER`.
//! - The margin of the error from the swap on is 0.05° for the level (0.12° for the level of `vqf`)
//!   and up to 0.25° for the heading, because `wz` hands over an error of 1.6° at one of the swaps.
//!   After another swap, `wz` alone would have reduced an error that `vqf` keeps.
//!   The heading of `wz-open`, which is wrong by 13°, has a margin of 0.55°.
//!
//! For any other first fuser, on the trials without magnetic disturbance:
//!
//! - The margin is 0.05° for the level of `wz`, `multiple-model`, `vqf` and `levelling-pi`. For the
//!   heading it is 0.05° for `wz` and `multiple-model` and 0.25° for `vqf`.
//! - The margins of the other second fusers are in `LIMITS`. A first fuser that is wrong by up to
//!   30° at the swap hands over that error, and a second fuser with fixed gains removes it with its
//!   own time constant. `aided` adds the reported uncertainty to its own initial one.
//!
//! For any other first fuser, nothing is asserted on the trial next to the magnet, because
//! `wz-closed` is wrong by 70° there and `madgwick` keeps the attitude it receives.
#[allow(dead_code, reason = "each test file uses its part")]
use std::ops::Add;

use crate::common::{DT_S, Row, broad};
use attitude::{
    Complex, GRAVITY_M_S2, Quaternion, Vector3,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Estimate, Fused, Fuser, FuserInput, LeakyVelocity},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    stage::Stage,
    state::Attitude,
};
use nalgebra::{Unit, UnitQuaternion};

/// Indices of the trials without magnetic disturbance.
const UNDISTURBED: [usize; 5] = [0, 1, 2, 3, 4];
/// Index of the trial next to a magnet.
const MAGNET: usize = 7;
/// Positions of the swaps, as shares of the scored rows.
const SWAP_SHARES: [f64; 3] = [0.3, 0.5, 0.7];
/// Fusers with a heading that refers to magnetic north.
const MAGNETIC_FUSERS: [&str; 7] =
    ["wz", "multiple-model", "wz-closed", "wz-open", "madgwick", "madgwick-improved", "vqf"];
/// Fusers with a small error in all movements of the trials.
const ACCURATE_FUSERS: [&str; 3] = ["wz", "multiple-model", "vqf"];

/// Margin for a swap from a fuser with a small error, in degrees. It applies to the error over the
/// whole trial.
const WHOLE_TRIAL: Errors = degrees(0.05, 0.05);
/// Margin, in degrees, for a swap to `vqf` from a fuser with a small error. It applies to the error
/// over the whole trial.
const WHOLE_TRIAL_VQF: Errors = degrees(0.07, 0.1);
/// Margins for swaps between `wz` and `multiple-model`, in degrees.
///
/// The first margin is for the error from the swap on, the second for the error over the whole
/// trial.
///
/// On these trials the two fusers behave identically, so each swap is in effect a hand-over from a
/// fuser to itself. Such a swap shows the effect of the hand-over, which the larger error of other
/// fusers would hide.
const SAME_FUSER: [Errors; 2] = [degrees(0.05, 0.25), degrees(0.05, 0.08)];
/// Margins for each second fuser, in degrees.
///
/// The first margin is for the error from the swap on if the first fuser has a small error. The
/// other two are for any other first fuser: one for the error from the swap on, and one for the
/// error over the whole trial.
const LIMITS: [(&str, [Errors; 3]); 11] = [
    ("wz", [degrees(0.05, 0.2), degrees(0.05, 0.05), degrees(0.05, 0.05)]),
    ("multiple-model", [degrees(0.05, 0.2), degrees(0.05, 0.05), degrees(0.05, 0.05)]),
    ("wz-closed", [degrees(0.05, 0.05), degrees(0.05, 0.5), degrees(0.05, 0.25)]),
    ("wz-open", [degrees(0.05, 0.55), degrees(0.15, 1.2), degrees(0.05, 0.75)]),
    ("madgwick", [degrees(0.05, 0.25), degrees(1.9, 6.4), degrees(1.15, 1.4)]),
    ("madgwick-improved", [degrees(0.05, 0.05), degrees(0.15, 1.2), degrees(0.05, 0.85)]),
    ("levelling", [degrees(0.05, 0.05), degrees(1.6, 0.0), degrees(0.7, 0.0)]),
    ("levelling-unified", [degrees(0.05, 0.05), degrees(1.6, 0.0), degrees(0.7, 0.0)]),
    ("levelling-pi", [degrees(0.05, 0.05), degrees(0.05, 0.0), degrees(0.05, 0.0)]),
    ("aided", [degrees(0.05, 0.05), degrees(2.6, 0.0), degrees(1.9, 0.0)]),
    ("vqf", [degrees(0.12, 0.25), degrees(0.05, 0.25), degrees(0.05, 0.1)]),
];

const fn degrees(inclination: f64, total: f64) -> Errors {
    Errors { inclination, total }
}

/// Inputs of the fuser slot in a trial, and the reference attitudes.
struct Trial {
    inputs: Vec<FuserInput>,
    truths: Vec<Option<Quaternion<f64>>>,
}

/// Sums of squared errors over scored rows, rad².
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    inclination: f64,
    total: f64,
    count: f64,
}

impl Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            inclination: self.inclination + other.inclination,
            total: self.total + other.total,
            count: self.count + other.count,
        }
    }
}

/// Root-mean-square errors, or differences of them, in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Errors {
    inclination: f64,
    total: f64,
}

impl Errors {
    fn from_sums(sums: Sums) -> Self {
        let rmse = |sum: f64| (sum / sums.count).sqrt().to_degrees();
        Self { inclination: rmse(sums.inclination), total: rmse(sums.total) }
    }

    fn max(self, other: Self) -> Self {
        Self { inclination: self.inclination.max(other.inclination), total: self.total.max(other.total) }
    }

    fn minus(self, other: Self) -> Self {
        Self { inclination: self.inclination - other.inclination, total: self.total - other.total }
    }
}

/// State at the swap, and errors before and after it, of one fuser that runs over the whole trial.
struct SoloRun {
    name: &'static str,
    at_swap: Fuser,
    before: Sums,
    after: Sums,
}

impl Trial {
    fn new(rows: &[Row], magnetic: bool) -> Self {
        let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
        let input = |(index, row): (usize, &Row)| {
            let dt_s = if index == 0 { 0.0 } else { DT_S };
            FuserInput {
                motion: Some(gyro.step(&RateSample { rate_rad_s: row.rate_rad_s, dt_s, kind: RateKind::Mean })),
                inclination: Some(accel.step(&row.force_m_s2)),
                field_ut: magnetic.then_some(row.field_ut),
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            }
        };
        let inputs = rows.iter().enumerate().map(input).collect();
        Self { inputs, truths: rows.iter().map(|row| row.reference).collect() }
    }

    /// Returns the index of the row that is preceded by this fraction of the scored rows.
    fn row(&self, share: f64) -> usize {
        let scored: Vec<_> = (0..self.truths.len()).filter(|row| self.truths[*row].is_some()).collect();
        scored[(scored.len() as f64 * share) as usize]
    }

    fn run(&self, fuser: &mut Fuser, rows: std::ops::Range<usize>) -> Sums {
        let mut sums = Sums::default();
        for (input, truth) in self.inputs[rows.clone()].iter().zip(&self.truths[rows]) {
            let Fused { attitude, .. } = fuser.step(input);
            let Some(truth) = truth else { continue };
            let e = attitude.quaternion() * truth.conjugate();
            sums.inclination += (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).powi(2);
            sums.total += (2.0 * e.imag().norm().atan2(e.w.abs())).powi(2);
            sums.count += 1.0;
        }
        sums
    }

    fn run_alone(&self, name: &'static str, swap: usize) -> SoloRun {
        let mut fuser = Fuser::from_name(name).unwrap();
        let before = self.run(&mut fuser, 0..swap);
        let at_swap = fuser.clone();
        SoloRun { name, at_swap, before, after: self.run(&mut fuser, swap..self.inputs.len()) }
    }

    /// Returns the excess of the errors with a swap over those of the fusers alone.
    ///
    /// The first result is for the errors after the swap, the second for those over the whole
    /// trial.
    fn excess(&self, swap: usize, first: &SoloRun, second: &SoloRun) -> [Errors; 2] {
        let mut fuser = Fuser::from_name(second.name).unwrap();
        fuser.adopt(&first.at_swap.common()).unwrap();
        let after = self.run(&mut fuser, swap..self.inputs.len());
        let whole = |run: &SoloRun| Errors::from_sums(run.before + run.after);
        let parts = Errors::from_sums(first.before + second.after);
        let allowed = whole(first).max(whole(second)).max(parts);
        let later = Errors::from_sums(first.after).max(Errors::from_sums(second.after));
        [Errors::from_sums(after).minus(later), Errors::from_sums(first.before + after).minus(allowed)]
    }
}

/// Returns two margins: for the error from the swap on, and for the error over the whole trial.
fn limits(first: &str, second: &str) -> [Errors; 2] {
    if [first, second].iter().all(|name| ["wz", "multiple-model"].contains(name)) {
        return SAME_FUSER;
    }
    let (_, [after_accurate, after_other, whole]) = LIMITS.into_iter().find(|(name, _)| *name == second).unwrap();
    let accurate_whole = if second == "vqf" { WHOLE_TRIAL_VQF } else { WHOLE_TRIAL };
    if ACCURATE_FUSERS.contains(&first) { [after_accurate, accurate_whole] } else { [after_other, whole] }
}

/// Swaps between all pairs of fusers in one trial and describes the swaps that exceed their
/// margins.
fn excessive_errors(index: usize, rows: &[Row], magnetic: bool) -> Vec<String> {
    let trial = Trial::new(rows, magnetic);
    let mut excessive = Vec::new();
    for share in SWAP_SHARES {
        let swap = trial.row(share);
        let all = Fuser::NAMES.map(|name| trial.run_alone(name, swap));
        for (first, second) in all.iter().flat_map(|first| all.iter().map(move |second| (first, second))) {
            if first.name == second.name || index == MAGNET && !ACCURATE_FUSERS.contains(&first.name) {
                continue;
            }
            let excess = trial.excess(swap, first, second);
            let both_magnetic = magnetic && [first, second].iter().all(|fuser| MAGNETIC_FUSERS.contains(&fuser.name));
            let line =
                format!("trial {index}, field {magnetic}, {share}: {} to {}: {excess:.3?}", first.name, second.name);
            println!("{line}");
            let is_beyond = |excess: &Errors, limit: &Errors| {
                excess.inclination > limit.inclination || both_magnetic && excess.total > limit.total
            };
            if excess.iter().zip(&limits(first.name, second.name)).any(|(excess, limit)| is_beyond(excess, limit)) {
                excessive.push(line);
            }
        }
    }
    excessive
}

#[recorded::test]
fn swap_error_stays_within_margins_of_solo_runs() {
    let Some(trials) = broad() else { return };
    let excessive = std::thread::scope(|scope| {
        let runs = UNDISTURBED.into_iter().chain([MAGNET]).flat_map(|index| [(index, false), (index, true)]);
        let start = |(index, magnetic): (usize, bool)| {
            let rows = &trials[index];
            scope.spawn(move || excessive_errors(index, rows, magnetic))
        };
        let runs: Vec<_> = runs.map(start).collect();
        runs.into_iter().flat_map(|run| run.join().unwrap()).collect::<Vec<_>>()
    });
    assert_eq!(excessive, Vec::<String>::new());
}

/// Returns upright attitudes, attitudes tilted to the side in either chart, and inverted attitudes.
fn attitudes() -> impl Iterator<Item = Attitude> {
    let tilts_rad = [0.1, 1.4, 1.7, 3.0_f64];
    tilts_rad.into_iter().zip([0.0, 2.0, -1.0, 3.1]).flat_map(|(tilt_rad, heading_rad)| {
        [0.0, 1.0, 2.5_f64].map(|about_rad| {
            let axis = Unit::new_normalize(Vector3::new(about_rad.cos(), about_rad.sin(), 0.0));
            let tilt = UnitQuaternion::from_axis_angle(&axis, tilt_rad);
            let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
            Attitude::from_quaternion((tilt * heading).into_inner())
        })
    })
}

/// Returns the estimate of a fuser that adopted `estimate` and then rested for `seconds`.
fn estimate_after_rest(name: &str, estimate: &Estimate, interval_s: f64, seconds: f64) -> Estimate {
    let mut fuser = Fuser::from_name(name).unwrap();
    fuser.adopt(estimate).unwrap();
    let inclination = Accelerometer::default().step(&(estimate.attitude.up.direction() * GRAVITY_M_S2));
    for _ in 0..(seconds / interval_s) as u32 {
        fuser.step(&FuserInput {
            motion: Some(Motion { attitude: estimate.attitude, dt_s: interval_s, ..Motion::default() }),
            inclination: Some(inclination),
            ..FuserInput::default()
        });
    }
    fuser.common()
}

#[test]
fn leaky_velocity_is_handed_on_unchanged() {
    let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(3.0, -2.0), sd_m_s: 0.5 };
    for name in ["wz", "multiple-model", "vqf"] {
        for (attitude, reference) in
            attitudes().flat_map(|at| [(at, CourseReference::Arbitrary), (at, CourseReference::Magnetic)])
        {
            let known =
                Estimate { attitude, reference, inclination_sd_rad: 0.01, heading_sd_rad: 0.02, ..Estimate::UNKNOWN };
            let estimate = Estimate { leaky_velocity, ..known };
            for (interval_s, ticks) in [(0.01, 0.0), (0.0025, 1.0), (0.01, 1.0), (0.02, 1.0)] {
                let handed_on =
                    estimate_after_rest(name, &estimate, interval_s, interval_s * (ticks + 0.5)).leaky_velocity;
                let error_m_s = (handed_on.velocity_m_s - leaky_velocity.velocity_m_s).norm_sqr().sqrt();
                assert!(error_m_s <= 1e-9 + 0.1 * ticks, "{name}, {attitude:?}, {interval_s} s: {handed_on:?}");
                assert!((1.1..1.12).contains(&handed_on.sd_m_s), "{name}: {handed_on:?}");
            }
        }
    }
}

#[test]
fn unknown_leaky_velocity_does_not_change_level() {
    for name in Fuser::NAMES {
        for attitude in attitudes() {
            let known = Estimate { attitude, inclination_sd_rad: 0.01, ..Estimate::UNKNOWN };
            let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(50.0, 0.0), ..LeakyVelocity::UNKNOWN };
            let with = estimate_after_rest(name, &Estimate { leaky_velocity, ..known }, 0.01, 1.0);
            assert_eq!(with, estimate_after_rest(name, &known, 0.01, 1.0), "{name}");
        }
    }
}

#[recorded::test]
fn fuser_without_own_bias_hands_on_received_bias() {
    let Some(trials) = broad() else { return };
    let trial = Trial::new(&trials[0], true);
    let [out, back] = [0.3, 0.5].map(|share| trial.row(share));
    let estimate = trial.run_alone("wz", out).at_swap.common();
    for name in ["wz-closed", "wz-open", "madgwick", "madgwick-improved", "levelling", "levelling-unified"] {
        let mut between = Fuser::from_name(name).unwrap();
        between.adopt(&estimate).unwrap();
        trial.run(&mut between, out..back);
        let handed_on = between.common();
        assert_eq!(handed_on.bias_rad_s, estimate.bias_rad_s, "{name}");
        let aged = handed_on.bias_sd_rad_s / estimate.bias_sd_rad_s;
        assert!((1.0..1.1).contains(&aged) && aged > 1.0, "{name}: {aged}");
    }
}

#[recorded::test]
fn every_fuser_hands_over_gyro_bias_found_at_rest() {
    let Some(trials) = broad() else { return };
    // The trials start at rest.
    let trial = Trial::new(&trials[0], true);
    let moving = trial.row(0.0);
    let known = trial.run_alone("vqf", moving).at_swap.common().bias_rad_s;
    for name in Fuser::NAMES {
        assert!(Fuser::from_name(name).unwrap().common().bias_rad_s.norm() == 0.0, "{name}");
        let found = trial.run_alone(name, moving).at_swap.common();
        let error_deg_s = (found.bias_rad_s - known).amax().to_degrees();
        assert!(error_deg_s < 0.02, "{name}: {error_deg_s} of {:?}", known.map(f64::to_degrees));
        assert!((0.001..0.1).contains(&found.bias_sd_rad_s.to_degrees()), "{name}: {}", found.bias_sd_rad_s);
    }
}

#[test]
fn smooth_ride_is_not_detected_as_rest() {
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
    let mut input = |fix: Option<f64>| FuserInput {
        motion: Some(gyro.step(&RateSample { rate_rad_s: [0.0, 0.0, 0.01].into(), dt_s: 0.01, kind: RateKind::Mean })),
        inclination: Some(accel.step(&[0.0, 0.0, 9.81].into())),
        fix: fix.map(|speed_m_s| Fix {
            velocity_m_s: [speed_m_s, 0.0, 0.0].into(),
            sd_m_s: None,
            age_s: None,
            latitude_rad: None,
        }),
        rest_credible: true,
        rate_credible: true,
        ..FuserInput::default()
    };
    for (speed_m_s, rests) in [(None, true), (Some(20.0), false), (Some(0.0), true)] {
        for name in ["madgwick", "madgwick-improved", "wz-closed", "wz-open", "levelling"] {
            let mut fuser = Fuser::from_name(name).unwrap();
            for tick in 0..1000 {
                fuser.step(&input(speed_m_s.filter(|_| tick % 300 == 0)));
            }
            assert_eq!(fuser.common().bias_sd_rad_s.is_finite(), rests, "{name} at {speed_m_s:?} m/s");
        }
    }
}

#[recorded::test]
fn restart_from_snapshot_continues_bit_for_bit() {
    let Some(trials) = broad() else { return };
    let trial = Trial::new(&trials[0], true);
    let swap = trial.row(0.5);
    for name in Fuser::NAMES {
        let mut original = trial.run_alone(name, swap).at_swap;
        let mut restarted = Fuser::from_name(name).unwrap();
        restarted.restore(&original.snapshot()).unwrap();
        for (tick, input) in trial.inputs.iter().enumerate().skip(swap) {
            let (a, b) = (original.step(input), restarted.step(input));
            let bits = |fused: &Fused| {
                let (q, bias) = (fused.attitude.quaternion(), fused.bias_rad_s);
                [q.w, q.i, q.j, q.k, bias.x, bias.y, bias.z, fused.inclination_sd_rad, fused.heading_sd_rad]
                    .map(f64::to_bits)
            };
            assert_eq!(bits(&a), bits(&b), "{name}, tick {tick}");
        }
        assert_eq!(original.snapshot(), restarted.snapshot(), "{name}");
    }
}
