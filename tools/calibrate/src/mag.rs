//! The magnetometer's hard and soft iron: turned in one place, it sees a field of one strength from all sides.
//!
//! |M (m − b)| = F over the samples, each direction counting alike however long the unit stayed there, and what does not fit (iron that
//! passed by) counting less, by Huber's weights. Without a known F the mean strength stays: det M = 1. The deviations are those of
//! errors that hang together for a second, as the fields of a room do.

use attitude::{Matrix3, Vector3};
use nalgebra::SMatrix;

use crate::{
    Kind, Known, Sample,
    ellipsoid::{Ellipsoid, deviations},
    least_squares::Normal,
    report::{Coverage, Refusal, Report, Residual, Value, array, rows},
    sphere::{PARTS, Sphere},
};

/// Samples kept: at most so many, at first no closer than this, ns.
const MAX_SAMPLES: usize = 60_000;
const INTERVAL_NS: i64 = 40_000_000;
/// Cells of the sphere, of 24, that must have a sample.
const MIN_CELLS: usize = 20;
/// Half of the range of an axis, µT, from which it may have seen a field of the earth (22 to 67 µT) from both sides.
const MIN_HALF_RANGE_UT: f64 = 12.0;
/// Errors hang together for so long, ns.
const BLOCK_NS: i64 = 1_000_000_000;
/// Where Huber's weights begin, in standard deviations.
const HUBER: f64 = 2.0;
/// Steps after which a fit has found what it finds.
const MAX_STEPS: usize = 30;
/// The most that hard iron (share of the field) and soft iron may be uncertain.
const MAX_HARD_SD: f64 = 0.03;
const MAX_SOFT_SD: f64 = 0.03;
/// Strengths that the earth's field has, µT, and a little more.
const EARTH_UT: std::ops::RangeInclusive<f64> = 15.0..=75.0;

/// Takes samples.
#[derive(Debug, Clone)]
pub struct Mag {
    samples: Vec<(i64, Vector3<f64>)>,
    interval_ns: i64,
    least_ut: Vector3<f64>,
    most_ut: Vector3<f64>,
    strength_ut: Option<f64>,
}

/// What a fit gave.
struct Fit {
    at: Ellipsoid<9>,
    strength_ut: f64,
    covariance: SMatrix<f64, 9, 9>,
}

impl Mag {
    pub(crate) fn new(known: &Known) -> Self {
        Self {
            samples: Vec::new(),
            interval_ns: INTERVAL_NS,
            least_ut: Vector3::repeat(f64::INFINITY),
            most_ut: Vector3::repeat(f64::NEG_INFINITY),
            strength_ut: known.field_ut,
        }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        let Some(field_ut) = sample.field_ut else { return };
        let is_due = |(last_ns, last_ut): &(i64, Vector3<f64>)| {
            sample.t_ns - last_ns >= self.interval_ns && *last_ut != field_ut
        };
        if !self.samples.last().is_none_or(is_due) {
            return;
        }
        if self.samples.len() == MAX_SAMPLES {
            // Each second one is enough of so many.
            let mut count = 0;
            self.samples.retain(|_| {
                count += 1;
                count % 2 == 0
            });
            self.interval_ns *= 2;
        }
        self.samples.push((sample.t_ns, field_ut));
        self.least_ut = self.least_ut.inf(&field_ut);
        self.most_ut = self.most_ut.sup(&field_ut);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        self.told(&self.directions(), self.is_seen())
    }

    pub(crate) fn parts(&self) -> [bool; PARTS] {
        if self.is_seen() == [false; 3] { [false; PARTS] } else { self.directions().parts() }
    }

    pub(crate) fn direction(&self) -> Option<Vector3<f64>> {
        self.samples.last().map(|(_, field_ut)| field_ut - self.middle_ut())
    }

    /// For want of the hard iron.
    fn middle_ut(&self) -> Vector3<f64> {
        (self.least_ut + self.most_ut) * 0.5
    }

    fn directions(&self) -> Sphere {
        let middle_ut = self.middle_ut();
        Sphere::of(&self.samples.iter().map(|(_, field_ut)| field_ut - middle_ut).collect::<Vec<_>>())
    }

    /// What only trembles covers nothing.
    fn is_seen(&self) -> [bool; 3] {
        let half_ut = (self.most_ut - self.least_ut) * 0.5;
        std::array::from_fn(|axis| half_ut[axis] >= MIN_HALF_RANGE_UT)
    }

    fn told(&self, sphere: &Sphere, is_seen: [bool; 3]) -> Coverage {
        let faces = sphere.faces();
        let there = |face: usize| faces[face] && is_seen[face / 2];
        let count = (0..6).filter(|face| there(*face)).count();
        let share = (count as f64 / 6.0).min(sphere.cells() as f64 / MIN_CELLS as f64).min(1.0);
        let name = |face: usize| format!("{}{}", ["+", "−"][face % 2], ["x", "y", "z"][face / 2]);
        let absent: Vec<_> = (0..6).filter(|face| !there(*face)).map(name).collect();
        let mut missing = Vec::new();
        if self.samples.is_empty() {
            missing.push("a magnetic field: there is no sample of one".into());
        } else if !absent.is_empty() {
            missing.push(format!(
                "the field was never along {} of the sensor; turn the unit, far from iron, once about each of its axes in each of its \
                 positions: upright, on its sides, on nose and tail, upside down",
                absent.join(", ")
            ));
        } else if share < 1.0 {
            missing.push(format!(
                "{} more of the 24 parts of the sphere; turn the unit about all axes, askew as well",
                MIN_CELLS - sphere.cells()
            ));
        }
        // Cells of a box that only trembles are none.
        let cells = if is_seen == [false; 3] { 0 } else { sphere.cells() };
        Coverage {
            share: if missing.is_empty() { 1.0 } else { share.min(0.99) },
            found: format!("{} samples of the field in {cells} of 24 parts of the sphere", self.samples.len()),
            missing,
        }
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let before = self.coverage();
        if before.share < 1.0 {
            return Err(Refusal::thin(Kind::Mag, before));
        }
        let weak = |coverage: &Coverage| {
            let missing =
                "a field of one strength from all sides; turn the unit in one place, far from iron, about all axes"
                    .into();
            Refusal::weak(Kind::Mag, coverage.clone(), missing)
        };
        let fit = self.fit().ok_or_else(|| weak(&before))?;
        // The same about the centre that was found.
        let directions: Vec<_> = self.samples.iter().map(|(_, field_ut)| fit.corrected(field_ut)).collect();
        let coverage = self.told(&Sphere::of(&directions), [true; 3]);
        if coverage.share < 1.0 {
            return Err(Refusal::thin(Kind::Mag, coverage));
        }
        let [hard_sd, soft_sd, cross_sd] = deviations(&fit.covariance);
        let is_certain =
            hard_sd.amax() <= MAX_HARD_SD * fit.strength_ut && soft_sd.sup(&cross_sd).amax() <= MAX_SOFT_SD;
        let is_ellipsoid = fit.at.matrix().cholesky().is_some();
        if !(is_certain && is_ellipsoid) {
            return Err(weak(&coverage));
        }
        Ok(self.report(&fit, coverage))
    }

    fn report(&self, fit: &Fit, coverage: Coverage) -> Report {
        let Fit { at, strength_ut, covariance } = fit;
        let [hard_sd, soft_sd, cross_sd] = deviations(covariance);
        let rms = |length: &dyn Fn(&Vector3<f64>) -> f64| {
            let squares = self.samples.iter().map(|(_, field_ut)| (length(field_ut) - strength_ut).powi(2));
            (squares.sum::<f64>() / self.samples.len() as f64).sqrt()
        };
        let matrix = at.matrix();
        let mut notes = vec![match self.strength_ut {
            Some(_) => format!("scaled to a field of {strength_ut:.1} µT"),
            None => format!("the field's strength is {strength_ut:.1} µT on the mean; --field-ut says the true one"),
        }];
        if !EARTH_UT.contains(strength_ut) {
            notes.push("that is no strength of the earth's field, 22 to 67 µT: is the unit µT?".into());
        }
        Report {
            kind: "magnetometer",
            values: vec![
                Value::vector("hard iron", at.bias(), hard_sd, "µT"),
                Value::vector("soft iron xx…", matrix.diagonal(), soft_sd, ""),
                Value::vector("soft iron xy…", Vector3::new(matrix.m12, matrix.m13, matrix.m23), cross_sd, ""),
            ],
            residual: Residual {
                of: "|m| less the field's strength, root mean square",
                before: rms(&|field_ut| field_ut.norm()),
                after: rms(&|field_ut| fit.corrected(field_ut).norm()),
                unit: "µT",
            },
            coverage,
            notes,
            replaces: "[ingest.calibration.mag], if it is there",
            block: format!(
                "[ingest.calibration.mag]\nbias = {} # µT\nmatrix = {}\n",
                array(at.bias().as_slice()),
                rows(&matrix)
            ),
        }
    }

    fn fit(&self) -> Option<Fit> {
        let (centre_ut, radius_ut) = self.sphere()?;
        let strength_ut = self.strength_ut.unwrap_or(radius_ut);
        let begun = Ellipsoid::<9>::sphere(centre_ut, strength_ut / radius_ut);
        let alike = vec![1.0; self.samples.len()];
        let rough = self.converged(begun, strength_ut, &alike)?;
        let fine = self.converged(rough, strength_ut, &self.weights(&rough))?;
        let covariance = self.sums(&fine, strength_ut, &self.weights(&rough)).1.block_covariance()?;
        let fit = Fit { at: fine, strength_ut, covariance };
        Some(if self.strength_ut.is_some() { fit } else { fit.of_mean_strength()? })
    }

    /// Centre and radius of the sphere next to the samples: |m|² = 2 c·m + k, which is linear.
    fn sphere(&self) -> Option<(Vector3<f64>, f64)> {
        let mean = self.samples.iter().map(|(_, field_ut)| field_ut).sum::<Vector3<f64>>() / self.samples.len() as f64;
        let mut normal = Normal::<4>::new();
        for (_, field_ut) in &self.samples {
            let arm = field_ut - mean;
            normal.add(-arm.norm_squared(), &[2.0 * arm.x, 2.0 * arm.y, 2.0 * arm.z, 1.0].into(), 1.0);
        }
        let solved = normal.step()?;
        let centre = Vector3::new(solved[0], solved[1], solved[2]);
        let radius = (solved[3] + centre.norm_squared()).sqrt();
        (radius.is_finite() && radius > 0.0).then_some((mean + centre, radius))
    }

    /// Each direction counts alike, however many samples it has; a part with few samples counts no more than twice as much as it would.
    fn weights(&self, at: &Ellipsoid<9>) -> Vec<f64> {
        let directions: Vec<_> = self.samples.iter().map(|(_, m)| at.matrix() * (m - at.bias())).collect();
        let sphere = Sphere::of(&directions);
        let usual = self.samples.len() as f64 / sphere.cells().max(1) as f64;
        directions.iter().map(|direction| (usual / f64::from(sphere.count(direction).max(1))).min(2.0)).collect()
    }

    /// By steps of Gauss and Newton, halved where they go too far.
    fn converged(&self, begun: Ellipsoid<9>, strength_ut: f64, weights: &[f64]) -> Option<Ellipsoid<9>> {
        let mut at = begun;
        for _ in 0..MAX_STEPS {
            let (cost, mut normal) = self.sums(&at, strength_ut, weights);
            let mut step = normal.step()?;
            let mut next = Ellipsoid(at.0 + step);
            for _ in 0..8 {
                if self.sums(&next, strength_ut, weights).0 <= cost {
                    break;
                }
                step *= 0.5;
                next = Ellipsoid(at.0 + step);
            }
            at = next;
            if step.amax() < 1e-8 {
                break;
            }
        }
        at.0.iter().all(|part| part.is_finite()).then_some(at)
    }

    /// Mean of the samples' costs by Huber, and the sums with the weights that belong to it.
    fn sums(&self, at: &Ellipsoid<9>, strength_ut: f64, weights: &[f64]) -> (f64, Normal<9>) {
        let residuals: Vec<_> = self.samples.iter().map(|(_, field_ut)| at.residual(field_ut, strength_ut)).collect();
        let mut sizes: Vec<_> = residuals.iter().map(|(residual, _)| residual.abs()).collect();
        let middle = sizes.len() / 2;
        // Of normal errors half are smaller than 0.6745 standard deviations.
        let sd = (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(1e-6);
        let mut normal = Normal::<9>::new();
        let mut cost = 0.0;
        let mut block_ns = i64::MIN;
        for (((t_ns, _), (residual, jacobian)), weight) in self.samples.iter().zip(&residuals).zip(weights) {
            if *t_ns >= block_ns {
                normal.end_block();
                block_ns = t_ns + BLOCK_NS;
            }
            let trust = (HUBER * sd / residual.abs().max(f64::MIN_POSITIVE)).min(1.0);
            cost += weight * residual * residual * trust;
            normal.add(*residual, jacobian, weight * trust);
        }
        normal.end_block();
        (cost, normal)
    }
}

impl Fit {
    fn corrected(&self, field_ut: &Vector3<f64>) -> Vector3<f64> {
        self.at.matrix() * (field_ut - self.at.bias())
    }

    /// M by det(M)^⅓, the strength likewise: what the sensor says of it on the mean is kept.
    fn of_mean_strength(self) -> Option<Self> {
        let matrix = self.at.matrix();
        let inverse = matrix.try_inverse()?;
        let factor = matrix.determinant().cbrt().recip();
        if !(factor.is_finite() && factor > 0.0) {
            return None;
        }
        // d(s M) = s (dM − M tr(M⁻¹ dM) / 3).
        let basis = |i: usize| {
            let mut parameters = nalgebra::SVector::<f64, 9>::zeros();
            parameters[i] = 1.0;
            Ellipsoid(parameters).matrix()
        };
        let packed = |m: Matrix3<f64>| [m.m11, m.m22, m.m33, m.m12, m.m13, m.m23];
        let mut change = SMatrix::<f64, 9, 9>::identity();
        for i in 3..9 {
            let by_one = basis(i);
            let moved = packed((by_one - matrix * ((inverse * by_one).trace() / 3.0)) * factor);
            (3..9).zip(moved).for_each(|(row, part)| change[(row, i)] = part);
        }
        let mut at = self.at;
        at.0.rows_mut(3, 6).iter_mut().for_each(|part| *part *= factor);
        Some(Self {
            at,
            strength_ut: self.strength_ut * factor,
            covariance: change * self.covariance * change.transpose(),
        })
    }
}
