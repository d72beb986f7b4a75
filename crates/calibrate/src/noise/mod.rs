//! Noise of gyro and accelerometer, from the Allan deviations at rest.
//!
//! Input: readings of a unit that does not move, at a constant rate of 10 Hz to 10 kHz.
//!
//! Output: for each axis, the random walk of the angle or velocity, the bias instability and the
//! random walk of the bias, with confidence intervals. Also the Allan deviations, and parameters of
//! a fuser; see [`NoiseReport`].
//!
//! Failure: readings are rejected if the rests are too short, the rate varies, an axis is constant
//! or the model cannot be fitted to an axis. A coefficient that the readings do not determine is
//! reported as such, with an upper limit.
//!
//! The Allan deviations are fitted from τ = 1 s on. At shorter τ, the low-pass filter of the
//! sensor, repeated values and quantisation change the deviations.
//!
//! | module | content |
//! | --- | --- |
//! | `rows` | readings and axes |
//! | `rests` | rests, motion, gaps and rate |
//! | `allan` | Allan variances and their covariances |
//! | `model` | noise model and its fit |
//! | `report` | coefficients, curves and text |
//! | `settings` | parameters of a fuser |

mod allan;
mod model;
mod report;
mod rests;
mod rows;
mod settings;

use crate::{
    input::{Intake, Sample},
    report::{Coverage, Rejection, pluralize},
};
use allan::{Coefficients, Covariances};
use model::Fit;
pub use report::{AllanPoint, AxisNoise, Estimate, NoiseReport, RestSpan, SensorNoise};
use rests::{MIN_REST_S, Motion, MotionSign, Rest, Timing};
use rows::{AXES, Axis, Row};

/// Minimum total duration of the rests, s.
const MIN_TOTAL_S: f64 = 30.0;
/// Maximum number of readings kept. When it is reached, pairs of readings are averaged, so that
/// only Allan deviations at the shortest τ are lost.
const MAX_ROWS: usize = 1 << 21;
/// Range of the rate, Hz. At lower rates, a second has too few readings to detect motion.
const RATE_RANGE_HZ: std::ops::RangeInclusive<f64> = 10.0..=10_000.0;
/// Shortest τ of the fit, s.
const FIRST_TAU_S: f64 = 1.0;
/// Minimum ratio of a coefficient N², B² or K² to its standard deviation.
const MIN_SIGNIFICANCE: f64 = 2.0;
/// Distance of an upper limit from the estimate, in standard deviations. It corresponds to 95 % of
/// a normal distribution.
const UPPER_LIMIT: f64 = 1.645;
/// Number of iterations for computing an upper limit.
const LIMIT_REPETITIONS: usize = 3;
/// Maximum number of times that the duration of the recording is doubled in the search for a
/// duration that determines a coefficient.
const MAX_DOUBLINGS: u32 = 6;
/// Limit for the misfit of the model.
///
/// The misfit is the difference between χ² and its mean, in standard deviations of χ². Above the
/// limit, the model does not describe the deviations.
const MAX_MISFIT: f64 = 4.0;
/// Maximum number of motions that a message lists.
const MAX_LISTED: usize = 5;

/// Collects readings and computes the noise of a unit from them.
#[derive(Debug, Clone, Default)]
pub struct NoiseCalibrator {
    intake: Intake,
    rows: Vec<Row>,
    /// Sums over the readings that form the next row.
    ///
    /// The sums are those of the values and of the times, followed by the number of readings. The
    /// times are relative to the first reading of the row.
    sum: Option<(Row, i64, u32)>,
    /// Binary logarithm of the number of readings per row.
    halvings: u32,
}

impl NoiseCalibrator {
    /// Adds a reading. Skips it if its rate or force is not finite or its time does not increase.
    pub fn push(&mut self, sample: &Sample) {
        let Some(sample) = self.intake.accept(sample) else { return };
        let mut row = Row { t_ns: sample.t_ns, values: [0.0; AXES] };
        row.values[..3].copy_from_slice(sample.rate_rad_s.as_slice());
        row.values[3..].copy_from_slice(sample.force_m_s2.as_slice());
        let count = 1 << self.halvings;
        let (first, offset_ns, pushed) = self.sum.take().map_or((row, 0, 1), |(mut sum, offset_ns, pushed)| {
            sum.values.iter_mut().zip(row.values).for_each(|(sum, value)| *sum += value);
            (sum, offset_ns.saturating_add(row.t_ns - sum.t_ns), pushed + 1)
        });
        if pushed < count {
            self.sum = Some((first, offset_ns, pushed));
            return;
        }
        let values = first.values.map(|sum| sum / f64::from(count));
        self.rows.push(Row { t_ns: first.t_ns + offset_ns / i64::from(count), values });
        if self.rows.len() >= MAX_ROWS {
            self.rows = self.rows.chunks_exact(2).map(Row::mean_of_pair).collect();
            self.halvings += 1;
        }
    }

    /// Computes the noise, and parameters for the fuser `stage`.
    ///
    /// # Errors
    ///
    /// Returns a [`Rejection`] that lists what is missing. Readings are rejected if the rests are
    /// too short, the rate varies or is out of range, an axis is constant, or the model cannot be
    /// fitted to the noise of an axis.
    pub fn finish(&self, stage: &str) -> Result<NoiseReport, Rejection> {
        let Some(timing) = Timing::new(&self.rows) else {
            return Err(rejection(0.0, "no readings".into(), vec![needed_rest(MIN_TOTAL_S)]));
        };
        let readings_per_row = f64::from(1u32 << self.halvings);
        let rate_hz = readings_per_row / timing.median_s;
        let (rests, motions) = rests::find(&self.rows, timing.median_s);
        let spans: Vec<_> = rests.iter().map(|rest| self.span(rest)).collect();
        let total_s = spans.iter().map(RestSpan::duration_s).fold(0.0, |sum, one_s| sum + one_s);
        let summary = format!("{}, {total_s:.1} s at {rate_hz:.1} Hz", pluralize(spans.len(), "rest"));
        let unreliable = |missing: String| Err(rejection(1.0, summary.clone(), vec![missing]));
        if !RATE_RANGE_HZ.contains(&rate_hz) {
            return unreliable(format!(
                "a rate of 10 Hz to 10 kHz; found {rate_hz:.3} Hz: check the unit of the times"
            ));
        }
        if !timing.is_constant() {
            let (min_hz, max_hz) = timing.rates_hz;
            let [min_hz, max_hz] = [min_hz, max_hz].map(|hz| hz * readings_per_row);
            return unreliable(format!(
                "a constant rate; it varies from {min_hz:.1} to {max_hz:.1} Hz: record without a change of the sensor's settings"
            ));
        }
        if total_s < MIN_TOTAL_S {
            let mut missing = vec![needed_rest(MIN_TOTAL_S - total_s)];
            missing.extend(list_motions(&motions).into_iter().map(|motion| format!("rest instead of {motion}")));
            return Err(rejection((total_s / MIN_TOTAL_S).min(0.99), summary, missing));
        }
        let series = Series::new(&self.rows, &rests);
        if let Some(axis) = Axis::ALL.iter().find(|axis| series.is_constant(**axis)) {
            let (sensor, name) = (axis.sensor(), axis.name());
            return unreliable(format!(
                "values of the {sensor}, axis {name}, that change; check the driver or the columns"
            ));
        }
        let mut notes = motion_notes(&motions, &spans);
        notes.extend(timing_notes(&timing));
        notes.extend(self.intake.note());
        let mut forecast = Forecast::new(&series);
        let mut sensors = Vec::new();
        for (sensor, axes) in ["gyro", "accelerometer"].into_iter().zip(Axis::ALL.chunks(3)) {
            let mut noise = Vec::new();
            for axis in axes {
                let Some((fitted, misfit)) = series.fit(*axis, &mut forecast) else {
                    let (sensor, name) = (axis.sensor(), axis.name());
                    return unreliable(format!(
                        "noise of the {sensor}, axis {name}, that follows the model; record a longer rest"
                    ));
                };
                if misfit > MAX_MISFIT {
                    notes.push(format!(
                        "{sensor} {}: the noise model does not describe the Allan deviations, so the intervals are too small; \
                         check --plot for vibration or a drift of the temperature",
                        axis.name()
                    ));
                }
                noise.push(fitted);
            }
            sensors.push(SensorNoise { sensor, axes: noise });
        }
        let settings = settings::from_noise(&sensors, stage);
        notes.extend(settings.note);
        Ok(NoiseReport {
            kind: "noise",
            confidence: report::CONFIDENCE,
            rate_hz,
            rests: spans,
            sensors,
            notes,
            block: settings.block,
        })
    }

    fn span(&self, rest: &Rest) -> RestSpan {
        let since_s = |index: usize| rows::seconds(&self.rows[0], &self.rows[index]);
        RestSpan { start_s: since_s(rest.first), end_s: since_s(rest.end - 1) }
    }
}

fn rejection(share: f64, summary: String, missing: Vec<String>) -> Rejection {
    Rejection { kind: "noise".into(), coverage: Coverage { share, summary, missing: missing.clone() }, missing }
}

fn needed_rest(rest_s: f64) -> String {
    format!(
        "{rest_s:.1} s of rest, in parts of {MIN_REST_S:.0} s or more; lay the unit on a fixed surface and do not touch it, best for \
         an hour or more"
    )
}

/// Describes the first motions.
fn list_motions(motions: &[Motion]) -> Vec<String> {
    let listed = motions.iter().take(MAX_LISTED).map(|motion| {
        let Motion { start_s, end_s, axis, sign, value, limit } = motion;
        let (unit, factor) = axis.unit();
        let (value, limit) = (report::Rounded(value * factor), report::Rounded(limit * factor));
        let quantity = match sign {
            MotionSign::Spread => "standard deviation",
            MotionSign::Step => "change of the mean",
            MotionSign::Turn => "change since the start of the rest",
            MotionSign::Mean => "mean",
        };
        format!(
            "motion at {start_s:.0} to {end_s:.0} s: {quantity} of {value} {unit} on {} {}, limit {limit} {unit}",
            axis.sensor(),
            axis.name()
        )
    });
    let more = motions
        .len()
        .checked_sub(MAX_LISTED + 1)
        .map(|more| format!("{} at later times", pluralize(more + 1, "motion")));
    listed.chain(more).collect()
}

/// Returns notes on the motions found and on the rests that are used.
fn motion_notes(motions: &[Motion], spans: &[RestSpan]) -> Vec<String> {
    if motions.is_empty() {
        return Vec::new();
    }
    let used: Vec<_> =
        spans.iter().take(MAX_LISTED).map(|span| format!("{:.0} to {:.0} s", span.start_s, span.end_s)).collect();
    let more =
        spans.len().checked_sub(MAX_LISTED + 1).map(|more| format!(" and {} more", more + 1)).unwrap_or_default();
    let mut notes = list_motions(motions);
    notes.push(format!("used only the rests at {}{more}", used.join(", ")));
    notes
}

fn timing_notes(timing: &Timing) -> Vec<String> {
    let Timing { irregular, intervals, gaps, longest_gap_s, .. } = *timing;
    let gaps = (gaps > 0).then(|| {
        format!("{} of up to {longest_gap_s:.2} s; the parts between are evaluated together", pluralize(gaps, "gap"))
    });
    let irregular = (irregular > 0).then(|| {
        format!("{irregular} of {intervals} intervals deviate from the median by over 50 %; the mean interval is used")
    });
    gaps.into_iter().chain(irregular).collect()
}

/// Rests of a recording, with the intervals τ of the fit.
struct Series<'a> {
    rows: &'a [Row],
    rests: &'a [Rest],
    /// Mean interval between the rows recorded at rest, s.
    interval_s: f64,
    rests_s: Vec<f64>,
    /// Intervals τ of the fit, in multiples of `interval_s` and in seconds.
    multiples: Vec<usize>,
    taus_s: Vec<f64>,
    covariances: Covariances,
}

impl<'a> Series<'a> {
    fn new(rows: &'a [Row], rests: &'a [Rest]) -> Self {
        let spans_s = rests.iter().map(|rest| rows::seconds(&rows[rest.first], &rows[rest.end - 1]));
        let intervals: usize = rests.iter().map(|rest| rest.end - rest.first - 1).sum();
        let interval_s = spans_s.sum::<f64>() / intervals.max(1) as f64;
        let rests_s: Vec<_> = rests.iter().map(|rest| (rest.end - rest.first) as f64 * interval_s).collect();
        let multiples = allan::octaves(FIRST_TAU_S, interval_s, &rests_s);
        let taus_s: Vec<_> = multiples.iter().map(|m| *m as f64 * interval_s).collect();
        let covariances = Covariances::new(&taus_s, &rests_s);
        Self { rows, rests, interval_s, rests_s, multiples, taus_s, covariances }
    }

    fn values(&self, rest: &Rest, axis: Axis) -> impl Iterator<Item = f64> + Clone {
        self.rows[rest.first..rest.end].iter().map(move |row| row.values[axis.index()])
    }

    fn is_constant(&self, axis: Axis) -> bool {
        self.rests.iter().all(|rest| {
            let mut values = self.values(rest, axis);
            let first = values.next();
            values.all(|value| Some(value) == first)
        })
    }

    /// Returns the noise of an axis, and the normalised misfit of the model.
    fn fit(&self, axis: Axis, forecast: &mut Forecast) -> Option<(AxisNoise, f64)> {
        let factor = axis.unit().1;
        let integrals: Vec<_> = self
            .rests
            .iter()
            .map(|rest| allan::integral(self.values(rest, axis).map(|value| value * factor), self.interval_s))
            .collect();
        let variance = |m: usize| allan::variance(&integrals, m, self.interval_s);
        let variances: Vec<f64> = self.multiples.iter().map(|m| variance(*m)).collect::<Option<_>>()?;
        let fit = model::fit(&self.taus_s, &variances, &self.covariances)?;
        let [random_walk, bias_instability, bias_walk] = std::array::from_fn(|i| self.estimate(&fit, i, forecast));
        let covariances = self.covariances.matrix(&fit.coefficients);
        let fitted = self.taus_s.iter().zip(&variances).enumerate().map(|(k, (tau_s, variance))| {
            let expected = model::variance(&fit.coefficients, *tau_s);
            let freedom = 2.0 * expected * expected / covariances[k][k];
            let (low, high) = report::interval(*variance, freedom);
            AllanPoint {
                tau_s: *tau_s,
                deviation: variance.sqrt(),
                interval: Some([low, high]),
                model: Some(expected.sqrt()),
            }
        });
        let first = self.multiples.first().copied().unwrap_or(1);
        let short = (0..).map(|octave| 1usize << octave).take_while(|m| *m < first).filter_map(|m| {
            let tau_s = m as f64 * self.interval_s;
            Some(AllanPoint { tau_s, deviation: variance(m)?.sqrt(), interval: None, model: None })
        });
        let curve = short.chain(fitted).collect();
        let misfit = (fit.chi_square - fit.freedom) / (2.0 * fit.freedom.max(1.0)).sqrt();
        Some((AxisNoise { axis: axis.name(), random_walk, bias_instability, bias_walk, curve }, misfit))
    }

    /// Returns the estimate of the coefficient with this index.
    fn estimate(&self, fit: &Fit, index: usize, forecast: &mut Forecast) -> Estimate {
        let (square, sd) = (fit.coefficients[index], fit.sds[index]);
        if square >= MIN_SIGNIFICANCE * sd {
            let (low, high) = report::interval(square, 2.0 * (square / sd).powi(2));
            return Estimate::Determined { value: square.sqrt(), interval: [low, high] };
        }
        // The standard deviation grows with the coefficient, so the standard deviation at the limit
        // is used.
        let mut coefficients = fit.coefficients;
        coefficients[index] = square + UPPER_LIMIT * sd;
        for _ in 0..LIMIT_REPETITIONS {
            if let Some(sds) = model::expected_sds(&self.taus_s, &coefficients, &self.covariances) {
                coefficients[index] = square + UPPER_LIMIT * sds[index];
            }
        }
        Estimate::NotDetermined {
            below: coefficients[index].sqrt(),
            needs_min: forecast.needed_min(&coefficients, index),
        }
    }
}

/// Predicted standard deviations of the coefficients for longer recordings.
struct Forecast {
    /// Total duration of the rests, s.
    total_s: f64,
    interval_s: f64,
    /// Intervals τ in seconds, and covariances, for a total duration 2, 4, 8 … times as long.
    doublings: Vec<(Vec<f64>, Covariances)>,
}

impl Forecast {
    fn new(series: &Series<'_>) -> Self {
        Self { total_s: series.rests_s.iter().sum(), interval_s: series.interval_s, doublings: Vec::new() }
    }

    /// Returns for how many minutes the unit must rest to determine the coefficient at this index.
    ///
    /// Returns `None` if even the longest rest would not be enough.
    fn needed_min(&mut self, coefficients: &Coefficients, index: usize) -> Option<f64> {
        for doubling in 1..=MAX_DOUBLINGS {
            let duration_s = self.total_s * f64::from(1u32 << doubling);
            if self.doublings.len() < doubling as usize {
                let multiples = allan::octaves(FIRST_TAU_S, self.interval_s, &[duration_s]);
                let taus_s: Vec<_> = multiples.iter().map(|m| *m as f64 * self.interval_s).collect();
                let covariances = Covariances::new(&taus_s, &[duration_s]);
                self.doublings.push((taus_s, covariances));
            }
            let (taus_s, covariances) = &self.doublings[doubling as usize - 1];
            let sds = model::expected_sds(taus_s, coefficients, covariances)?;
            if coefficients[index] >= MIN_SIGNIFICANCE * sds[index] {
                return Some((duration_s / 60.0).ceil());
            }
        }
        None
    }
}
