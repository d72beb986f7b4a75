//! Crossed trials: the movement of each trial of BROAD in the magnetic field of another, with a gyro of its own errors.
//!
//! What a place adds to the field where the body moves is the largest error of a heading, and each recording has one such place only. The
//! field of another trial, as the cameras show it in the frame of the earth, gives ten movements six places each; mirrored at
//! random it favours no direction, so nobody looks good here who trusts the first heading.

use super::{
    dice::Dice,
    trial::{Trial, into_body, into_earth, truth},
};
use attitude::{Matrix3, Vector3};
use recording::Row;

/// Most that is added to the error of the gyro's scale, each axis, and to that of its axes: as much as the recorded gyros have.
const MAX_SCALE: f64 = 0.002;
const MAX_SHEAR: f64 = 0.001;
/// Noise of the magnetometer, each axis, µT.
const NOISE_UT: f64 = 0.4;

/// The rows of `movement`'s trial in the field of `place`'s.
pub(crate) fn crossed(movement: &Trial, place: &Trial, seed: u64) -> Vec<Row> {
    let number = |trial: &Trial| trial.number().parse::<u64>().unwrap();
    let mut dice = Dice::of(seed.wrapping_mul(0x10_0000) + number(movement) * 0x400 + number(place));
    let Place { mean_ut, at_rest_ut, moving_ut } = Place::of(place);
    let mirror = Vector3::new(if dice.roll() < 0.5 { -1.0 } else { 1.0 }, 1.0, 1.0);
    let gyro = Matrix3::from_fn(|i, j| {
        if i == j { 1.0 + dice.between(-MAX_SCALE, MAX_SCALE) } else { dice.between(-MAX_SHEAR, MAX_SHEAR) }
    });
    // North is where the field points in the mean, not where it points at rest.
    let mean_ut = Vector3::new(0.0, mean_ut.x.hypot(mean_ut.y), mean_ut.z);
    let (from, to) = movement.movement();
    let mut rows = movement.rows.clone();
    for (tick, row) in rows.iter_mut().enumerate() {
        row.rate_rad_s = (gyro * Vector3::from(row.rate_rad_s)).into();
        // The place's movement lasts as long as this one's.
        let share = tick.saturating_sub(from) as f64 / (to + 1 - from) as f64;
        let moving_ut = moving_ut.get((share * moving_ut.len() as f64) as usize).filter(|_| tick >= from);
        let place_ut = moving_ut.unwrap_or(&at_rest_ut).component_mul(&mirror);
        let noise = Vector3::from_fn(|_, _| NOISE_UT * dice.normal());
        // Where the cameras lost the body its field is not known.
        row.field_ut = truth(row).map(|q| (into_body(q, mean_ut + place_ut) + noise).into());
    }
    rows
}

/// The field of a trial, µT, earth axes: its mean while the body moves, and what it has besides at rest and moving, means over a fifth of
/// a second.
struct Place {
    mean_ut: Vector3<f64>,
    at_rest_ut: Vector3<f64>,
    moving_ut: Vec<Vector3<f64>>,
}

impl Place {
    fn of(trial: &Trial) -> Self {
        const MEAN_OF: usize = 57;
        let (from, to) = trial.movement();
        let mean = |rows: &[Row]| {
            let earth = |row: &Row| Some(into_earth(truth(row)?, row.field_ut.map(Vector3::from)?));
            let fields: Vec<_> = rows.iter().filter_map(earth).collect();
            (!fields.is_empty()).then(|| fields.iter().sum::<Vector3<f64>>() / fields.len() as f64)
        };
        let mean_ut = mean(&trial.rows[from..=to]).unwrap();
        let mut last = Vector3::zeros();
        let moving = trial.rows[from..=to].chunks(MEAN_OF).map(|rows| {
            last = mean(rows).map_or(last, |field| field - mean_ut);
            last
        });
        Self { mean_ut, at_rest_ut: mean(&trial.rows[..from]).unwrap() - mean_ut, moving_ut: moving.collect() }
    }
}
