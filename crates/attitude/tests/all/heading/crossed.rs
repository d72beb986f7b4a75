//! Crossed trials: the movement of one trial of BROAD in the magnetic field of another.
//!
//! Heading errors depend mainly on the magnetic disturbance at the place of the movement, and each
//! recording has only one place. Motion capture gives the magnetic field of each trial in earth
//! axes, so a movement can be combined with the fields of six other places. The field is mirrored
//! at random, so that an estimator gains nothing by trusting its first heading. Random scale and
//! axis errors are added to the gyro.

use super::{
    rng::Rng,
    trial::{Trial, into_body, into_earth, truth},
};
use attitude::{Matrix3, Vector3};
use recording::Row;

/// Largest scale error added to a gyro axis, similar to that of the recorded gyros.
const MAX_SCALE_ERROR: f64 = 0.002;
/// Largest misalignment added to the gyro's axes, rad, similar to that of the recorded gyros.
const MAX_SHEAR: f64 = 0.001;
/// Standard deviation of the magnetometer noise on each axis, µT.
const NOISE_UT: f64 = 0.4;

/// Returns the rows of the trial `movement`, in the magnetic field of the trial `place`.
pub(crate) fn crossed_rows(movement: &Trial, place: &Trial, seed: u64) -> Vec<Row> {
    let number = |trial: &Trial| trial.number().parse::<u64>().unwrap();
    let mut rng = Rng::from_seed(seed.wrapping_mul(0x10_0000) + number(movement) * 0x400 + number(place));
    let PlaceField { mean_ut, at_rest_ut, moving_ut } = PlaceField::from_trial(place);
    let mirror = Vector3::new(if rng.uniform() < 0.5 { -1.0 } else { 1.0 }, 1.0, 1.0);
    let gyro = Matrix3::from_fn(|i, j| {
        if i == j {
            1.0 + rng.uniform_in(-MAX_SCALE_ERROR, MAX_SCALE_ERROR)
        } else {
            rng.uniform_in(-MAX_SHEAR, MAX_SHEAR)
        }
    });
    // North is the direction of the mean magnetic field in motion, not that of the field at rest.
    let mean_ut = Vector3::new(0.0, mean_ut.x.hypot(mean_ut.y), mean_ut.z);
    let (from, to) = movement.movement();
    let mut rows = movement.rows.clone();
    for (tick, row) in rows.iter_mut().enumerate() {
        row.rate_rad_s = (gyro * Vector3::from(row.rate_rad_s)).into();
        // The magnetic disturbance of `place` is stretched to the duration of `movement`.
        let share = tick.saturating_sub(from) as f64 / (to + 1 - from) as f64;
        let moving_ut = moving_ut.get((share * moving_ut.len() as f64) as usize).filter(|_| tick >= from);
        let place_ut = moving_ut.unwrap_or(&at_rest_ut).component_mul(&mirror);
        let noise = Vector3::from_fn(|_, _| NOISE_UT * rng.normal());
        // The magnetic field in body axes is unknown in rows without a reference attitude.
        row.field_ut = truth(row).map(|q| (into_body(q, mean_ut + place_ut) + noise).into());
    }
    rows
}

/// Magnetic field of a trial in earth axes, µT.
///
/// `mean_ut` is the mean over the movement. `at_rest_ut` and `moving_ut` are differences from this
/// mean. The values in `moving_ut` are averages over `CHUNK_ROWS` (0.2 s).
struct PlaceField {
    mean_ut: Vector3<f64>,
    at_rest_ut: Vector3<f64>,
    moving_ut: Vec<Vector3<f64>>,
}

impl PlaceField {
    fn from_trial(trial: &Trial) -> Self {
        const CHUNK_ROWS: usize = 57;
        let (from, to) = trial.movement();
        let mean = |rows: &[Row]| {
            let earth = |row: &Row| Some(into_earth(truth(row)?, row.field_ut.map(Vector3::from)?));
            let fields: Vec<_> = rows.iter().filter_map(earth).collect();
            (!fields.is_empty()).then(|| fields.iter().sum::<Vector3<f64>>() / fields.len() as f64)
        };
        let mean_ut = mean(&trial.rows[from..=to]).unwrap();
        let mut last = Vector3::zeros();
        let moving = trial.rows[from..=to].chunks(CHUNK_ROWS).map(|rows| {
            last = mean(rows).map_or(last, |field| field - mean_ut);
            last
        });
        Self { mean_ut, at_rest_ut: mean(&trial.rows[..from]).unwrap() - mean_ut, moving_ut: moving.collect() }
    }
}
