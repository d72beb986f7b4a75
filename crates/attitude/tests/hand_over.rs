//! A hand-over between any two fusers in the middle of a real movement, as a swap makes it.
//!
//! Input: a trial of BROAD without magnetic disturbance. Output: the errors after the hand-over beside those that giver and receiver
//! have alone over the same rows. The measure is the RMSE from the hand-over on: over the whole trial a giver that was the worse of the two
//! before, and a receiver that is the worse of the two after, add up to more than either, with nothing wrong at the hand-over.
//! Failure: without the recordings nothing is tested, and the test says so.
//!
//! What holds on this trial, to 0.05° above the worse of the two: the inclination, with the magnetic field and without, and the whole
//! attitude of all that know magnetic north, but for
//!
//! - the inclination of `aided` after a giver without an estimate of the gyro's bias, 0.2°: alone it has found the bias at rest before the
//!   movement, which such a giver cannot hand over; in the movement there is nothing to find it by without a receiver;
//! - the whole attitude of `wz` after a giver that does not estimate the gyro's scale, 0.12°: alone it has learnt the scale from the
//!   turns before, and finds it anew;
//! - the whole attitude of `vqf`: it takes what the giver's heading is off by away with its own time constant of 9 s, and half as fast
//!   until it knows the field of the place, in 20 s.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[allow(dead_code, reason = "each test file uses its part")]
mod common;

use attitude::{
    Quaternion,
    accel::Projector,
    fuser::{Estimate, Fused, Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
};
use common::{DT_S, Row, broad};

/// Most that the RMSE may be above the worse of the two, degrees.
const WORSE_DEG: f64 = 0.05;
/// The same for the inclination of `aided` after a giver without an estimate of the gyro's bias, degrees.
const WORSE_WITHOUT_BIAS_DEG: f64 = 0.2;
/// The same for the whole attitude of `wz`, which finds the gyro's scale anew, degrees.
const WORSE_WITHOUT_SCALE_DEG: f64 = 0.12;
/// Their heading counts from magnetic north.
const MAGNETIC: [&str; 6] = ["wz", "wz-closed", "wz-open", "madgwick", "madgwick-improved", "vqf"];

/// A trial as the fuser slot sees it.
struct Trial {
    inputs: Vec<FuserInput>,
    truths: Vec<Option<Quaternion<f64>>>,
    /// The row of the hand-over: half of the scored ones are before it.
    middle: usize,
}

/// Root mean squares over scored rows, degrees.
#[derive(Debug, Clone, Copy)]
struct Errors {
    inclination: f64,
    total: f64,
}

impl Errors {
    fn worse(self, other: Self) -> Self {
        Self { inclination: self.inclination.max(other.inclination), total: self.total.max(other.total) }
    }
}

/// A fuser that ran through the first half, and its errors in the second, had it gone on.
struct Alone {
    name: &'static str,
    in_the_middle: Fuser,
    common: Estimate,
    later: Errors,
}

impl Trial {
    fn new(rows: &[Row], magnetic: bool) -> Self {
        let (mut gyro, mut accel) = (Gyro::named("mobius").unwrap(), Projector::default());
        let input = |(index, row): (usize, &Row)| {
            let dt_s = if index == 0 { 0.0 } else { DT_S };
            FuserInput {
                motion: Some(gyro.step(&RateSample { rate_rad_s: row.rate_rad_s, dt_s, kind: RateKind::Mean })),
                inclination: Some(accel.step(&row.force_m_s2)),
                field_ut: magnetic.then_some(row.field_ut),
                rest_credible: true,
                ..FuserInput::default()
            }
        };
        let inputs = rows.iter().enumerate().map(input).collect();
        let truths: Vec<_> = rows.iter().map(|row| row.scored).collect();
        let scored: Vec<_> = (0..rows.len()).filter(|index| truths[*index].is_some()).collect();
        Self { inputs, truths, middle: scored[scored.len() / 2] }
    }

    fn first_half(&self, fuser: &mut Fuser) {
        self.inputs[..self.middle].iter().for_each(|input| {
            fuser.step(input);
        });
    }

    /// Errors of a fuser that goes on from the middle.
    fn second_half(&self, mut fuser: Fuser) -> Errors {
        let (mut inclination, mut total, mut count) = (0.0, 0.0, 0.0);
        for (input, truth) in self.inputs.iter().zip(&self.truths).skip(self.middle) {
            let Fused { attitude, .. } = fuser.step(input);
            let Some(truth) = truth else { continue };
            let e = attitude.quaternion() * truth.conjugate();
            inclination += (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).powi(2);
            total += (2.0 * e.imag().norm().atan2(e.w.abs())).powi(2);
            count += 1.0;
        }
        let rmse = |sum: f64| (sum / count).sqrt().to_degrees();
        Errors { inclination: rmse(inclination), total: rmse(total) }
    }

    fn alone(&self, name: &'static str) -> Alone {
        let mut fuser = Fuser::named(name).unwrap();
        self.first_half(&mut fuser);
        Alone { name, common: fuser.common(), later: self.second_half(fuser.clone()), in_the_middle: fuser }
    }

    fn after(&self, giver: &Alone, receiver: &str) -> Errors {
        let mut receiver = Fuser::named(receiver).unwrap();
        receiver.adopt(&giver.common).unwrap();
        self.second_half(receiver)
    }
}

/// The most that inclination may be worse by, degrees.
fn worse_deg(giver: &Alone, receiver: &str) -> f64 {
    if receiver == "aided" && giver.common.bias_sd_rad_s.is_infinite() { WORSE_WITHOUT_BIAS_DEG } else { WORSE_DEG }
}

/// The first trial, with the magnetic field or without.
fn trial(magnetic: bool) -> Option<Trial> {
    Some(Trial::new(broad()?.first()?, magnetic))
}

#[test]
fn after_a_hand_over_the_error_is_no_worse_than_that_of_the_worse_alone() {
    let mut worse = Vec::new();
    for magnetic in [false, true] {
        let Some(trial) = trial(magnetic) else { return };
        let all: Vec<_> = Fuser::NAMES.iter().map(|name| trial.alone(name)).collect();
        for alone in &all {
            println!("field {magnetic}: {} alone {:.3?}", alone.name, alone.later);
        }
        for (giver, receiver) in all.iter().flat_map(|giver| all.iter().map(move |receiver| (giver, receiver))) {
            if giver.name == receiver.name {
                continue;
            }
            let (after, allowed) = (trial.after(giver, receiver.name), giver.later.worse(receiver.later));
            let north = magnetic && [giver, receiver].iter().all(|fuser| MAGNETIC.contains(&fuser.name));
            let level = after.inclination <= allowed.inclination + worse_deg(giver, receiver.name);
            let whole_worse_deg = if receiver.name == "wz" { WORSE_WITHOUT_SCALE_DEG } else { WORSE_DEG };
            let whole = after.total <= allowed.total + whole_worse_deg;
            let line = format!("field {magnetic}: {} to {}: {after:.3?}", giver.name, receiver.name);
            println!("{line}, the worse alone {allowed:.3?}");
            if !level || north && !whole && receiver.name != "vqf" {
                worse.push(format!("{line}, the worse alone {allowed:.3?}"));
            }
        }
    }
    assert_eq!(worse, Vec::<String>::new());
}

#[test]
fn a_restart_from_a_snapshot_goes_on_bit_for_bit() {
    let Some(trial) = trial(true) else { return };
    for name in Fuser::NAMES {
        let mut stays = trial.alone(name).in_the_middle;
        let mut restarted = Fuser::named(name).unwrap();
        restarted.restore(&stays.snapshot()).unwrap();
        for (tick, input) in trial.inputs.iter().enumerate().skip(trial.middle) {
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
