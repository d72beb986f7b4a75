//! The gyro's bias: its mean rate at rest.
//!
//! The earth's own turn, 15 °/h, is in it, and is too slow for what the bias is used for.

use attitude::Vector3;

use crate::{
    Kind, Sample,
    report::{Coverage, Refusal, Report, Residual, Value, array},
    rest::{MeanNoise, Rest, RestFinder, mean},
};

/// How long the unit must have been at rest in all, s.
const REST_S: f64 = 5.0;
/// The most that the bias may be uncertain, rad/s: a tenth of a degree a second.
const MAX_SD_RAD_S: f64 = 0.1 * core::f64::consts::PI / 180.0;
/// The most that the mean of a rest may be away from that of all, rad/s: a steady turn, or a sensor that warms up.
const MAX_APART_RAD_S: f64 = 0.3 * core::f64::consts::PI / 180.0;

/// Takes readings.
#[derive(Debug, Clone, Default)]
pub struct Gyro {
    rests: RestFinder,
}

impl Gyro {
    pub(crate) fn take(&mut self, sample: &Sample) {
        self.rests.take(sample);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        coverage(&self.rests.rests())
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let rests = self.rests.rests();
        let coverage = coverage(&rests);
        if coverage.share < 1.0 {
            return Err(Refusal::thin(Kind::Gyro, coverage));
        }
        let series: Vec<_> = rests.iter().map(|rest| rest.rates_rad_s.as_slice()).collect();
        let all = series.concat();
        let bias_rad_s = mean(&all);
        let sd_rad_s = MeanNoise::of(&series).sd(all.len()).sup(&between(&rests, &bias_rad_s));
        let apart_rad_s = rests.iter().map(|rest| (mean(&rest.rates_rad_s) - bias_rad_s).amax()).fold(0.0, f64::max);
        if sd_rad_s.amax() > MAX_SD_RAD_S || apart_rad_s > MAX_APART_RAD_S {
            let missing = format!(
                "one bias: the rests disagree by {:.2} °/s, as where the unit turned steadily in one of them, or warmed up; lay it on \
                 something that does not move, and wait until it is warm",
                sd_rad_s.amax().max(apart_rad_s).to_degrees()
            );
            return Err(Refusal::weak(Kind::Gyro, coverage, missing));
        }
        let rms_deg_s = |from: Vector3<f64>| {
            let squares = all.iter().map(|rate| (rate - from).norm_squared()).sum::<f64>();
            (squares / all.len() as f64).sqrt().to_degrees()
        };
        Ok(Report {
            kind: "gyro",
            values: vec![Value::vector("bias", bias_rad_s, sd_rad_s, "rad/s")],
            residual: Residual {
                of: "mean rate of a quarter of a second at rest, root mean square",
                before: rms_deg_s(Vector3::zeros()),
                after: rms_deg_s(bias_rad_s),
                unit: "°/s",
            },
            coverage,
            notes: vec![
                "the temperature is not known: a bias of another temperature is another one, so calibrate a warm sensor".into(),
            ],
            replaces: "[ingest.calibration.gyro], if it is there",
            block: format!("[ingest.calibration.gyro]\nbias = {} # rad/s\n", array(bias_rad_s.as_slice())),
        })
    }
}

/// What the rests' own means say of the mean of all: zero of fewer than three.
fn between(rests: &[Rest], of_all: &Vector3<f64>) -> Vector3<f64> {
    let blocks: usize = rests.iter().map(|rest| rest.rates_rad_s.len()).sum();
    let count = rests.len() as f64;
    if rests.len() < 3 {
        return Vector3::zeros();
    }
    let squares = rests.iter().map(|rest| {
        let share = rest.rates_rad_s.len() as f64 / blocks as f64;
        let off = share * (mean(&rest.rates_rad_s) - of_all);
        off.component_mul(&off)
    });
    (squares.sum::<Vector3<f64>>() * (count / (count - 1.0))).map(f64::sqrt)
}

fn coverage(rests: &[Rest]) -> Coverage {
    let rest_s = rests.iter().map(Rest::duration_s).fold(0.0, |sum, one_s| sum + one_s);
    let share = (rest_s / REST_S).min(1.0);
    let missing = (share < 1.0).then(|| {
        format!(
            "{:.1} s of rest; lay the unit on something that does not move, and do not touch it for {REST_S:.0} s",
            (REST_S - rest_s).max(0.1)
        )
    });
    Coverage {
        share,
        found: format!("at rest for {rest_s:.1} s in {} rests", rests.len()),
        missing: missing.into_iter().collect(),
    }
}
