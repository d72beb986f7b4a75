//! Delay of the magnetometer relative to the gyro, from back-and-forth turns. Seen from the unit, a
//! constant magnetic field rotates opposite to the measured rate, but the magnetometer reports this
//! rotation with a delay.
//!
//! The model is dm/dt = −ω × m for the magnetic field m in sensor axes and the rate ω. The field
//! read at time t belongs to time t − τ, where τ is the delay. Over a quarter of a second, from t₁
//! to t₂, this becomes m(t₂) − b = A(τ) (m(t₁) − b). Here A(τ) is the rotation measured by the gyro
//! from t₁ − τ to t₂ − τ, and b is the residual hard iron. τ, b and the gyro bias are fitted by
//! least squares with Huber weights. Only changes of the rate determine τ; a steady turn does not.

use attitude::{Vector3, calibration::Calibration};
use nalgebra::{SVector, UnitQuaternion};

use crate::{
    history::AttitudeHistory,
    input::{Kind, Prior, Sample},
    least_squares::NormalEquations,
    report::{Coverage, Rejection, Report, Residual, Value, pluralize},
};

/// Length of a window, ns.
const WINDOW_NS: i64 = 250_000_000;
/// Minimum interval between the magnetometer samples that are kept, ns. Each of these samples can
/// start a window.
const MIN_INTERVAL_NS: i64 = 25_000_000;
/// Maximum number of magnetometer samples kept.
const MAX_SAMPLES: usize = 80_000;
/// Rate change across a window above which the window is informative, rad/s.
const MIN_RATE_CHANGE_RAD_S: f64 = 0.5;
/// Minimum total length of the informative windows, s.
const MIN_INFORMATIVE_S: f64 = 5.0;
/// Time over which the errors of successive windows are correlated, ns.
const CORRELATION_NS: i64 = 2_000_000_000;
/// Size of a residual above which its Huber weight decreases, in standard deviations.
const HUBER_THRESHOLD: f64 = 2.0;
/// Maximum number of Gauss-Newton steps.
const MAX_STEPS: usize = 20;
/// Change of the delay τ used for the numerical derivative, s.
const DERIVATIVE_STEP_S: f64 = 5e-4;
/// Largest delay that can be estimated, s.
const MAX_DELAY_S: f64 = 0.2;
/// Maximum standard deviation of an accepted delay, s.
const MAX_SD_S: f64 = 0.002;
/// Maximum ratio of the RMS residual to the RMS change of the magnetic field across a window.
const MAX_UNEXPLAINED_SHARE: f64 = 0.5;
/// Range of the fuser setting `magnetometer_delay_s`, s.
const SUPPORTED_DELAY_S: std::ops::RangeInclusive<f64> = -0.01..=0.04;
/// Range to which the fuser setting `magnetometer_delay_sd_s` is clamped, s.
const OUTPUT_SD_RANGE_S: (f64, f64) = (0.0005, 0.02);

/// Magnetometer delay calibrator.
#[derive(Debug, Clone)]
pub struct ClockCalibrator {
    gyro: Calibration,
    mag: Calibration,
    history: AttitudeHistory,
    fields: Vec<FieldSample>,
    /// Start time of the current window in ns, and the rate at its start in rad/s.
    window: Option<(i64, Vector3<f64>)>,
    informative_s: f64,
}

/// Magnetometer sample: time in ns, and magnetic field in sensor axes in µT.
type FieldSample = (i64, Vector3<f64>);

/// Delay, s; hard iron, µT (3); gyro bias, rad/s (3).
type Parameters = SVector<f64, 7>;

impl ClockCalibrator {
    pub(crate) fn new(prior: &Prior) -> Self {
        Self {
            gyro: prior.gyro,
            mag: prior.mag,
            history: AttitudeHistory::new(prior.rate_kind),
            fields: Vec::new(),
            window: None,
            informative_s: 0.0,
        }
    }

    pub(crate) fn push(&mut self, sample: &Sample) {
        let rate_rad_s = self.gyro.apply(sample.rate_rad_s);
        self.history.push(sample.t_ns, rate_rad_s);
        let Some(field_ut) = sample.field_ut.map(|field_ut| self.mag.apply(field_ut)) else { return };
        let is_new = self
            .fields
            .last()
            .is_none_or(|(last_ns, last_ut)| *last_ut != field_ut && sample.t_ns - last_ns >= MIN_INTERVAL_NS);
        if !is_new || self.fields.len() >= MAX_SAMPLES || self.history.is_full() {
            return;
        }
        self.fields.push((sample.t_ns, field_ut));
        match self.window {
            Some((start_ns, start_rate_rad_s)) if sample.t_ns - start_ns >= WINDOW_NS => {
                // Only the change perpendicular to the magnetic field counts, because a rotation
                // about the field is not observable.
                let change = (rate_rad_s - start_rate_rad_s).cross(&field_ut.normalize()).norm();
                let is_contiguous = sample.t_ns - start_ns <= 2 * WINDOW_NS;
                if is_contiguous && change > MIN_RATE_CHANGE_RAD_S {
                    self.informative_s += WINDOW_NS as f64 * 1e-9;
                }
                self.window = Some((sample.t_ns, rate_rad_s));
            }
            None => self.window = self.history.last_rate_rad_s().map(|rate_rad_s| (sample.t_ns, rate_rad_s)),
            Some(_) => {}
        }
    }

    pub(crate) fn coverage(&self) -> Coverage {
        let share = (self.informative_s / MIN_INFORMATIVE_S).min(1.0);
        let missing = if self.fields.is_empty() {
            Some("a magnetometer sample; none received".into())
        } else {
            (share < 1.0).then(|| {
                format!(
                    "{:.1} s with changing rate; turn the unit to and fro about all axes, once or twice a second and faster than 30 °/s",
                    (MIN_INFORMATIVE_S - self.informative_s).max(0.1)
                )
            })
        };
        let samples = pluralize(self.fields.len(), "field sample");
        Coverage {
            share,
            summary: format!("{samples}, {:.1} s of turns to and fro", self.informative_s),
            missing: missing.into_iter().collect(),
        }
    }

    pub(crate) fn finish(&self) -> Result<Report, Rejection> {
        let coverage = self.coverage();
        if coverage.share < 1.0 {
            return Err(Rejection::incomplete(Kind::Clock, coverage));
        }
        let unreliable = |missing: &str| Rejection::unreliable(Kind::Clock, coverage.clone(), missing.into());
        let no_correlation = "motion that shows the delay; field and gyro do not match: turn the unit to and fro away from iron, and check \
                              that both sensors use the same axes";
        let (parameters, sd_s) = self.fit().ok_or_else(|| unreliable(no_correlation))?;
        let delay_s = parameters[0];
        let rms_ut = |delay_s: f64| {
            let mut parameters = parameters;
            parameters[0] = delay_s;
            self.sums(&parameters, 1e9).map_or(f64::NAN, |(normal, _)| normal.rms())
        };
        let (before_ut, after_ut) = (rms_ut(0.0), rms_ut(delay_s));
        let is_explained = after_ut < MAX_UNEXPLAINED_SHARE * self.field_change_ut();
        if !is_explained || sd_s > MAX_SD_S || delay_s.abs() > MAX_DELAY_S {
            return Err(unreliable(no_correlation));
        }
        if !SUPPORTED_DELAY_S.contains(&delay_s) {
            let delay_ms = 1e3 * delay_s;
            let missing = format!(
                "a magnetometer delay that the fuser can compensate, −10 to 40 ms; measured {delay_ms:.1} ms: correct the driver's \
                 timestamps"
            );
            return Err(unreliable(&missing));
        }
        let (min_sd_s, max_sd_s) = OUTPUT_SD_RANGE_S;
        Ok(Report {
            kind: "clock",
            values: vec![Value { name: "delay", value: vec![1e3 * delay_s], sd: vec![1e3 * sd_s], unit: "ms" }],
            residual: Residual {
                quantity: "RMS field prediction error per axis, 0.25 s ahead",
                before: before_ut,
                after: after_ut,
                unit: "µT",
            },
            coverage,
            notes: vec!["positive if the magnetometer is later than the gyro".into()],
            replaces: "[fuser] (keep its other settings in `set`)",
            block: format!(
                "[fuser]\nstage = \"multiple-model\"\nset = {{ magnetometer_delay_s = {:.4}, magnetometer_delay_sd_s = {:.4} }}\n",
                delay_s + 0.0,
                sd_s.clamp(min_sd_s, max_sd_s)
            ),
        })
    }

    /// Returns the root mean square change of the magnetic field across a window, µT per axis.
    fn field_change_ut(&self) -> f64 {
        let mut sum = 0.0;
        let pairs = self.windows().inspect(|((_, first_ut), (_, last_ut))| sum += (last_ut - first_ut).norm_squared());
        let count = pairs.count();
        (sum / (3 * count.max(1)) as f64).sqrt()
    }

    /// Returns the magnetometer samples at the start and at the end of each window.
    fn windows(&self) -> impl Iterator<Item = (&FieldSample, &FieldSample)> {
        let mut last = 0;
        self.fields.iter().map_while(move |first| {
            while self.fields.get(last)?.0 - first.0 < WINDOW_NS {
                last += 1;
            }
            Some((first, &self.fields[last]))
        })
    }

    /// Returns the best fit and the standard deviation of the delay, s.
    fn fit(&self) -> Option<(Parameters, f64)> {
        let mut parameters = Parameters::zeros();
        let mut sd_ut = 1e9;
        for _ in 0..MAX_STEPS {
            let (mut normal, residual_sd_ut) = self.sums(&parameters, sd_ut)?;
            sd_ut = residual_sd_ut;
            let step = normal.step()?;
            parameters += step;
            // Without this limit, the delay could become so large that later steps do not converge.
            parameters[0] = parameters[0].clamp(-2.0 * MAX_DELAY_S, 2.0 * MAX_DELAY_S);
            if step[0].abs() < 1e-7 {
                break;
            }
        }
        let covariance = self.sums(&parameters, sd_ut)?.0.block_covariance()?;
        Some((parameters, covariance[(0, 0)].max(0.0).sqrt()))
    }

    /// Returns the normal equations over all windows and a robust estimate of the size of the
    /// residuals, µT.
    fn sums(&self, parameters: &Parameters, sd_ut: f64) -> Option<(NormalEquations<7>, f64)> {
        let (delay_s, hard_ut) = (parameters[0], Vector3::new(parameters[1], parameters[2], parameters[3]));
        let bias_rad_s = Vector3::new(parameters[4], parameters[5], parameters[6]);
        let mut normal = NormalEquations::<7>::new();
        let mut sizes = Vec::new();
        let mut block_ns = i64::MIN;
        for ((first_ns, first_ut), (last_ns, last_ut)) in self.windows() {
            let length_s = (last_ns - first_ns) as f64 * 1e-9;
            let rotation = |delay_s: f64| self.field_rotation(*first_ns, *last_ns, delay_s);
            let (Some(gyro_rotation), Some(shifted_rotation)) =
                (rotation(delay_s), rotation(delay_s + DERIVATIVE_STEP_S))
            else {
                continue;
            };
            if *first_ns >= block_ns {
                normal.end_block();
                block_ns = first_ns + CORRELATION_NS;
            }
            let bias_rotation = UnitQuaternion::from_scaled_axis(bias_rad_s * length_s);
            let arm = first_ut - hard_ut;
            let predicted = bias_rotation * (gyro_rotation * arm);
            let residual = last_ut - hard_ut - predicted;
            let d_delay = (predicted - bias_rotation * (shifted_rotation * arm)) / DERIVATIVE_STEP_S;
            let rotation_matrix = (bias_rotation * gyro_rotation).to_rotation_matrix();
            let d_bias = predicted.cross_matrix() * length_s;
            let huber_weight = (HUBER_THRESHOLD * sd_ut / residual.norm().max(f64::MIN_POSITIVE)).min(1.0);
            for axis in 0..3 {
                let d_hard_iron = |part: usize| rotation_matrix[(axis, part)] - f64::from(u8::from(axis == part));
                let jacobian = [
                    d_delay[axis],
                    d_hard_iron(0),
                    d_hard_iron(1),
                    d_hard_iron(2),
                    d_bias[(axis, 0)],
                    d_bias[(axis, 1)],
                    d_bias[(axis, 2)],
                ];
                normal.add(residual[axis], &jacobian.into(), huber_weight);
            }
            sizes.push(residual.norm());
        }
        normal.end_block();
        let middle = sizes.len() / 2;
        // The Huber weights use the norm of the residual. For a vector of three normally
        // distributed errors, the median norm is 1.538 standard deviations of one component.
        let sd_ut =
            (sizes.len() > 1).then(|| *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.538 * 1.732)?;
        Some((normal, sd_ut.max(1e-9)))
    }

    /// Returns the apparent rotation of a fixed vector in sensor axes between two times. It is
    /// computed from the gyro readings taken `delay_s` before these times.
    ///
    /// The result is `None` if a time is outside the gyro history or if there is a gap between the
    /// times.
    fn field_rotation(&self, first_ns: i64, last_ns: i64, delay_s: f64) -> Option<UnitQuaternion<f64>> {
        let delay_ns = (delay_s * 1e9).round() as i64;
        let ((from, segment), (to, end_segment)) =
            (self.history.attitude(first_ns - delay_ns)?, self.history.attitude(last_ns - delay_ns)?);
        (segment == end_segment).then(|| to.inverse() * from)
    }
}
