//! The accelerometer's bias, scale and misalignment: at rest it measures gravity, whose strength does not depend on the position.
//!
//! |M (f − b)| = g over the rests, each weighted by what its mean is known to; see [`mod@crate::ellipsoid`] for M. Six positions with each
//! axis up and down determine bias and scale; twelve or more of any kind the misalignment, too.

use attitude::Vector3;
use nalgebra::{SMatrix, SVector};

use crate::{
    Kind, Known, Sample,
    ellipsoid::{Ellipsoid, deviations},
    least_squares::Normal,
    report::{Coverage, Refusal, Report, Residual, Value, array, rows},
    rest::{MeanNoise, Rest, RestFinder},
    sphere::Sphere,
};

/// Rests whose forces are closer than this are one position, cosine of 15°.
const SAME_COS: f64 = 0.965_925_826_289_068_3;
/// Positions from which on the misalignment is looked for.
const POSITIONS_OF_MISALIGNMENT: usize = 12;
/// The most that bias (m/s²), scale and misalignment may be uncertain: 5 mg, and half a per cent.
const BIAS_SD_MAX_M_S2: f64 = 0.05;
const SCALE_SD_MAX: f64 = 0.005;
/// What no mean is better known than, m/s²: a step of a 16-bit accelerometer of 2 g, or a table that gives way.
const FORCE_SD_MIN_M_S2: f64 = 2e-4;
/// Steps after which a fit has found what it finds.
const STEPS_MAX: usize = 50;

/// Takes readings.
#[derive(Debug, Clone)]
pub struct Accel {
    rests: RestFinder,
    gravity_m_s2: f64,
}

/// A mean force at rest.
struct Position {
    force_m_s2: Vector3<f64>,
    sd_m_s2: f64,
}

/// What a fit gave.
struct Fit {
    bias_m_s2: Vector3<f64>,
    bias_sd_m_s2: Vector3<f64>,
    matrix: attitude::Matrix3<f64>,
    scale_sd: Vector3<f64>,
    /// Of the misalignment; none where it was not looked for.
    turn_sd: Option<Vector3<f64>>,
    /// The residuals told something of the errors.
    has_residuals: bool,
}

impl Accel {
    pub(crate) fn new(known: &Known) -> Self {
        Self { rests: RestFinder::default(), gravity_m_s2: known.gravity_m_s2 }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        self.rests.take(sample);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        coverage(&self.rests())
    }

    fn rests(&self) -> Vec<Rest> {
        self.rests.rests().into_iter().filter(Rest::feels_gravity).collect()
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let rests = self.rests();
        let coverage = coverage(&rests);
        if coverage.share < 1.0 {
            return Err(Refusal::thin(Kind::Accel, coverage));
        }
        let series: Vec<_> = rests.iter().map(|rest| rest.forces_m_s2.as_slice()).collect();
        let noise = MeanNoise::of(&series);
        let positions: Vec<_> = rests
            .iter()
            .map(|rest| {
                let force_m_s2 = rest.force_m_s2();
                // Along the force alone: the fit sees lengths.
                let sd = noise.sd(rest.forces_m_s2.len()).component_mul(&force_m_s2.normalize()).norm();
                Position { force_m_s2, sd_m_s2: sd.max(FORCE_SD_MIN_M_S2) }
            })
            .collect();
        let full = (distinct(&rests).len() >= POSITIONS_OF_MISALIGNMENT).then(|| self.fit::<9>(&positions)).flatten();
        let full = full.filter(|fit| is_certain(fit) && fit.turn_sd.is_some_and(|sd| sd.amax() <= SCALE_SD_MAX));
        let fit = full.or_else(|| self.fit::<6>(&positions)).filter(is_certain).ok_or_else(|| {
            let missing = "positions that differ more, or longer rests: bias and scale cannot be told apart; rest for two seconds with each of \
                           the six sides up"
                .into();
            Refusal::weak(Kind::Accel, coverage.clone(), missing)
        })?;
        Ok(self.report(&fit, &positions, coverage))
    }

    /// By six parameters, or by nine.
    fn fit<const N: usize>(&self, positions: &[Position]) -> Option<Fit> {
        let mut at = Ellipsoid::<N>::sphere(Vector3::zeros(), 1.0);
        let sums = |at: &Ellipsoid<N>| {
            let mut normal = Normal::<N>::new();
            for Position { force_m_s2, sd_m_s2 } in positions {
                let (residual, jacobian) = at.residual(force_m_s2, self.gravity_m_s2);
                normal.add(residual, &jacobian, sd_m_s2.powi(-2));
            }
            normal
        };
        for _ in 0..STEPS_MAX {
            let step: SVector<f64, N> = sums(&at).step()?;
            at.0 += step;
            if step.amax() < 1e-10 {
                break;
            }
        }
        let normal = sums(&at);
        // Where the residuals are larger than the noise of the rests, the errors are, too: tables give way, and sensors repeat to their data sheet.
        let free = positions.len().saturating_sub(N);
        let excess = if free > 0 { (normal.cost() / free as f64).max(1.0) } else { 1.0 };
        let covariance: SMatrix<f64, N, N> = normal.covariance()? * excess;
        let [bias_sd_m_s2, scale_sd, turn_sd] = deviations(&covariance);
        Some(Fit {
            bias_m_s2: at.bias(),
            bias_sd_m_s2,
            matrix: at.matrix(),
            scale_sd,
            turn_sd: (N > 6).then_some(turn_sd),
            has_residuals: free > 0,
        })
    }

    fn report(&self, fit: &Fit, positions: &[Position], coverage: Coverage) -> Report {
        let Fit { bias_m_s2, bias_sd_m_s2, matrix, scale_sd, turn_sd, has_residuals } = fit;
        let rms = |length: &dyn Fn(&Vector3<f64>) -> f64| {
            let squares = positions.iter().map(|at| (length(&at.force_m_s2) - self.gravity_m_s2).powi(2)).sum::<f64>();
            (squares / positions.len() as f64).sqrt()
        };
        let mut values = vec![
            Value::vector("bias", *bias_m_s2, *bias_sd_m_s2, "m/s²"),
            Value::vector("scale", matrix.diagonal(), *scale_sd, ""),
        ];
        let mut notes = Vec::new();
        let matrix_line = match turn_sd {
            Some(sd) => {
                let turn = Vector3::new(matrix.m12, matrix.m13, matrix.m23);
                values.push(Value::vector("xy, xz, yz", turn, *sd, ""));
                format!("matrix = {}", rows(matrix))
            }
            None => {
                let of_twelve = "for the misalignment of the axes, rest in twelve positions or more, askew as well";
                notes.push(format!("bias and scale alone; {of_twelve}"));
                format!("scale = {}", array(matrix.diagonal().as_slice()))
            }
        };
        if !has_residuals {
            notes.push(
                "as many positions as unknowns: the residual after says nothing, the deviations are those of noise"
                    .into(),
            );
        }
        Report {
            kind: "accelerometer",
            values,
            residual: Residual {
                of: "|f| less gravity at rest, root mean square",
                before: rms(&|force| force.norm()),
                after: rms(&|force| (matrix * (force - bias_m_s2)).norm()),
                unit: "m/s²",
            },
            coverage,
            notes,
            replaces: "[ingest.calibration.accel], if it is there",
            block: format!(
                "[ingest.calibration.accel]\nbias = {} # m/s²\n{matrix_line}\n",
                array(bias_m_s2.as_slice())
            ),
        }
    }
}

fn is_certain(fit: &Fit) -> bool {
    fit.bias_sd_m_s2.amax() <= BIAS_SD_MAX_M_S2 && fit.scale_sd.amax() <= SCALE_SD_MAX
}

/// Directions of gravity that are not nearly the same.
fn distinct(rests: &[Rest]) -> Vec<Vector3<f64>> {
    let mut distinct: Vec<Vector3<f64>> = Vec::new();
    for rest in rests {
        let direction = rest.force_m_s2().normalize();
        if distinct.iter().all(|other| other.dot(&direction) < SAME_COS) {
            distinct.push(direction);
        }
    }
    distinct
}

fn coverage(rests: &[Rest]) -> Coverage {
    let positions = distinct(rests);
    let faces = Sphere::of(&positions).faces();
    let there = faces.iter().filter(|is_there| **is_there).count();
    let name = |face: usize| format!("{} {}", ["x", "y", "z"][face / 2], ["up", "down"][face % 2]);
    let named = |wanted: bool| {
        let names: Vec<_> = (0..6).filter(|face| faces[*face] == wanted).map(name).collect();
        names.join(", ")
    };
    let missing = (there < 6).then(|| {
        format!(
            "no rest with {}; turn the unit so that the side shows upwards within some 30°, and let it rest there for two seconds",
            named(false).replace(", ", ", nor with ")
        )
    });
    let of = if there > 0 { format!(": {}", named(true)) } else { String::new() };
    Coverage {
        share: there as f64 / 6.0,
        found: format!("{} rests in {} positions{of}", rests.len(), positions.len()),
        missing: missing.into_iter().collect(),
    }
}
