//! Trials of BROAD as input for the stages, and the error metrics of BROAD.

pub(crate) mod ulog;

use std::{
    collections::BTreeMap,
    io::Read,
    path::PathBuf,
    sync::{Arc, LazyLock, Mutex, OnceLock},
};

use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    stage::Stage,
};

/// Sample of a trial.
pub(crate) struct Row {
    pub(crate) rate_rad_s: Vector3<f64>,
    pub(crate) force_m_s2: Vector3<f64>,
    pub(crate) field_ut: Vector3<f64>,
    /// Attitude from motion capture; `None` in rows that are not scored.
    pub(crate) reference: Option<Quaternion<f64>>,
}

/// Sampling interval of BROAD, s.
pub(crate) const DT_S: f64 = 0.0035;

/// Results that several tests share, each computed once.
pub(crate) struct ResultCache<T>(Mutex<BTreeMap<String, Arc<OnceLock<T>>>>);

impl<T: Copy> ResultCache<T> {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    /// Returns the result stored under `key`.
    ///
    /// The first caller runs `compute`. Concurrent callers wait for its result.
    pub(crate) fn get_or_compute(&self, key: &str, compute: impl FnOnce() -> T) -> T {
        let result = self.0.lock().unwrap().entry(key.into()).or_default().clone();
        *result.get_or_init(compute)
    }
}

/// Returns the trials, read once.
///
/// Returns `None` and prints a message to standard error if the recordings are missing.
pub(crate) fn broad() -> Option<&'static [Vec<Row>]> {
    static TRIALS: LazyLock<Option<Vec<Vec<Row>>>> = LazyLock::new(read_broad);
    TRIALS.as_deref()
}

fn read_broad() -> Option<Vec<Vec<Row>>> {
    let crate_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let folder =
        std::env::var_os("PLUMBLINE_DATA").map_or_else(|| crate_folder.join("../../../shared/data"), PathBuf::from);
    let Ok(files) = folder.join("broad").read_dir() else {
        assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no recordings in {}", folder.display());
        eprintln!("skipped: no recordings in {}; set PLUMBLINE_DATA to their folder", folder.display());
        return None;
    };
    let mut paths: Vec<_> =
        files.map(|file| file.unwrap().path()).filter(|path| path.to_string_lossy().ends_with(".csv.gz")).collect();
    paths.sort();
    Some(paths.into_iter().map(read_trial).collect())
}

fn read_trial(path: PathBuf) -> Vec<Row> {
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    let row = |line: &str| {
        let x: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
        let reference = (x[14] == 1.0 && x[10].is_finite()).then(|| Quaternion::new(x[10], x[11], x[12], x[13]));
        let vector = |i: usize| Vector3::new(x[i], x[i + 1], x[i + 2]);
        Row { rate_rad_s: vector(1), force_m_s2: vector(4), field_ut: vector(7), reference }
    };
    text.lines().skip(1).map(row).collect()
}

/// Root-mean-square errors over one trial, or their mean over several, in degrees.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Rmse {
    pub(crate) total: f64,
    pub(crate) heading: f64,
    pub(crate) inclination: f64,
}

/// Returns the errors of `fuser` over `trial`, with the magnetometer if `magnetic`.
pub(crate) fn run(mut fuser: Fuser, trial: &[Row], magnetic: bool) -> Rmse {
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for (index, row) in trial.iter().enumerate() {
        let dt_s = if index == 0 { 0.0 } else { DT_S };
        let motion = gyro.step(&RateSample { rate_rad_s: row.rate_rad_s, dt_s, kind: RateKind::Mean });
        let out = fuser.step(&FuserInput {
            motion: Some(motion),
            inclination: Some(accel.step(&row.force_m_s2)),
            field_ut: magnetic.then_some(row.field_ut),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        });
        let Some(truth) = row.reference else { continue };
        let e = out.attitude.quaternion() * truth.conjugate();
        let errors = [
            2.0 * e.w.abs().min(1.0).acos(),
            2.0 * (e.k / e.w).abs().atan(),
            2.0 * (e.w * e.w + e.k * e.k).sqrt().min(1.0).acos(),
        ];
        errors.iter().zip(&mut sum).for_each(|(error, sum)| *sum += error * error);
        count += 1.0;
    }
    let [total, heading, inclination] = sum.map(|sum| (sum / count).sqrt().to_degrees());
    Rmse { total, heading, inclination }
}

/// Returns the mean of the errors over the trials.
pub(crate) fn mean(fuser: &Fuser, trials: &[Vec<Row>], magnetic: bool) -> Rmse {
    let count = trials.len() as f64;
    trials.iter().map(|trial| run(fuser.clone(), trial, magnetic)).fold(Rmse::default(), |sum, rmse| Rmse {
        total: sum.total + rmse.total / count,
        heading: sum.heading + rmse.heading / count,
        inclination: sum.inclination + rmse.inclination / count,
    })
}
