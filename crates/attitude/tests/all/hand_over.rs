//! A hand-over between any two fusers in the middle of a real movement, as a swap makes it.
//!
//! Input: the trials of BROAD without magnetic disturbance, and one with a magnet beside the way; a swap after 30, 50 and 70 % of each.
//! Output: the errors with the swap beside those that giver and receiver have alone, read in two ways: from the swap on, and over the
//! whole trial. Over the whole trial a giver that is the worse of the two before and a receiver that is the worse of the two after
//! add up to more than either with nothing wrong at the swap; what each is alone in its own part is therefore allowed, too.
//! Failure: without the recordings nothing is tested, and the test says so.
//!
//! What holds, the whole attitude where both know magnetic north:
//!
//! - Every fuser hands over the gyro's bias: its own, what another gave it, or what the gyro reads at rest; and its scale, as it was given.
//! - `wz`, `multiple-model` and `vqf` hand over the velocity by which their level leans.
//! - After a giver of small error (`wz`, `multiple-model`, `vqf`), on all six trials, over the whole trial no worse than the worse of
//!   the two plus 0.05°; to `vqf`, which does not find out what a first velocity was off by, 0.07° of the level and 0.1° of the
//!   heading; between `wz` and `multiple-model`, which is the same there, `TO_ITSELF`. From the swap on the level 0.05°, that of `vqf`
//!   0.12°, and the headings 0.25°, because `wz` hands over an error of 1.6° at one of the swaps; `wz-open` 0.55° of 13°.
//! - After any other, on the trials without disturbance, to `wz`, `multiple-model`, `vqf` and `levelling-pi` the level plus 0.05°; to
//!   `wz` and `multiple-model` the heading plus 0.05°, to `vqf` 0.25°. To the others `LIMITS`: a giver that is up to 30° off at the swap
//!   hands that over, and a receiver of fixed gains takes it away with its own time constant; `aided` believes the sum of its own first
//!   spread and what the giver says of itself.
//! - Beside the magnet after such a giver nothing holds: `wz-closed` is 70° off there, and `madgwick` keeps to what it is given.
#[allow(dead_code, reason = "each test file uses its part")]
use std::ops::Add;

use crate::common::{DT_S, Row, broad};
use attitude::{
    Complex, GRAVITY_M_S2, Quaternion, Vector3,
    accel::Projector,
    course::CourseReference,
    fuser::{Estimate, Fused, Fuser, FuserInput, LeakyVelocity},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    stage::Stage,
    state::Attitude,
};
use nalgebra::{Unit, UnitQuaternion};

/// The trials without magnetic disturbance, and one with a magnet beside the way.
const UNDISTURBED: [usize; 5] = [0, 1, 2, 3, 4];
const MAGNET: usize = 7;
/// When it is swapped, as a share of the scored rows.
const MOMENTS: [f64; 3] = [0.3, 0.5, 0.7];
/// Their heading counts from magnetic north.
const MAGNETIC: [&str; 7] = ["wz", "multiple-model", "wz-closed", "wz-open", "madgwick", "madgwick-improved", "vqf"];
/// They follow any movement of the trials with a small error.
const SMALL_ERROR: [&str; 3] = ["wz", "multiple-model", "vqf"];

/// Most over the whole trial, after a giver of small error, degrees.
const WHOLE: Errors = degrees(0.05, 0.05);
/// The same to `vqf`.
const WHOLE_VQF: Errors = degrees(0.07, 0.1);
/// Between `wz` and `multiple-model`, which is the same there: from the swap on, and over the whole trial, degrees. A hand-over of a stage to
/// itself; after the others the larger error of the giver hides it.
const TO_ITSELF: [Errors; 2] = [degrees(0.05, 0.25), degrees(0.05, 0.08)];
/// Most from the swap on after a giver of small error; the same after another, and over the whole trial, degrees.
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
    ("vqf", [degrees(0.12, 0.15), degrees(0.05, 0.25), degrees(0.05, 0.1)]),
];

const fn degrees(inclination: f64, total: f64) -> Errors {
    Errors { inclination, total }
}

/// A trial as the fuser slot sees it.
struct Trial {
    inputs: Vec<FuserInput>,
    truths: Vec<Option<Quaternion<f64>>>,
}

/// Sums of squares over scored rows, rad².
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

/// Root mean squares, degrees, or differences of them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Errors {
    inclination: f64,
    total: f64,
}

impl Errors {
    fn of(sums: Sums) -> Self {
        let rmse = |sum: f64| (sum / sums.count).sqrt().to_degrees();
        Self { inclination: rmse(sums.inclination), total: rmse(sums.total) }
    }

    fn worse(self, other: Self) -> Self {
        Self { inclination: self.inclination.max(other.inclination), total: self.total.max(other.total) }
    }

    fn above(self, other: Self) -> Self {
        Self { inclination: self.inclination - other.inclination, total: self.total - other.total }
    }
}

/// A fuser that ran through the trial: what it had at the swap, and its errors before and after.
struct Alone {
    name: &'static str,
    at_swap: Fuser,
    before: Sums,
    after: Sums,
}

impl Trial {
    fn new(rows: &[Row], magnetic: bool) -> Self {
        let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Projector::default());
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
        Self { inputs, truths: rows.iter().map(|row| row.scored).collect() }
    }

    /// The row at which this share of the scored ones is over.
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

    fn alone(&self, name: &'static str, swap: usize) -> Alone {
        let mut fuser = Fuser::from_name(name).unwrap();
        let before = self.run(&mut fuser, 0..swap);
        let at_swap = fuser.clone();
        Alone { name, at_swap, before, after: self.run(&mut fuser, swap..self.inputs.len()) }
    }

    /// By how much the errors with a swap are above what is allowed: from the swap on, and over the whole trial.
    fn above(&self, swap: usize, giver: &Alone, receiver: &Alone) -> [Errors; 2] {
        let mut fuser = Fuser::from_name(receiver.name).unwrap();
        fuser.adopt(&giver.at_swap.common()).unwrap();
        let after = self.run(&mut fuser, swap..self.inputs.len());
        let whole = |alone: &Alone| Errors::of(alone.before + alone.after);
        let parts = Errors::of(giver.before + receiver.after);
        let allowed = whole(giver).worse(whole(receiver)).worse(parts);
        let later = Errors::of(giver.after).worse(Errors::of(receiver.after));
        [Errors::of(after).above(later), Errors::of(giver.before + after).above(allowed)]
    }
}

/// What is allowed from the swap on, and over the whole trial.
fn limits(giver: &str, receiver: &str) -> [Errors; 2] {
    if [giver, receiver].iter().all(|name| ["wz", "multiple-model"].contains(name)) {
        return TO_ITSELF;
    }
    let (_, [found, later, whole]) = LIMITS.into_iter().find(|(name, _)| *name == receiver).unwrap();
    let found_whole = if receiver == "vqf" { WHOLE_VQF } else { WHOLE };
    if SMALL_ERROR.contains(&giver) { [found, found_whole] } else { [later, whole] }
}

/// Swaps between all pairs in one trial; those that are worse than they may be.
fn too_bad(index: usize, rows: &[Row], magnetic: bool) -> Vec<String> {
    let trial = Trial::new(rows, magnetic);
    let mut worse = Vec::new();
    for share in MOMENTS {
        let swap = trial.row(share);
        let all = Fuser::NAMES.map(|name| trial.alone(name, swap));
        for (giver, receiver) in all.iter().flat_map(|giver| all.iter().map(move |receiver| (giver, receiver))) {
            if giver.name == receiver.name || index == MAGNET && !SMALL_ERROR.contains(&giver.name) {
                continue;
            }
            let above = trial.above(swap, giver, receiver);
            let north = magnetic && [giver, receiver].iter().all(|fuser| MAGNETIC.contains(&fuser.name));
            let line =
                format!("trial {index}, field {magnetic}, {share}: {} to {}: {above:.3?}", giver.name, receiver.name);
            println!("{line}");
            let beyond = |above: &Errors, limit: &Errors| {
                above.inclination > limit.inclination || north && above.total > limit.total
            };
            if above.iter().zip(&limits(giver.name, receiver.name)).any(|(above, limit)| beyond(above, limit)) {
                worse.push(line);
            }
        }
    }
    worse
}

#[test]
fn after_a_swap_the_error_is_no_worse_than_that_of_the_worse_alone() {
    let Some(trials) = broad() else { return };
    let worse = std::thread::scope(|scope| {
        let runs = UNDISTURBED.into_iter().chain([MAGNET]).flat_map(|index| [(index, false), (index, true)]);
        let start = |(index, magnetic): (usize, bool)| {
            let rows = &trials[index];
            scope.spawn(move || too_bad(index, rows, magnetic))
        };
        let runs: Vec<_> = runs.map(start).collect();
        runs.into_iter().flat_map(|run| run.join().unwrap()).collect::<Vec<_>>()
    });
    assert_eq!(worse, Vec::<String>::new());
}

/// Upright, on its side in either chart, and upside down; each with a heading.
fn positions() -> impl Iterator<Item = Attitude> {
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

/// A stage that has taken this over, and what it hands on after `seconds` at rest there.
fn handed_on(name: &str, given: &Estimate, interval_s: f64, seconds: f64) -> Estimate {
    let mut fuser = Fuser::from_name(name).unwrap();
    fuser.adopt(given).unwrap();
    let inclination = Projector::default().step(&(given.attitude.up.direction() * GRAVITY_M_S2));
    for _ in 0..(seconds / interval_s) as u32 {
        fuser.step(&FuserInput {
            motion: Some(Motion { attitude: given.attitude, dt_s: interval_s, ..Motion::default() }),
            inclination: Some(inclination),
            ..FuserInput::default()
        });
    }
    fuser.common()
}

#[test]
fn the_velocity_by_which_the_level_leans_is_handed_on_as_it_was_given() {
    let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(3.0, -2.0), sd_m_s: 0.5 };
    for name in ["wz", "multiple-model", "vqf"] {
        for (attitude, reference) in positions().flat_map(|at| [(at, CourseReference::Arbitrary), (at, CourseReference::Magnetic)])
        {
            let known =
                Estimate { attitude, reference, inclination_sd_rad: 0.01, heading_sd_rad: 0.02, ..Estimate::UNKNOWN };
            let given = Estimate { leaky_velocity, ..known };
            for (interval_s, ticks) in [(0.01, 0.0), (0.0025, 1.0), (0.01, 1.0), (0.02, 1.0)] {
                let on = handed_on(name, &given, interval_s, interval_s * (ticks + 0.5)).leaky_velocity;
                let off_m_s = (on.velocity_m_s - leaky_velocity.velocity_m_s).norm_sqr().sqrt();
                assert!(off_m_s <= 1e-9 + 0.1 * ticks, "{name}, {attitude:?}, {interval_s} s: {on:?}");
                assert!((1.1..1.12).contains(&on.sd_m_s), "{name}: {on:?}");
            }
        }
    }
}

#[test]
fn a_velocity_that_nobody_knows_moves_no_level() {
    for name in Fuser::NAMES {
        for attitude in positions() {
            let known = Estimate { attitude, inclination_sd_rad: 0.01, ..Estimate::UNKNOWN };
            let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(50.0, 0.0), ..LeakyVelocity::UNKNOWN };
            let with = handed_on(name, &Estimate { leaky_velocity, ..known }, 0.01, 1.0);
            assert_eq!(with, handed_on(name, &known, 0.01, 1.0), "{name}");
        }
    }
}

#[test]
fn a_stage_that_makes_no_use_of_the_bias_hands_on_what_it_was_given() {
    let Some(trials) = broad() else { return };
    let trial = Trial::new(&trials[0], true);
    let [out, back] = [0.3, 0.5].map(|share| trial.row(share));
    let given = trial.alone("wz", out).at_swap.common();
    for name in ["wz-closed", "wz-open", "madgwick", "madgwick-improved", "levelling", "levelling-unified"] {
        let mut between = Fuser::from_name(name).unwrap();
        between.adopt(&given).unwrap();
        trial.run(&mut between, out..back);
        let handed_on = between.common();
        assert_eq!(handed_on.bias_rad_s, given.bias_rad_s, "{name}");
        let aged = handed_on.bias_sd_rad_s / given.bias_sd_rad_s;
        assert!((1.0..1.1).contains(&aged) && aged > 1.0, "{name}: {aged}");
    }
}

#[test]
fn every_fuser_hands_over_the_bias_that_the_gyro_has_at_rest() {
    let Some(trials) = broad() else { return };
    // They begin with rest.
    let trial = Trial::new(&trials[0], true);
    let moving = trial.row(0.0);
    let known = trial.alone("vqf", moving).at_swap.common().bias_rad_s;
    for name in Fuser::NAMES {
        assert!(Fuser::from_name(name).unwrap().common().bias_rad_s.norm() == 0.0, "{name}");
        let found = trial.alone(name, moving).at_swap.common();
        let off_deg_s = (found.bias_rad_s - known).amax().to_degrees();
        assert!(off_deg_s < 0.02, "{name}: {off_deg_s} of {:?}", known.map(f64::to_degrees));
        assert!((0.001..0.1).contains(&found.bias_sd_rad_s.to_degrees()), "{name}: {}", found.bias_sd_rad_s);
    }
}

#[test]
fn a_smooth_ride_is_not_taken_for_rest() {
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Projector::default());
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

#[test]
fn a_restart_from_a_snapshot_goes_on_bit_for_bit() {
    let Some(trials) = broad() else { return };
    let trial = Trial::new(&trials[0], true);
    let swap = trial.row(0.5);
    for name in Fuser::NAMES {
        let mut stays = trial.alone(name, swap).at_swap;
        let mut restarted = Fuser::from_name(name).unwrap();
        restarted.restore(&stays.snapshot()).unwrap();
        for (tick, input) in trial.inputs.iter().enumerate().skip(swap) {
            let (a, b) = (stays.step(input), restarted.step(input));
            let bits = |fused: &Fused| {
                let (q, bias) = (fused.attitude.quaternion(), fused.bias_rad_s);
                [q.w, q.i, q.j, q.k, bias.x, bias.y, bias.z, fused.inclination_sd_rad, fused.heading_sd_rad]
                    .map(f64::to_bits)
            };
            assert_eq!(bits(&a), bits(&b), "{name}, tick {tick}");
        }
        assert_eq!(stays.snapshot(), restarted.snapshot(), "{name}");
    }
}
