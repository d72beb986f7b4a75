//! Magnetic disturbances added to the undisturbed trials of BROAD.

use super::{
    rng::Rng,
    trial::{DT_S, Trial, into_body, truth},
};
use attitude::{Quaternion, Vector3};
use recording::Row;

/// Kind of magnetic disturbance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Disturbance {
    /// Field of 4 to 40 µT fixed to the body, added and removed during the movement.
    BodyTemporary,
    /// Field of 4 to 40 µT fixed to the body, added 10 s before the movement.
    BodyBeforeMotion,
    /// Field of 2 to 20 µT fixed to the body, present from the start.
    BodyPermanent,
    /// Eight passes of a magnet that is fixed to the ground: 5 to 40 µT for 0.5 to 3 s each.
    Passes,
    /// Permanent change of the ambient field by 10 µT, halfway through the movement.
    AmbientStep,
}

impl Disturbance {
    pub(crate) const ALL: [Self; 5] =
        [Self::BodyTemporary, Self::BodyBeforeMotion, Self::BodyPermanent, Self::Passes, Self::AmbientStep];
}

/// Returns the rows of `trial` with a random disturbance of this kind.
pub(crate) fn disturbed(trial: &Trial, kind: Disturbance, seed: u64) -> Vec<Row> {
    let mut rng = Rng::from_seed(seed.wrapping_mul(0x1000) + trial.number().parse::<u64>().unwrap());
    let (from, to) = trial.movement();
    let length = (to - from) as f64;
    let at = |share: f64| from + (length * share) as usize;
    let mut rows = trial.rows.clone();
    match kind {
        Disturbance::BodyTemporary => {
            let magnet = rng.direction() * rng.uniform_in(4.0, 40.0);
            let (on, off) = (at(rng.uniform_in(0.1, 0.4)), at(rng.uniform_in(0.5, 0.9)));
            rows[on..off].iter_mut().for_each(|row| add(row, magnet));
        }
        Disturbance::BodyBeforeMotion => {
            let magnet = rng.direction() * rng.uniform_in(4.0, 40.0);
            rows[from - (10.0 / DT_S) as usize..].iter_mut().for_each(|row| add(row, magnet));
        }
        Disturbance::BodyPermanent => {
            let magnet = rng.direction() * rng.uniform_in(2.0, 20.0);
            rows.iter_mut().for_each(|row| add(row, magnet));
        }
        Disturbance::Passes => {
            for _ in 0..8 {
                let magnet = rng.direction() * rng.uniform_in(5.0, 40.0);
                let (middle, half_s) = (rng.uniform_in(0.02, 0.98), 0.5 * rng.uniform_in(0.5, 3.0));
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
        Disturbance::AmbientStep => {
            let change = rng.direction() * 10.0;
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
