//! Accelerometer bias, scale and misalignment, from gravity. At rest, the accelerometer measures
//! gravity, which has the same strength in every position.
//!
//! The model is |M (f − b)| = g. Here f is the mean force during a rest, b is the bias, g is
//! gravity, and the matrix M corrects scale and misalignment; see `ellipsoid`. Each rest is
//! weighted by the inverse variance of its mean. Six positions, in which each axis points up once
//! and down once, determine bias and scale. Twelve or more positions also determine the
//! misalignment.
//!
//! If the rests do not cover these six positions, the errors are estimated while the unit is slowly
//! rotated by hand through all positions; see `motion`. This method is less accurate. Every
//! direction has about the same weight, residuals have Huber weights, and the standard deviations
//! are computed from the residuals.

use attitude::{Matrix3, Vector3};
use nalgebra::{SMatrix, SVector};

use crate::{
    ellipsoid::{Ellipsoid, standard_deviations},
    input::{Kind, Prior, Sample},
    least_squares::NormalEquations,
    motion::{MeanForce, MotionWindows},
    report::{Coverage, Rejection, Report, Residual, Value, array, pluralize, rows},
    rest::{MeanNoise, Rest, RestFinder},
    sphere::{SECTORS, Sphere},
};

/// Cosine of 15°, the largest angle between two rests that count as the same position.
const MIN_SAME_POSITION_COS: f64 = 0.965_925_826_289_068_3;
/// Minimum number of positions to estimate the misalignment.
const MIN_MISALIGNMENT_POSITIONS: usize = 12;
/// Maximum standard deviation of an accepted bias, m/s² (5 mg).
const MAX_BIAS_SD_M_S2: f64 = 0.05;
/// Maximum standard deviation of an accepted scale or misalignment (0.5 %).
const MAX_SCALE_SD: f64 = 0.005;
/// Lower bound for the standard deviation of a mean force, m/s². It allows for one step of a 16-bit
/// accelerometer with a range of 2 g, and for a surface that yields under the unit.
const MIN_FORCE_SD_M_S2: f64 = 2e-4;
/// Maximum number of Gauss-Newton steps.
const MAX_STEPS: usize = 50;
/// Minimum number of motion windows (48 s).
const MIN_WINDOWS: usize = 24;
/// Number of windows in a correlation block.
///
/// Successive windows are correlated, because a velocity gained by the hand in one window is lost
/// in the next window.
const BLOCK_WINDOWS: usize = 2;
/// Size of a residual above which its Huber weight decreases, in standard deviations.
const HUBER_THRESHOLD: f64 = 2.0;
/// Maximum weight of a window, for sparsely covered sectors of the sphere. A window in a sector
/// with the mean number of windows has weight 1.
const MAX_SECTOR_WEIGHT: f64 = 2.0;

/// Accelerometer calibrator.
#[derive(Debug, Clone)]
pub struct AccelCalibrator {
    rests: RestFinder,
    windows: MotionWindows,
    gravity_m_s2: f64,
    last_force_m_s2: Option<Vector3<f64>>,
}

/// Mean force during a rest, with its standard deviation.
struct Position {
    mean: MeanForce,
    sd_m_s2: f64,
}

/// Result of a fit.
struct Fit {
    bias_m_s2: Vector3<f64>,
    bias_sd_m_s2: Vector3<f64>,
    matrix: Matrix3<f64>,
    scale_sd: Vector3<f64>,
    /// Standard deviation of the misalignment; `None` if the misalignment was not estimated.
    misalignment_sd: Option<Vector3<f64>>,
    source: DataSource,
}

/// Data from which a fit and its standard deviations were computed.
#[derive(Clone, Copy, PartialEq)]
enum DataSource {
    /// The number of rests equals the number of unknowns of the model.
    MinimalRests,
    /// The number of rests exceeds the number of unknowns of the model.
    Rests,
    Motion,
}

impl AccelCalibrator {
    pub(crate) fn new(prior: &Prior) -> Self {
        let windows = MotionWindows::new(prior.gyro);
        Self { rests: RestFinder::default(), windows, gravity_m_s2: prior.gravity_m_s2, last_force_m_s2: None }
    }

    pub(crate) fn push(&mut self, sample: &Sample) {
        self.rests.push(sample);
        self.windows.push(sample);
        self.last_force_m_s2 = Some(sample.force_m_s2);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        let (rest_coverage, motion_coverage) = (coverage(&self.rests()), coverage_in_motion(self.windows.complete()));
        if motion_coverage.share > rest_coverage.share { motion_coverage } else { rest_coverage }
    }

    /// Returns, for each sector of directions in sensor axes, `true` if it is covered.
    ///
    /// A side is covered as a whole, so its four sectors have the same value.
    pub(crate) fn covered_sectors(&self) -> [bool; SECTORS] {
        let (rests, windows) = (self.rests(), self.windows.complete());
        let is_motion = coverage_in_motion(windows).share > coverage(&rests).share;
        let faces = if is_motion {
            sides_in_motion(windows)
        } else {
            Sphere::from_directions(&distinct_positions(&rests)).covered_faces()
        };
        std::array::from_fn(|sector| faces[sector / 4])
    }

    pub(crate) fn direction(&self) -> Option<Vector3<f64>> {
        self.last_force_m_s2
    }

    fn rests(&self) -> Vec<Rest> {
        self.rests.rests().into_iter().filter(Rest::is_plausible_gravity).collect()
    }

    pub(crate) fn finish(&self) -> Result<Report, Rejection> {
        let rests = self.rests();
        let rest_coverage = coverage(&rests);
        if rest_coverage.share >= 1.0 {
            let positions = positions(&rests);
            let finds_misalignment = distinct_positions(&rests).len() >= MIN_MISALIGNMENT_POSITIONS;
            let full = finds_misalignment.then(|| self.fit::<9>(&positions)).flatten().filter(is_precise);
            if let Some(fit) = full.or_else(|| self.fit::<6>(&positions).filter(is_precise)) {
                let means: Vec<_> = positions.iter().map(|position| position.mean).collect();
                return Ok(self.report(&fit, &means, rest_coverage));
            }
        }
        let motion_coverage = coverage_in_motion(self.windows.complete());
        if motion_coverage.share >= 1.0 {
            let full = self.fit_in_motion::<9>().filter(is_precise);
            if let Some(fit) = full.or_else(|| self.fit_in_motion::<6>().filter(is_precise)) {
                return Ok(self.report(&fit, self.windows.complete(), motion_coverage));
            }
        }
        let coverage = self.coverage();
        if coverage.share < 1.0 {
            return Err(Rejection::incomplete(Kind::Accel, coverage));
        }
        let missing = "more distinct positions or longer rests, to separate bias from scale; rest for 2 s with each of the six sides up, \
                       or turn the unit longer and more slowly"
            .into();
        Err(Rejection::unreliable(Kind::Accel, coverage, missing))
    }

    /// Fits six or nine parameters to the rests.
    fn fit<const N: usize>(&self, positions: &[Position]) -> Option<Fit> {
        let mut model = Ellipsoid::<N>::sphere(Vector3::zeros(), 1.0);
        let sums = |model: &Ellipsoid<N>| {
            let mut normal = NormalEquations::<N>::new();
            for Position { mean, sd_m_s2 } in positions {
                let (residual, jacobian) = model.residual_of_mean(mean, self.gravity_m_s2);
                normal.add(residual, &jacobian, sd_m_s2.powi(-2));
            }
            normal
        };
        for _ in 0..MAX_STEPS {
            let step: SVector<f64, N> = sums(&model).step()?;
            model.0 += step;
            if step.amax() < 1e-10 {
                break;
            }
        }
        let normal = sums(&model);
        // If the residuals exceed the noise of the rests, the standard deviations are increased.
        // Such residuals are caused by surfaces that yield and by the limited repeatability of the
        // sensor.
        let free = positions.len().saturating_sub(N);
        let excess = if free > 0 { (normal.cost() / free as f64).max(1.0) } else { 1.0 };
        let source = if free > 0 { DataSource::Rests } else { DataSource::MinimalRests };
        Some(Fit::new(&model, &(normal.covariance()? * excess), source))
    }

    /// Fits six or nine parameters to the motion windows.
    fn fit_in_motion<const N: usize>(&self) -> Option<Fit> {
        let windows = self.windows.complete();
        let directions: Vec<_> = windows.iter().map(MeanForce::force_m_s2).collect();
        let sphere = Sphere::from_directions(&directions);
        let mean_count = windows.len() as f64 / sphere.covered_count().max(1) as f64;
        let weight =
            |direction: &Vector3<f64>| (mean_count / f64::from(sphere.count(direction).max(1))).min(MAX_SECTOR_WEIGHT);
        let mut model = Ellipsoid::<N>::sphere(Vector3::zeros(), 1.0);
        let sums = |model: &Ellipsoid<N>| {
            let residuals: Vec<_> =
                windows.iter().map(|mean| model.residual_of_mean(mean, self.gravity_m_s2)).collect();
            let mut sizes: Vec<_> = residuals.iter().map(|(residual, _)| residual.abs()).collect();
            let middle = sizes.len() / 2;
            // For a normal distribution, the median magnitude is 0.6745 standard deviations.
            let sd = (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(MIN_FORCE_SD_M_S2);
            let mut normal = NormalEquations::<N>::new();
            for (i, ((residual, jacobian), direction)) in residuals.iter().zip(&directions).enumerate() {
                if i % BLOCK_WINDOWS == 0 {
                    normal.end_block();
                }
                let huber_weight = (HUBER_THRESHOLD * sd / residual.abs().max(f64::MIN_POSITIVE)).min(1.0);
                normal.add(*residual, jacobian, weight(direction) * huber_weight);
            }
            normal.end_block();
            normal
        };
        for _ in 0..MAX_STEPS {
            let step: SVector<f64, N> = sums(&model).step()?;
            model.0 += step;
            if step.amax() < 1e-8 {
                break;
            }
        }
        Some(Fit::new(&model, &sums(&model).block_covariance()?, DataSource::Motion))
    }

    fn report(&self, fit: &Fit, means: &[MeanForce], coverage: Coverage) -> Report {
        let Fit { bias_m_s2, bias_sd_m_s2, matrix, scale_sd, misalignment_sd, source } = fit;
        let rms = |matrix: &Matrix3<f64>, bias: &Vector3<f64>| {
            let squares = means.iter().map(|mean| (mean.corrected(matrix, bias).norm() - self.gravity_m_s2).powi(2));
            (squares.sum::<f64>() / means.len() as f64).sqrt()
        };
        let mut values = vec![
            Value::vector("bias", *bias_m_s2, *bias_sd_m_s2, "m/s²"),
            Value::vector("scale", matrix.diagonal(), *scale_sd, ""),
        ];
        let mut notes = Vec::new();
        let matrix_line = match misalignment_sd {
            Some(sd) => {
                let misalignment = Vector3::new(matrix.m12, matrix.m13, matrix.m23);
                values.push(Value::vector("xy, xz, yz", misalignment, *sd, ""));
                format!("matrix = {}", rows(matrix))
            }
            None => {
                let positions = format!("at least {MIN_MISALIGNMENT_POSITIONS} positions, including tilted ones");
                notes.push(format!("bias and scale only; for axis misalignment, rest in {positions}"));
                format!("scale = {}", array(matrix.diagonal().as_slice()))
            }
        };
        match source {
            DataSource::MinimalRests => notes.push(
                "residual not meaningful (6 equations, 6 unknowns); the standard deviations reflect sensor noise only"
                    .into(),
            ),
            DataSource::Rests => {}
            DataSource::Motion => {
                notes.push("estimated in motion; rests on each of the six sides are more accurate".into());
            }
        }
        Report {
            kind: "accelerometer",
            values,
            residual: Residual {
                quantity: "RMS of |f| − g",
                before: rms(&Matrix3::identity(), &Vector3::zeros()),
                after: rms(matrix, bias_m_s2),
                unit: "m/s²",
            },
            coverage,
            notes,
            replaces: "[ingest.calibration.accel]",
            block: format!(
                "[ingest.calibration.accel]\nbias = {} # m/s²\n{matrix_line}\n",
                array(bias_m_s2.as_slice())
            ),
        }
    }
}

impl Fit {
    fn new<const N: usize>(model: &Ellipsoid<N>, covariance: &SMatrix<f64, N, N>, source: DataSource) -> Self {
        let [bias_sd_m_s2, scale_sd, misalignment_sd] = standard_deviations(covariance);
        let misalignment_sd = (N > 6).then_some(misalignment_sd);
        Self { bias_m_s2: model.bias(), bias_sd_m_s2, matrix: model.matrix(), scale_sd, misalignment_sd, source }
    }
}

fn is_precise(fit: &Fit) -> bool {
    let scale_sd = fit.misalignment_sd.map_or(fit.scale_sd, |misalignment_sd| misalignment_sd.sup(&fit.scale_sd));
    fit.bias_sd_m_s2.amax() <= MAX_BIAS_SD_M_S2 && scale_sd.amax() <= MAX_SCALE_SD
}

/// Returns the mean forces of the rests with their standard deviations.
fn positions(rests: &[Rest]) -> Vec<Position> {
    let noise = MeanNoise::from_series(&rests.iter().map(|rest| rest.forces_m_s2.as_slice()).collect::<Vec<_>>());
    let position = |rest: &Rest| {
        let force_m_s2 = rest.force_m_s2();
        // Only the noise component along the force matters, because the fit uses only the lengths
        // of the mean forces.
        let sd = noise.sd(rest.forces_m_s2.len()).component_mul(&force_m_s2.normalize()).norm();
        Position { mean: MeanForce::at_rest(&force_m_s2), sd_m_s2: sd.max(MIN_FORCE_SD_M_S2) }
    };
    rests.iter().map(position).collect()
}

/// Returns the distinct directions of gravity as unit vectors.
fn distinct_positions(rests: &[Rest]) -> Vec<Vector3<f64>> {
    let mut distinct_positions: Vec<Vector3<f64>> = Vec::new();
    for rest in rests {
        let direction = rest.force_m_s2().normalize();
        if distinct_positions.iter().all(|other| other.dot(&direction) < MIN_SAME_POSITION_COS) {
            distinct_positions.push(direction);
        }
    }
    distinct_positions
}

fn coverage(rests: &[Rest]) -> Coverage {
    let positions = distinct_positions(rests);
    let faces = Sphere::from_directions(&positions).covered_faces();
    let covered = faces.iter().filter(|is_covered| **is_covered).count();
    let names_of = |wanted: bool| {
        let names: Vec<_> = (0..6).filter(|face| faces[*face] == wanted).map(side_name).collect();
        names.join(", ")
    };
    let missing = (covered < 6).then(|| {
        format!(
            "2 s of rest in each position: {}; keep the axis within 30° of vertical, or turn the unit slowly by hand through all \
             positions for two minutes",
            names_of(false)
        )
    });
    let list = if covered > 0 { format!(": {}", names_of(true)) } else { String::new() };
    Coverage {
        share: covered as f64 / 6.0,
        summary: format!("{} in {}{list}", pluralize(rests.len(), "rest"), pluralize(positions.len(), "position")),
        missing: missing.into_iter().collect(),
    }
}

/// Returns, for each side (+x, −x, +y, −y, +z, −z), `true` if it pointed up in a window.
fn sides_in_motion(windows: &[MeanForce]) -> [bool; 6] {
    std::array::from_fn(|face| windows.iter().any(|window| window.sides_up[face]))
}

fn coverage_in_motion(windows: &[MeanForce]) -> Coverage {
    let faces = sides_in_motion(windows);
    let covered = faces.iter().filter(|is_covered| **is_covered).count();
    let share = (covered as f64 / 6.0).min(windows.len() as f64 / MIN_WINDOWS as f64).min(1.0);
    let uncovered: Vec<_> = (0..6).filter(|face| !faces[*face]).map(side_name).collect();
    let missing = (share < 1.0).then(|| match uncovered.is_empty() {
        true => "more time in motion; turn the unit slowly by hand through all positions for a minute".into(),
        false => format!(
            "motion with {}; turn the unit slowly by hand until each of these axes has pointed that way",
            uncovered.join(", ")
        ),
    });
    let summary = format!("{} of 2 s in motion, {covered} of 6 sides up", pluralize(windows.len(), "window"));
    Coverage { share, summary, missing: missing.into_iter().collect() }
}

fn side_name(face: usize) -> String {
    format!("{} {}", ["x", "y", "z"][face / 2], ["up", "down"][face % 2])
}
