//! Gyro bias: the mean rate at rest.
//!
//! The measured bias includes the earth's rotation, 15 °/h. This error is negligible.

use attitude::Vector3;

use crate::{
    input::{Kind, Sample},
    report::{Coverage, Rejection, Report, Residual, Value, array, pluralize},
    rest::{MeanNoise, Rest, RestFinder, mean},
};

/// Minimum total duration of the rests, s.
const MIN_REST_S: f64 = 5.0;
/// Maximum standard deviation of an accepted bias, rad/s (0.1 °/s).
const MAX_SD_RAD_S: f64 = 0.1 * core::f64::consts::PI / 180.0;
/// Maximum deviation of the mean of one rest from the overall mean, rad/s. A larger deviation
/// indicates a steady turn or a sensor that is warming up.
const MAX_REST_DEVIATION_RAD_S: f64 = 0.3 * core::f64::consts::PI / 180.0;

/// Gyro calibrator.
#[derive(Debug, Clone, Default)]
pub struct GyroCalibrator {
    rests: RestFinder,
}

impl GyroCalibrator {
    pub(crate) fn push(&mut self, sample: &Sample) {
        self.rests.push(sample);
    }

    pub(crate) fn coverage(&self) -> Coverage {
        coverage(&self.rests.rests())
    }

    pub(crate) fn finish(&self) -> Result<Report, Rejection> {
        let rests = self.rests.rests();
        let coverage = coverage(&rests);
        if coverage.share < 1.0 {
            return Err(Rejection::incomplete(Kind::Gyro, coverage));
        }
        let series: Vec<_> = rests.iter().map(|rest| rest.rates_rad_s.as_slice()).collect();
        let all = series.concat();
        let bias_rad_s = mean(&all);
        let sd_rad_s = MeanNoise::from_series(&series).sd(all.len()).sup(&between_rests_sd(&rests, &bias_rad_s));
        let deviation_rad_s =
            rests.iter().map(|rest| (mean(&rest.rates_rad_s) - bias_rad_s).amax()).fold(0.0, f64::max);
        if sd_rad_s.amax() > MAX_SD_RAD_S || deviation_rad_s > MAX_REST_DEVIATION_RAD_S {
            let missing = format!(
                "a consistent bias; the rests differ by {:.2} °/s because the unit turned steadily in one of them or was warming up; \
                 keep it still on a fixed surface and wait until it is warm",
                sd_rad_s.amax().max(deviation_rad_s).to_degrees()
            );
            return Err(Rejection::unreliable(Kind::Gyro, coverage, missing));
        }
        let rms_deg_s = |offset: Vector3<f64>| {
            let squares = all.iter().map(|rate| (rate - offset).norm_squared()).sum::<f64>();
            (squares / all.len() as f64).sqrt().to_degrees()
        };
        Ok(Report {
            kind: "gyro",
            values: vec![Value::vector("bias", bias_rad_s, sd_rad_s, "rad/s")],
            residual: Residual {
                quantity: "RMS rate at rest (0.25 s means)",
                before: rms_deg_s(Vector3::zeros()),
                after: rms_deg_s(bias_rad_s),
                unit: "°/s",
            },
            coverage,
            notes: vec!["the bias changes with temperature; calibrate at operating temperature".into()],
            replaces: "[ingest.calibration.gyro]",
            block: format!("[ingest.calibration.gyro]\nbias = {} # rad/s\n", array(bias_rad_s.as_slice())),
        })
    }
}

/// Returns the standard deviation of the overall mean, computed from the scatter of the means of
/// the rests. Returns zero for fewer than three rests.
fn between_rests_sd(rests: &[Rest], overall_mean: &Vector3<f64>) -> Vector3<f64> {
    let blocks: usize = rests.iter().map(|rest| rest.rates_rad_s.len()).sum();
    let count = rests.len() as f64;
    if rests.len() < 3 {
        return Vector3::zeros();
    }
    let squares = rests.iter().map(|rest| {
        let share = rest.rates_rad_s.len() as f64 / blocks as f64;
        let deviation = share * (mean(&rest.rates_rad_s) - overall_mean);
        deviation.component_mul(&deviation)
    });
    (squares.sum::<Vector3<f64>>() * (count / (count - 1.0))).map(f64::sqrt)
}

fn coverage(rests: &[Rest]) -> Coverage {
    let rest_s = rests.iter().map(Rest::duration_s).fold(0.0, |sum, one_s| sum + one_s);
    let share = (rest_s / MIN_REST_S).min(1.0);
    let missing = (share < 1.0).then(|| {
        format!(
            "{:.1} s of rest; lay the unit on a fixed surface and do not touch it for {MIN_REST_S:.0} s",
            (MIN_REST_S - rest_s).max(0.1)
        )
    });
    Coverage {
        share,
        summary: format!("{}, {rest_s:.1} s", pluralize(rests.len(), "rest")),
        missing: missing.into_iter().collect(),
    }
}
