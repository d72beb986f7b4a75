//! Magnetometer hard and soft iron, from a magnetic field of constant strength. The unit is turned
//! in one place, so that the magnetometer measures the field from all directions.
//!
//! The model is |M (m − b)| = F for every sample m, with the hard iron b, the soft-iron correction
//! M and the field strength F. Every direction has about the same weight, however long the unit
//! remained in it. Huber weights reduce the effect of outliers, for example from iron that passes
//! by. If F is unknown, M is scaled to det M = 1, which preserves the mean strength. The standard
//! deviations assume that errors are correlated over a second, which allows for field gradients in
//! a room.

use attitude::{Matrix3, Vector3};
use nalgebra::SMatrix;

use crate::{
    ellipsoid::{Ellipsoid, standard_deviations},
    input::{Kind, Prior, Sample},
    least_squares::NormalEquations,
    report::{Coverage, Rejection, Report, Residual, Value, array, pluralize, rows},
    sphere::{SECTORS, Sphere},
};

/// Maximum number of samples kept.
const MAX_SAMPLES: usize = 60_000;
/// Initial minimum interval between the samples kept, ns. The interval doubles whenever the number
/// of samples reaches [`MAX_SAMPLES`].
const MIN_INTERVAL_NS: i64 = 40_000_000;
/// Minimum number of covered sectors, out of 24.
const MIN_SECTORS: usize = 20;
/// Minimum half range of the magnetic field on an axis, µT. A larger half range shows that the
/// earth's field (22 to 67 µT) has pointed along both directions of the axis.
const MIN_HALF_RANGE_UT: f64 = 12.0;
/// Time over which the errors of successive samples are correlated, ns.
const CORRELATION_NS: i64 = 1_000_000_000;
/// Size of a residual above which its Huber weight decreases, in standard deviations.
const HUBER_THRESHOLD: f64 = 2.0;
/// Maximum number of Gauss-Newton steps.
const MAX_STEPS: usize = 30;
/// Maximum standard deviation of an accepted hard-iron offset, as a fraction of the field strength.
const MAX_HARD_IRON_SD: f64 = 0.03;
/// Maximum standard deviation of an accepted soft-iron element.
const MAX_SOFT_IRON_SD: f64 = 0.03;
/// Plausible range of the earth's field strength, with a margin, µT.
const EARTH_FIELD_RANGE_UT: std::ops::RangeInclusive<f64> = 15.0..=75.0;

/// Magnetometer calibrator.
#[derive(Debug, Clone)]
pub struct MagCalibrator {
    samples: Vec<(i64, Vector3<f64>)>,
    interval_ns: i64,
    min_ut: Vector3<f64>,
    max_ut: Vector3<f64>,
    strength_ut: Option<f64>,
}

/// Result of a fit.
struct Fit {
    model: Ellipsoid<9>,
    strength_ut: f64,
    covariance: SMatrix<f64, 9, 9>,
}

impl MagCalibrator {
    pub(crate) fn new(prior: &Prior) -> Self {
        Self {
            samples: Vec::new(),
            interval_ns: MIN_INTERVAL_NS,
            min_ut: Vector3::repeat(f64::INFINITY),
            max_ut: Vector3::repeat(f64::NEG_INFINITY),
            strength_ut: prior.field_ut,
        }
    }

    pub(crate) fn push(&mut self, sample: &Sample) {
        let Some(field_ut) = sample.field_ut else { return };
        let is_due = |(last_ns, last_ut): &(i64, Vector3<f64>)| {
            sample.t_ns - last_ns >= self.interval_ns && *last_ut != field_ut
        };
        if !self.samples.last().is_none_or(is_due) {
            return;
        }
        if self.samples.len() == MAX_SAMPLES {
            // Keeps every second sample.
            let mut count = 0;
            self.samples.retain(|_| {
                count += 1;
                count % 2 == 0
            });
            self.interval_ns *= 2;
        }
        self.samples.push((sample.t_ns, field_ut));
        self.min_ut = self.min_ut.inf(&field_ut);
        self.max_ut = self.max_ut.sup(&field_ut);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        self.assess(&self.directions(), self.is_excited())
    }

    pub(crate) fn covered_sectors(&self) -> [bool; SECTORS] {
        if self.is_excited() == [false; 3] { [false; SECTORS] } else { self.directions().covered_sectors() }
    }

    pub(crate) fn direction(&self) -> Option<Vector3<f64>> {
        self.samples.last().map(|(_, field_ut)| field_ut - self.centre_ut())
    }

    /// Returns the middle of the range of each axis, which approximates the hard iron.
    fn centre_ut(&self) -> Vector3<f64> {
        (self.min_ut + self.max_ut) * 0.5
    }

    fn directions(&self) -> Sphere {
        let centre_ut = self.centre_ut();
        Sphere::from_directions(&self.samples.iter().map(|(_, field_ut)| field_ut - centre_ut).collect::<Vec<_>>())
    }

    /// Returns, for each axis, `true` if the magnetic field has pointed along both of its
    /// directions.
    fn is_excited(&self) -> [bool; 3] {
        let half_ut = (self.max_ut - self.min_ut) * 0.5;
        std::array::from_fn(|axis| half_ut[axis] >= MIN_HALF_RANGE_UT)
    }

    fn assess(&self, sphere: &Sphere, is_excited: [bool; 3]) -> Coverage {
        let faces = sphere.covered_faces();
        let is_covered = |face: usize| faces[face] && is_excited[face / 2];
        let count = (0..6).filter(|face| is_covered(*face)).count();
        let share = (count as f64 / 6.0).min(sphere.covered_count() as f64 / MIN_SECTORS as f64).min(1.0);
        let name = |face: usize| format!("{}{}", ["+", "−"][face % 2], ["x", "y", "z"][face / 2]);
        let uncovered: Vec<_> = (0..6).filter(|face| !is_covered(*face)).map(name).collect();
        let mut missing = Vec::new();
        if self.samples.is_empty() {
            missing.push("a magnetometer sample; none received".into());
        } else if !uncovered.is_empty() {
            missing.push(format!(
                "the field along {} of the sensor; turn the unit, away from iron, once about each of its axes in each position: \
                 upright, on both sides, nose up, nose down, upside down",
                uncovered.join(", ")
            ));
        } else if share < 1.0 {
            missing.push(format!(
                "{} more of the 24 sectors of the sphere; turn the unit about all axes, including tilted ones",
                MIN_SECTORS - sphere.covered_count()
            ));
        }
        // If the readings contain only noise, the directions are meaningless.
        let sectors = if is_excited == [false; 3] { 0 } else { sphere.covered_count() };
        Coverage {
            share: if missing.is_empty() { 1.0 } else { share.min(0.99) },
            summary: format!("{} in {sectors} of 24 sectors", pluralize(self.samples.len(), "field sample")),
            missing,
        }
    }

    pub(crate) fn finish(&self) -> Result<Report, Rejection> {
        let before = self.coverage();
        if before.share < 1.0 {
            return Err(Rejection::incomplete(Kind::Mag, before));
        }
        let unreliable = |coverage: &Coverage| {
            let missing =
                "a field of constant strength from all directions; turn the unit in one place, away from iron, about all axes"
                    .into();
            Rejection::unreliable(Kind::Mag, coverage.clone(), missing)
        };
        let fit = self.fit().ok_or_else(|| unreliable(&before))?;
        // Checks the coverage again, this time about the estimated centre.
        let directions: Vec<_> = self.samples.iter().map(|(_, field_ut)| fit.corrected(field_ut)).collect();
        let coverage = self.assess(&Sphere::from_directions(&directions), [true; 3]);
        if coverage.share < 1.0 {
            return Err(Rejection::incomplete(Kind::Mag, coverage));
        }
        let [hard_sd, soft_sd, cross_sd] = standard_deviations(&fit.covariance);
        let is_precise =
            hard_sd.amax() <= MAX_HARD_IRON_SD * fit.strength_ut && soft_sd.sup(&cross_sd).amax() <= MAX_SOFT_IRON_SD;
        let is_ellipsoid = fit.model.matrix().cholesky().is_some();
        if !(is_precise && is_ellipsoid) {
            return Err(unreliable(&coverage));
        }
        Ok(self.report(&fit, coverage))
    }

    fn report(&self, fit: &Fit, coverage: Coverage) -> Report {
        let Fit { model, strength_ut, covariance } = fit;
        let [hard_sd, soft_sd, cross_sd] = standard_deviations(covariance);
        let rms = |length: &dyn Fn(&Vector3<f64>) -> f64| {
            let squares = self.samples.iter().map(|(_, field_ut)| (length(field_ut) - strength_ut).powi(2));
            (squares.sum::<f64>() / self.samples.len() as f64).sqrt()
        };
        let matrix = model.matrix();
        let mut notes = vec![match self.strength_ut {
            Some(_) => format!("scaled to a field of {strength_ut:.1} µT"),
            None => {
                format!(
                    "scaled to the mean measured field, {strength_ut:.1} µT; pass the true strength with --field-ut"
                )
            }
        }];
        if !EARTH_FIELD_RANGE_UT.contains(strength_ut) {
            notes.push("the strength is outside the earth's field, 22 to 67 µT; check that the unit is µT".into());
        }
        Report {
            kind: "magnetometer",
            values: vec![
                Value::vector("hard iron", model.bias(), hard_sd, "µT"),
                Value::vector("soft iron xx…", matrix.diagonal(), soft_sd, ""),
                Value::vector("soft iron xy…", Vector3::new(matrix.m12, matrix.m13, matrix.m23), cross_sd, ""),
            ],
            residual: Residual {
                quantity: "RMS of |m| − field strength",
                before: rms(&|field_ut| field_ut.norm()),
                after: rms(&|field_ut| fit.corrected(field_ut).norm()),
                unit: "µT",
            },
            coverage,
            notes,
            replaces: "[ingest.calibration.mag]",
            block: format!(
                "[ingest.calibration.mag]\nbias = {} # µT\nmatrix = {}\n",
                array(model.bias().as_slice()),
                rows(&matrix)
            ),
        }
    }

    fn fit(&self) -> Option<Fit> {
        let (centre_ut, radius_ut) = self.sphere()?;
        let strength_ut = self.strength_ut.unwrap_or(radius_ut);
        let initial = Ellipsoid::<9>::sphere(centre_ut, strength_ut / radius_ut);
        let equal_weights = vec![1.0; self.samples.len()];
        let first = self.iterate(initial, strength_ut, &equal_weights)?;
        let refined = self.iterate(first, strength_ut, &self.weights(&first))?;
        let covariance = self.sums(&refined, strength_ut, &self.weights(&first)).1.block_covariance()?;
        let fit = Fit { model: refined, strength_ut, covariance };
        Some(if self.strength_ut.is_some() { fit } else { fit.normalised()? })
    }

    /// Returns the centre c and the radius of the sphere that fits the samples best.
    ///
    /// The equation |m|² = 2 c·m + k is linear in c and k.
    fn sphere(&self) -> Option<(Vector3<f64>, f64)> {
        let mean = self.samples.iter().map(|(_, field_ut)| field_ut).sum::<Vector3<f64>>() / self.samples.len() as f64;
        let mut normal = NormalEquations::<4>::new();
        for (_, field_ut) in &self.samples {
            let arm = field_ut - mean;
            normal.add(-arm.norm_squared(), &[2.0 * arm.x, 2.0 * arm.y, 2.0 * arm.z, 1.0].into(), 1.0);
        }
        let solved = normal.step()?;
        let centre = Vector3::new(solved[0], solved[1], solved[2]);
        let radius = (solved[3] + centre.norm_squared()).sqrt();
        (radius.is_finite() && radius > 0.0).then_some((mean + centre, radius))
    }

    /// Returns the weights that balance the directions. A sample in a sector with the mean number
    /// of samples has the weight 1; a sample in a sparse sector has at most the weight 2.
    fn weights(&self, model: &Ellipsoid<9>) -> Vec<f64> {
        let directions: Vec<_> = self.samples.iter().map(|(_, m)| model.matrix() * (m - model.bias())).collect();
        let sphere = Sphere::from_directions(&directions);
        let mean_count = self.samples.len() as f64 / sphere.covered_count().max(1) as f64;
        directions.iter().map(|direction| (mean_count / f64::from(sphere.count(direction).max(1))).min(2.0)).collect()
    }

    /// Iterates Gauss-Newton steps. Each step is halved until it does not increase the cost.
    fn iterate(&self, initial: Ellipsoid<9>, strength_ut: f64, weights: &[f64]) -> Option<Ellipsoid<9>> {
        let mut model = initial;
        for _ in 0..MAX_STEPS {
            let (cost, mut normal) = self.sums(&model, strength_ut, weights);
            let mut step = normal.step()?;
            let mut next = Ellipsoid(model.0 + step);
            for _ in 0..8 {
                if self.sums(&next, strength_ut, weights).0 <= cost {
                    break;
                }
                step *= 0.5;
                next = Ellipsoid(model.0 + step);
            }
            model = next;
            if step.amax() < 1e-8 {
                break;
            }
        }
        model.0.iter().all(|part| part.is_finite()).then_some(model)
    }

    /// Returns the weighted Huber cost and the normal equations.
    fn sums(&self, model: &Ellipsoid<9>, strength_ut: f64, weights: &[f64]) -> (f64, NormalEquations<9>) {
        let residuals: Vec<_> =
            self.samples.iter().map(|(_, field_ut)| model.residual(field_ut, strength_ut)).collect();
        let mut sizes: Vec<_> = residuals.iter().map(|(residual, _)| residual.abs()).collect();
        let middle = sizes.len() / 2;
        // For a normal distribution, the median magnitude is 0.6745 standard deviations.
        let sd = (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(1e-6);
        let mut normal = NormalEquations::<9>::new();
        let mut cost = 0.0;
        let mut block_ns = i64::MIN;
        for (((t_ns, _), (residual, jacobian)), weight) in self.samples.iter().zip(&residuals).zip(weights) {
            if *t_ns >= block_ns {
                normal.end_block();
                block_ns = t_ns + CORRELATION_NS;
            }
            let huber_weight = (HUBER_THRESHOLD * sd / residual.abs().max(f64::MIN_POSITIVE)).min(1.0);
            cost += weight * residual * residual * huber_weight;
            normal.add(*residual, jacobian, weight * huber_weight);
        }
        normal.end_block();
        (cost, normal)
    }
}

impl Fit {
    fn corrected(&self, field_ut: &Vector3<f64>) -> Vector3<f64> {
        self.model.matrix() * (field_ut - self.model.bias())
    }

    /// Divides M and the strength by det(M)^⅓, which preserves the mean measured strength.
    fn normalised(self) -> Option<Self> {
        let matrix = self.model.matrix();
        let inverse = matrix.try_inverse()?;
        let factor = matrix.determinant().cbrt().recip();
        if !(factor.is_finite() && factor > 0.0) {
            return None;
        }
        // The derivative of s M with s = det(M)^−⅓ is d(s M) = s (dM − M tr(M⁻¹ dM) / 3).
        let basis = |i: usize| {
            let mut parameters = nalgebra::SVector::<f64, 9>::zeros();
            parameters[i] = 1.0;
            Ellipsoid(parameters).matrix()
        };
        let packed = |m: Matrix3<f64>| [m.m11, m.m22, m.m33, m.m12, m.m13, m.m23];
        let mut jacobian = SMatrix::<f64, 9, 9>::identity();
        for i in 3..9 {
            let basis_matrix = basis(i);
            let scaled_change = packed((basis_matrix - matrix * ((inverse * basis_matrix).trace() / 3.0)) * factor);
            (3..9).zip(scaled_change).for_each(|(row, part)| jacobian[(row, i)] = part);
        }
        let mut model = self.model;
        model.0.rows_mut(3, 6).iter_mut().for_each(|part| *part *= factor);
        Some(Self {
            model,
            strength_ut: self.strength_ut * factor,
            covariance: jacobian * self.covariance * jacobian.transpose(),
        })
    }
}
