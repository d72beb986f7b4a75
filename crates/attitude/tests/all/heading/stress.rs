//! Disturbances put on the trials of BROAD that have none of their own.

use super::{
    dice::Dice,
    trial::{DT_S, Trial, into_body, truth},
};
use attitude::{Quaternion, Vector3};
use recording::Row;

/// What is put on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// 4 to 40 µT fixed to the body, put on and taken off while it moves.
    BodyStep,
    /// 4 to 40 µT fixed to the body, put on 10 s before it moves.
    BodyBefore,
    /// 2 to 20 µT fixed to the body from the start.
    BodyAlways,
    /// Eight passes of a magnet that stands beside the scene: 5 to 40 µT, 0.5 to 3 s.
    Passes,
    /// The field of the place changes for good by 10 µT at half time.
    Place,
}

impl Kind {
    /// All.
    pub(crate) const ALL: [Self; 5] = [Self::BodyStep, Self::BodyBefore, Self::BodyAlways, Self::Passes, Self::Place];
}

/// The trial's rows with a disturbance of this kind.
pub(crate) fn disturbed(trial: &Trial, kind: Kind, seed: u64) -> Vec<Row> {
    let mut dice = Dice::of(seed.wrapping_mul(0x1000) + trial.number().parse::<u64>().unwrap());
    let (from, to) = trial.movement();
    let length = (to - from) as f64;
    let at = |share: f64| from + (length * share) as usize;
    let mut rows = trial.rows.clone();
    match kind {
        Kind::BodyStep => {
            let magnet = dice.direction() * dice.between(4.0, 40.0);
            let (on, off) = (at(dice.between(0.1, 0.4)), at(dice.between(0.5, 0.9)));
            rows[on..off].iter_mut().for_each(|row| add(row, magnet));
        }
        Kind::BodyBefore => {
            let magnet = dice.direction() * dice.between(4.0, 40.0);
            rows[from - (10.0 / DT_S) as usize..].iter_mut().for_each(|row| add(row, magnet));
        }
        Kind::BodyAlways => {
            let magnet = dice.direction() * dice.between(2.0, 20.0);
            rows.iter_mut().for_each(|row| add(row, magnet));
        }
        Kind::Passes => {
            for _ in 0..8 {
                let magnet = dice.direction() * dice.between(5.0, 40.0);
                let (middle, half_s) = (dice.between(0.02, 0.98), 0.5 * dice.between(0.5, 3.0));
                let half = (half_s / DT_S) as usize;
                let middle = at(middle);
                let mut q = Quaternion::new(1.0, 0.0, 0.0, 0.0);
                for tick in middle - half..(middle + half).min(rows.len()) {
                    q = truth(&rows[tick]).unwrap_or(q);
                    let phase = (tick as f64 - middle as f64) / half as f64 * core::f64::consts::PI;
                    add(&mut rows[tick], into_body(q, magnet * (0.5 + 0.5 * phase.cos())));
                }
            }
        }
        Kind::Place => {
            let change = dice.direction() * 10.0;
            let mut q = Quaternion::new(1.0, 0.0, 0.0, 0.0);
            for row in &mut rows[at(0.5)..] {
                q = truth(row).unwrap_or(q);
                add(row, into_body(q, change));
            }
        }
    }
    rows
}

fn add(row: &mut Row, field_ut: Vector3<f64>) {
    if let Some(field) = &mut row.field_ut {
        field.iter_mut().zip(field_ut.iter()).for_each(|(sum, part)| *sum += part);
    }
}
