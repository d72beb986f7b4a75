//! Trials of BROAD and the errors of an estimator on them.

use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Estimate, Fused, Fuser, FuserInput, FuserStage, GyroScale},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
};
use recording::{Reader, Row};
use std::{
    path::{Path, PathBuf},
    sync::LazyLock,
};
use vqf_rs::VQF;

/// Sampling interval of BROAD, s.
pub(crate) const DT_S: f64 = 0.0035;

/// Trial of BROAD: sensor readings with reference attitudes.
#[derive(Clone)]
pub(crate) struct Trial {
    pub(crate) name: String,
    pub(crate) rows: Vec<Row>,
}

/// Returns the trials, read once; prints a message and returns `None` if the data is missing.
pub(crate) fn trials() -> Option<&'static [Trial]> {
    static TRIALS: LazyLock<Option<Vec<Trial>>> = LazyLock::new(read_trials);
    TRIALS.as_deref()
}

fn read_trials() -> Option<Vec<Trial>> {
    let folder = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from)
        .join("broad");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no data at {}", folder.display());
        return None;
    };
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let trial = |path: PathBuf| Trial {
        name: path.file_name().unwrap().to_str().unwrap().trim_end_matches(".csv.gz").to_owned(),
        rows: Reader::open(&path).unwrap().map(Result::unwrap).collect(),
    };
    Some(paths.into_iter().map(trial).collect())
}

impl Trial {
    /// Returns the trial's number in BROAD.
    pub(crate) fn number(&self) -> &str {
        &self.name[..2]
    }

    /// Returns the indices of the first and the last scored row.
    pub(crate) fn movement(&self) -> (usize, usize) {
        let scored = |row: &Row| row.reference.is_some_and(|reference| reference.scored);
        (self.rows.iter().position(scored).unwrap(), self.rows.iter().rposition(scored).unwrap())
    }
}

/// Returns the reference attitude of a row, from motion capture.
pub(crate) fn truth(row: &Row) -> Option<Quaternion<f64>> {
    row.reference.map(|reference| {
        let [w, x, y, z] = reference.quaternion;
        Quaternion::new(w, x, y, z)
    })
}

/// Rotates a vector from earth axes to body axes.
pub(crate) fn into_body(q: Quaternion<f64>, earth: Vector3<f64>) -> Vector3<f64> {
    into_earth(q.conjugate(), earth)
}

/// Rotates a vector from body axes to earth axes.
pub(crate) fn into_earth(q: Quaternion<f64>, body: Vector3<f64>) -> Vector3<f64> {
    (q * Quaternion::from_imag(body) * q.conjugate()).imag()
}

/// Root mean squares of the errors in degrees. The error quaternion in earth axes is e = q q_ref*,
/// with the estimate q.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Errors {
    /// Angle of the error quaternion e: 2 acos |e_w|.
    pub(crate) total: f64,
    /// Heading part of the error quaternion e: 2 atan |e_z/e_w|.
    pub(crate) heading: f64,
    /// Inclination part of the error quaternion e: 2 acos √(e_w² + e_z²).
    pub(crate) inclination: f64,
}

impl Errors {
    /// Returns the mean over trials.
    pub(crate) fn mean(all: &[Self]) -> Self {
        let mean = |pick: fn(&Self) -> f64| all.iter().map(pick).sum::<f64>() / all.len() as f64;
        Self { total: mean(|e| e.total), heading: mean(|e| e.heading), inclination: mean(|e| e.inclination) }
    }
}

impl std::fmt::Display for Errors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:6.2} {:6.2} {:5.2}", self.total, self.heading, self.inclination)
    }
}

/// Returns the errors of an estimator over the scored rows after the first `unscored_s` seconds.
pub(crate) fn errors(
    rows: &[Row],
    unscored_s: f64,
    mut estimate: impl FnMut(usize, &Row) -> Quaternion<f64>,
) -> Errors {
    let (mut sums, mut count) = ([0.0; 3], 0.0);
    for (tick, row) in rows.iter().enumerate() {
        let q = estimate(tick, row);
        let Some(reference) = row.reference.filter(|reference| reference.scored) else { continue };
        if tick as f64 * DT_S < unscored_s {
            continue;
        }
        let [w, x, y, z] = reference.quaternion;
        let e = q * Quaternion::new(w, x, y, z).conjugate();
        let tilt = (e.w * e.w + e.k * e.k).sqrt();
        let total = 2.0 * e.imag().norm().atan2(e.w.abs());
        let heading = 2.0 * e.k.abs().atan2(e.w.abs());
        let inclination = 2.0 * (e.i * e.i + e.j * e.j).sqrt().atan2(tilt);
        for (sum, error) in sums.iter_mut().zip([total, heading, inclination]) {
            *sum += error.to_degrees() * error.to_degrees();
        }
        count += 1.0;
    }
    let [total, heading, inclination] = sums.map(|sum| f64::sqrt(sum / count));
    Errors { total, heading, inclination }
}

/// Chain of default stages that compute the fused attitude from sensor readings.
pub(crate) struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
    started: bool,
}

impl Chain {
    /// Creates the stages with their default parameters.
    pub(crate) fn new() -> Self {
        Self {
            gyro: Gyro::from_name("mobius").unwrap(),
            accel: Accelerometer::default(),
            fuser: Fuser::from_name("wz").unwrap(),
            started: false,
        }
    }

    /// Processes one row.
    pub(crate) fn step(&mut self, row: &Row) -> Fused {
        let dt_s = if self.started { DT_S } else { 0.0 };
        self.started = true;
        let rate_rad_s = Vector3::from(row.rate_rad_s);
        self.fuser.step(&FuserInput {
            motion: Some(self.gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean })),
            inclination: Some(self.accel.step(&Vector3::from(row.force_m_s2))),
            field_ut: row.field_ut.map(Vector3::from),
            rest_credible: true,
            rate_credible: true,
            fix: None,
        })
    }
}

/// Returns the errors of `wz`.
pub(crate) fn wz_errors(rows: &[Row], unscored_s: f64) -> Errors {
    let mut chain = Chain::new();
    errors(rows, unscored_s, |_, row| chain.step(row).attitude.quaternion())
}

/// Returns the errors of `wz` started with a known gyro scale, and the scale estimated at the end.
pub(crate) fn wz_errors_with_scale(rows: &[Row], scale: GyroScale) -> (Errors, GyroScale) {
    let mut fuser = Fuser::from_name("wz").unwrap();
    fuser.seed_sensor_errors(&Estimate { gyro_scale: scale, ..Estimate::UNKNOWN }).unwrap();
    let mut chain = Chain { fuser, ..Chain::new() };
    let errors = errors(rows, 0.0, |_, row| chain.step(row).attitude.quaternion());
    (errors, chain.fuser.common().gyro_scale)
}

/// Returns the errors of VQF with its own default parameters.
pub(crate) fn vqf_errors(rows: &[Row], unscored_s: f64) -> Errors {
    let mut vqf = VQF::new(DT_S, None, None, None);
    errors(rows, unscored_s, |_, row| {
        vqf.update(row.rate_rad_s, row.force_m_s2, row.field_ut);
        let q = vqf.quat_9d();
        Quaternion::new(q.0, q.1, q.2, q.3)
    })
}
