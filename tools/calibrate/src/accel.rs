//! The accelerometer's bias, scale and misalignment: at rest it measures gravity, whose strength does not depend on the position.
//!
//! |M (f − b)| = g over the rests, each weighted by what its mean is known to; see `ellipsoid` for M. Six positions with each
//! axis up and down determine bias and scale; twelve or more of any kind the misalignment, too.
//!
//! Without such rests it is found in motion, as `motion` has it, of a unit that is turned slowly by hand through all positions: less
//! exactly, each direction counting alike, with Huber's weights and the deviations of errors whose size only the residuals tell.

use attitude::{Matrix3, Vector3};
use nalgebra::{SMatrix, SVector};

use crate::{
    Kind, Known, Sample,
    ellipsoid::{Ellipsoid, deviations},
    least_squares::Normal,
    motion::{Seen, Windows},
    report::{Coverage, Refusal, Report, Residual, Value, array, rows},
    rest::{MeanNoise, Rest, RestFinder},
    sphere::{PARTS, Sphere},
};

/// Rests whose forces are closer than this are one position, cosine of 15°.
const SAME_COS: f64 = 0.965_925_826_289_068_3;
/// Positions from which on the misalignment is looked for.
const POSITIONS_OF_MISALIGNMENT: usize = 12;
/// The most that bias (m/s²), scale and misalignment may be uncertain: 5 mg, and half a per cent.
const MAX_BIAS_SD_M_S2: f64 = 0.05;
const MAX_SCALE_SD: f64 = 0.005;
/// What no mean is better known than, m/s²: a step of a 16-bit accelerometer of 2 g, or a table that gives way.
const MIN_FORCE_SD_M_S2: f64 = 2e-4;
/// Steps after which a fit has found what it finds.
const MAX_STEPS: usize = 50;
/// Windows in motion that are looked for: 48 s; and how many of them hang together, for what a hand gives to one it takes from the next.
const MIN_WINDOWS: usize = 24;
const BLOCK_WINDOWS: usize = 2;
/// Where Huber's weights begin, in standard deviations.
const HUBER: f64 = 2.0;
/// A part of the sphere with few windows counts no more than so many times as much as it would.
const MAX_WEIGHT: f64 = 2.0;

/// Takes readings.
#[derive(Debug, Clone)]
pub struct Accel {
    rests: RestFinder,
    windows: Windows,
    gravity_m_s2: f64,
    newest_m_s2: Option<Vector3<f64>>,
}

/// A mean force at rest.
struct Position {
    seen: Seen,
    sd_m_s2: f64,
}

/// What a fit gave.
struct Fit {
    bias_m_s2: Vector3<f64>,
    bias_sd_m_s2: Vector3<f64>,
    matrix: Matrix3<f64>,
    scale_sd: Vector3<f64>,
    /// Of the misalignment; none where it was not looked for.
    turn_sd: Option<Vector3<f64>>,
    how: How,
}

/// What the deviations come from.
#[derive(Clone, Copy, PartialEq)]
enum How {
    /// Rests, as many as there are unknowns.
    NoiseOfRests,
    /// More rests than that.
    Rests,
    Motion,
}

impl Accel {
    pub(crate) fn new(known: &Known) -> Self {
        let windows = Windows::new(known.gyro);
        Self { rests: RestFinder::default(), windows, gravity_m_s2: known.gravity_m_s2, newest_m_s2: None }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        self.rests.take(sample);
        self.windows.take(sample);
        self.newest_m_s2 = Some(sample.force_m_s2);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        let (of_rests, of_motion) = (coverage(&self.rests()), coverage_in_motion(self.windows.whole()));
        if of_motion.share > of_rests.share { of_motion } else { of_rests }
    }

    /// A side is covered as a whole.
    pub(crate) fn parts(&self) -> [bool; PARTS] {
        let (rests, windows) = (self.rests(), self.windows.whole());
        let is_motion = coverage_in_motion(windows).share > coverage(&rests).share;
        let faces = if is_motion { faces_in_motion(windows) } else { Sphere::of(&distinct(&rests)).faces() };
        std::array::from_fn(|part| faces[part / 4])
    }

    pub(crate) fn direction(&self) -> Option<Vector3<f64>> {
        self.newest_m_s2
    }

    fn rests(&self) -> Vec<Rest> {
        self.rests.rests().into_iter().filter(Rest::feels_gravity).collect()
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let rests = self.rests();
        let of_rests = coverage(&rests);
        if of_rests.share >= 1.0 {
            let positions = positions(&rests);
            let has_many = distinct(&rests).len() >= POSITIONS_OF_MISALIGNMENT;
            let full = has_many.then(|| self.fit::<9>(&positions)).flatten().filter(is_certain);
            if let Some(fit) = full.or_else(|| self.fit::<6>(&positions).filter(is_certain)) {
                let seen: Vec<_> = positions.iter().map(|at| at.seen).collect();
                return Ok(self.report(&fit, &seen, of_rests));
            }
        }
        let in_motion = coverage_in_motion(self.windows.whole());
        if in_motion.share >= 1.0 {
            let full = self.fit_in_motion::<9>().filter(is_certain);
            if let Some(fit) = full.or_else(|| self.fit_in_motion::<6>().filter(is_certain)) {
                return Ok(self.report(&fit, self.windows.whole(), in_motion));
            }
        }
        let coverage = self.coverage();
        if coverage.share < 1.0 {
            return Err(Refusal::thin(Kind::Accel, coverage));
        }
        let missing = "positions that differ more, or longer rests: bias and scale cannot be told apart; rest for two seconds with each of the six \
                       sides up, or turn the unit for longer and more slowly"
            .into();
        Err(Refusal::weak(Kind::Accel, coverage, missing))
    }

    /// By six parameters, or by nine.
    fn fit<const N: usize>(&self, positions: &[Position]) -> Option<Fit> {
        let mut at = Ellipsoid::<N>::sphere(Vector3::zeros(), 1.0);
        let sums = |at: &Ellipsoid<N>| {
            let mut normal = Normal::<N>::new();
            for Position { seen, sd_m_s2 } in positions {
                let (residual, jacobian) = at.residual_of_mean(seen, self.gravity_m_s2);
                normal.add(residual, &jacobian, sd_m_s2.powi(-2));
            }
            normal
        };
        for _ in 0..MAX_STEPS {
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
        let how = if free > 0 { How::Rests } else { How::NoiseOfRests };
        Some(Fit::new(&at, &(normal.covariance()? * excess), how))
    }

    /// The same by windows in motion.
    fn fit_in_motion<const N: usize>(&self) -> Option<Fit> {
        let windows = self.windows.whole();
        let directions: Vec<_> = windows.iter().map(Seen::force_m_s2).collect();
        let sphere = Sphere::of(&directions);
        let usual = windows.len() as f64 / sphere.cells().max(1) as f64;
        let weight = |direction: &Vector3<f64>| (usual / f64::from(sphere.count(direction).max(1))).min(MAX_WEIGHT);
        let mut at = Ellipsoid::<N>::sphere(Vector3::zeros(), 1.0);
        let sums = |at: &Ellipsoid<N>| {
            let residuals: Vec<_> = windows.iter().map(|seen| at.residual_of_mean(seen, self.gravity_m_s2)).collect();
            let mut sizes: Vec<_> = residuals.iter().map(|(residual, _)| residual.abs()).collect();
            let middle = sizes.len() / 2;
            // Of normal errors half are smaller than 0.6745 standard deviations.
            let sd = (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(MIN_FORCE_SD_M_S2);
            let mut normal = Normal::<N>::new();
            for (i, ((residual, jacobian), direction)) in residuals.iter().zip(&directions).enumerate() {
                if i % BLOCK_WINDOWS == 0 {
                    normal.end_block();
                }
                let trust = (HUBER * sd / residual.abs().max(f64::MIN_POSITIVE)).min(1.0);
                normal.add(*residual, jacobian, weight(direction) * trust);
            }
            normal.end_block();
            normal
        };
        for _ in 0..MAX_STEPS {
            let step: SVector<f64, N> = sums(&at).step()?;
            at.0 += step;
            if step.amax() < 1e-8 {
                break;
            }
        }
        Some(Fit::new(&at, &sums(&at).block_covariance()?, How::Motion))
    }

    fn report(&self, fit: &Fit, seen: &[Seen], coverage: Coverage) -> Report {
        let Fit { bias_m_s2, bias_sd_m_s2, matrix, scale_sd, turn_sd, how } = fit;
        let rms = |matrix: &Matrix3<f64>, bias: &Vector3<f64>| {
            let squares = seen.iter().map(|one| (one.corrected(matrix, bias).norm() - self.gravity_m_s2).powi(2));
            (squares.sum::<f64>() / seen.len() as f64).sqrt()
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
        match how {
            How::NoiseOfRests => notes.push(
                "as many positions as unknowns: the residual after says nothing, the deviations are those of noise"
                    .into(),
            ),
            How::Rests => {}
            How::Motion => notes.push("found in motion; rests with each of the six sides up are more exact".into()),
        }
        Report {
            kind: "accelerometer",
            values,
            residual: Residual {
                of: "|f| less gravity, root mean square of the means",
                before: rms(&Matrix3::identity(), &Vector3::zeros()),
                after: rms(matrix, bias_m_s2),
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

impl Fit {
    fn new<const N: usize>(at: &Ellipsoid<N>, covariance: &SMatrix<f64, N, N>, how: How) -> Self {
        let [bias_sd_m_s2, scale_sd, turn_sd] = deviations(covariance);
        let turn_sd = (N > 6).then_some(turn_sd);
        Self { bias_m_s2: at.bias(), bias_sd_m_s2, matrix: at.matrix(), scale_sd, turn_sd, how }
    }
}

fn is_certain(fit: &Fit) -> bool {
    let scale_sd = fit.turn_sd.map_or(fit.scale_sd, |turn_sd| turn_sd.sup(&fit.scale_sd));
    fit.bias_sd_m_s2.amax() <= MAX_BIAS_SD_M_S2 && scale_sd.amax() <= MAX_SCALE_SD
}

/// The rests' means, and what they are known to.
fn positions(rests: &[Rest]) -> Vec<Position> {
    let noise = MeanNoise::of(&rests.iter().map(|rest| rest.forces_m_s2.as_slice()).collect::<Vec<_>>());
    let position = |rest: &Rest| {
        let force_m_s2 = rest.force_m_s2();
        // Along the force alone: the fit sees lengths.
        let sd = noise.sd(rest.forces_m_s2.len()).component_mul(&force_m_s2.normalize()).norm();
        Position { seen: Seen::still(&force_m_s2), sd_m_s2: sd.max(MIN_FORCE_SD_M_S2) }
    };
    rests.iter().map(position).collect()
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
    let named = |wanted: bool| {
        let names: Vec<_> = (0..6).filter(|face| faces[*face] == wanted).map(side).collect();
        names.join(", ")
    };
    let missing = (there < 6).then(|| {
        format!(
            "no rest with {}; turn the unit so that the side shows upwards within some 30°, and let it rest there for two \
             seconds; or turn it slowly by hand through all positions for two minutes",
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

/// Whether each side was up.
fn faces_in_motion(windows: &[Seen]) -> [bool; 6] {
    std::array::from_fn(|face| windows.iter().any(|seen| seen.sides_up[face]))
}

fn coverage_in_motion(windows: &[Seen]) -> Coverage {
    let faces = faces_in_motion(windows);
    let there = faces.iter().filter(|is_there| **is_there).count();
    let share = (there as f64 / 6.0).min(windows.len() as f64 / MIN_WINDOWS as f64).min(1.0);
    let absent: Vec<_> = (0..6).filter(|face| !faces[*face]).map(side).collect();
    let missing = (share < 1.0).then(|| match absent.is_empty() {
        true => "a longer time; turn the unit slowly by hand through all positions for a minute".into(),
        false => format!("{}; turn the unit slowly by hand so that these sides show upwards, too", absent.join(", ")),
    });
    let found = format!("in motion {} times 2 s with {there} of six sides up", windows.len());
    Coverage { share, found, missing: missing.into_iter().collect() }
}

fn side(face: usize) -> String {
    format!("{} {}", ["x", "y", "z"][face / 2], ["up", "down"][face % 2])
}
