//! Scores of a stage on a recording: the RMSE, and the errors divided by their reported standard
//! deviations.

use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    magnetometer::RepeatFilter,
    stage::Stage,
};
use recording::Row;

use super::recorded::Recording;

/// Ideal 68 % and 95 % quantiles of an error in one axis, in standard deviations.
///
/// The ideal error is normally distributed.
const ONE_AXIS: [f64; 2] = [1.0, 2.0];
/// Ideal 68 % and 95 % quantiles of an error in two axes, in standard deviations of one axis.
///
/// The ideal error is normally distributed.
const TWO_AXES: [f64; 2] = [1.51, 2.45];

/// Chain of the default gyro and accel stages and a fuser.
struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
    repeat_filter: RepeatFilter,
    last_t_ns: Option<i64>,
}

impl Chain {
    fn new(stage: &str) -> Self {
        Self {
            gyro: Gyro::from_name("mobius").unwrap(),
            accel: Accelerometer::default(),
            fuser: Fuser::from_name(stage).unwrap(),
            repeat_filter: RepeatFilter::default(),
            last_t_ns: None,
        }
    }

    fn step(&mut self, row: &Row) -> Fused {
        let dt_s = (row.t_ns - self.last_t_ns.replace(row.t_ns).unwrap_or(row.t_ns)) as f64 * 1e-9;
        let rate_rad_s = Vector3::from(row.rate_rad_s);
        self.fuser.step(&FuserInput {
            motion: Some(self.gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean })),
            inclination: Some(self.accel.step(&Vector3::from(row.force_m_s2))),
            field_ut: self.repeat_filter.new_sample(row.field_ut.map(Vector3::from)),
            rest_credible: true,
            rate_credible: true,
            fix: None,
        })
    }
}

/// Error of an attitude, rad.
#[derive(Debug, Clone, Copy)]
struct AttitudeError {
    inclination_rad: f64,
    heading_rad: f64,
    total_rad: f64,
}

/// Returns the error of an output relative to the reference of a row.
///
/// Returns `None` if the row has no reference or is not scored.
fn error(out: &Fused, row: &Row) -> Option<AttitudeError> {
    let [w, x, y, z] = row.reference.filter(|reference| reference.scored)?.quaternion;
    let e = out.attitude.quaternion() * Quaternion::new(w, x, y, z).conjugate();
    Some(AttitudeError {
        inclination_rad: 2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k)),
        heading_rad: 2.0 * e.k.abs().atan2(e.w.abs()),
        total_rad: 2.0 * e.imag().norm().atan2(e.w.abs()),
    })
}

/// RMSE of a stage on a recording in degrees, and its errors divided by their reported standard
/// deviations.
#[derive(Debug, Clone, Default)]
pub(super) struct Scores {
    pub(super) total: f64,
    pub(super) heading: f64,
    pub(super) inclination: f64,
    normalised_inclination: Vec<f64>,
    normalised_heading: Vec<f64>,
}

/// Runs a stage on a recording.
pub(super) fn run(stage: &str, recording: &Recording) -> Scores {
    let (mut chain, mut scores) = (Chain::new(stage), Scores::default());
    let mut count = 0.0;
    for row in &recording.rows {
        let out = chain.step(row);
        let Some(error) = error(&out, row) else { continue };
        count += 1.0;
        let square = |rad: f64| rad.to_degrees() * rad.to_degrees();
        scores.total += square(error.total_rad);
        scores.heading += square(error.heading_rad);
        scores.inclination += square(error.inclination_rad);
        scores.normalised_inclination.push(error.inclination_rad / out.inclination_sd_rad);
        if out.reference != CourseReference::Arbitrary {
            scores.normalised_heading.push(error.heading_rad / out.heading_sd_rad);
        }
    }
    for sum in [&mut scores.total, &mut scores.heading, &mut scores.inclination] {
        *sum = f64::sqrt(*sum / count);
    }
    if scores.normalised_heading.is_empty() {
        (scores.total, scores.heading) = (f64::NAN, f64::NAN);
    }
    scores
}

/// Returns the gyro bias that a stage has found after `t_s` seconds of a recording, or at its end.
pub(super) fn bias_at(stage: &str, recording: &Recording, t_s: f64) -> Vector3<f64> {
    let mut chain = Chain::new(stage);
    let start_ns = recording.rows[0].t_ns;
    let rows = recording.rows.iter().take_while(|row| (row.t_ns - start_ns) as f64 * 1e-9 <= t_s);
    rows.map(|row| chain.step(row).bias_rad_s).last().unwrap()
}

/// Mean scores over the recordings of a set.
///
/// The quantiles of the normalised errors are relative to those of a normal distribution.
pub(super) struct SetScores {
    pub(super) total: f64,
    pub(super) heading: f64,
    pub(super) inclination: f64,
    pub(super) inclination_ratios: [f64; 2],
    pub(super) heading_ratios: [f64; 2],
}

pub(super) fn mean(all: &[&Scores]) -> SetScores {
    let mean = |pick: fn(&Scores) -> f64| all.iter().map(|scores| pick(scores)).sum::<f64>() / all.len() as f64;
    let pooled = |pick: fn(&Scores) -> &Vec<f64>| all.iter().flat_map(|scores| pick(scores).iter().copied()).collect();
    SetScores {
        total: mean(|scores| scores.total),
        heading: mean(|scores| scores.heading),
        inclination: mean(|scores| scores.inclination),
        inclination_ratios: ratios(pooled(|scores| &scores.normalised_inclination), TWO_AXES),
        heading_ratios: ratios(pooled(|scores| &scores.normalised_heading), ONE_AXIS),
    }
}

fn ratios(mut errors: Vec<f64>, ideal: [f64; 2]) -> [f64; 2] {
    if errors.is_empty() {
        return [f64::NAN; 2];
    }
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
    [at(0.68) / ideal[0], at(0.95) / ideal[1]]
}

impl std::fmt::Display for SetScores {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { total, heading, inclination, inclination_ratios: [i68, i95], heading_ratios: [h68, h95] } = self;
        write!(f, "{inclination:7.3} {heading:7.3} (total {total:7.3}) | {i68:5.2} {i95:5.2} | {h68:5.2} {h95:5.2}")
    }
}
