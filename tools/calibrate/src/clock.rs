//! How late the magnetometer is on the gyro: a field that stands still turns in the sensor's axes as the gyro says, so long ago.
//!
//! dm/dt = −ω × m, with m read at t what it was at t − τ. Over a quarter of a second this is m(t₂) − b = A(τ) (m(t₁) − b), A(τ) the turn
//! that the gyro measured from t₁ − τ to t₂ − τ, and b the hard iron that is left. Least squares in τ, b and the gyro's bias with Huber's
//! weights. A body that turns steadily tells nothing of τ: only a change of the rate does.

use attitude::{Vector3, calibration::Calibration};
use nalgebra::{SVector, UnitQuaternion};

use crate::{
    Kind, Known, Sample,
    history::History,
    least_squares::Normal,
    report::{Coverage, Refusal, Report, Residual, Value},
};

/// Length of a window, ns.
const WINDOW_NS: i64 = 250_000_000;
/// Windows begin at least so far apart, ns, and there are at most so many.
const STRIDE_NS: i64 = 25_000_000;
const MAX_FIELDS: usize = 80_000;
/// A window tells something where the rate changed by more than this, rad/s.
const CHANGE_RAD_S: f64 = 0.5;
/// Windows' length in all that must tell something, s.
const TURNING_S: f64 = 5.0;
/// Errors hang together for so long, ns.
const BLOCK_NS: i64 = 2_000_000_000;
/// Where Huber's weights begin, in standard deviations.
const HUBER: f64 = 2.0;
/// Steps after which a fit has found what it finds.
const MAX_STEPS: usize = 20;
/// By how much τ is moved for a derivative, s.
const DIFFERENCE_S: f64 = 5e-4;
/// The largest delay that is looked for, s.
const MAX_DELAY_S: f64 = 0.2;
/// The most that it may be uncertain, s.
const MAX_SD_S: f64 = 0.002;
/// What the gyro leaves of the field's changes, at most.
const MAX_LEFT: f64 = 0.5;
/// What the fuser takes, s: `magnetometer_delay_s`; and how certain it may be told that the delay is.
const TAKEN_S: std::ops::RangeInclusive<f64> = -0.01..=0.04;
const TOLD_SD_S: (f64, f64) = (0.0005, 0.02);

/// Takes readings.
#[derive(Debug, Clone)]
pub struct Clock {
    gyro: Calibration,
    mag: Calibration,
    history: History,
    fields: Vec<Field>,
    /// Of the window that counts next: its beginning, and the rate then.
    window: Option<(i64, Vector3<f64>)>,
    telling_s: f64,
}

/// When the field was what, ns and µT.
type Field = (i64, Vector3<f64>);

/// Delay s, hard iron µT, gyro bias rad/s.
type Parameters = SVector<f64, 7>;

impl Clock {
    pub(crate) fn new(known: &Known) -> Self {
        Self {
            gyro: known.gyro,
            mag: known.mag,
            history: History::new(known.rate_kind),
            fields: Vec::new(),
            window: None,
            telling_s: 0.0,
        }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        let rate_rad_s = self.gyro.apply(sample.rate_rad_s);
        self.history.take(sample.t_ns, rate_rad_s);
        let Some(field_ut) = sample.field_ut.map(|field_ut| self.mag.apply(field_ut)) else { return };
        let is_new = self
            .fields
            .last()
            .is_none_or(|(last_ns, last_ut)| *last_ut != field_ut && sample.t_ns - last_ns >= STRIDE_NS);
        if !is_new || self.fields.len() >= MAX_FIELDS || self.history.is_full() {
            return;
        }
        self.fields.push((sample.t_ns, field_ut));
        match self.window {
            Some((begun_ns, before_rad_s)) if sample.t_ns - begun_ns >= WINDOW_NS => {
                // About the field itself a turn is not seen.
                let change = (rate_rad_s - before_rad_s).cross(&field_ut.normalize()).norm();
                let is_whole = sample.t_ns - begun_ns <= 2 * WINDOW_NS;
                if is_whole && change > CHANGE_RAD_S {
                    self.telling_s += WINDOW_NS as f64 * 1e-9;
                }
                self.window = Some((sample.t_ns, rate_rad_s));
            }
            None => self.window = self.history.rate_rad_s().map(|rate_rad_s| (sample.t_ns, rate_rad_s)),
            Some(_) => {}
        }
    }

    pub(crate) fn coverage(&self) -> Coverage {
        let share = (self.telling_s / TURNING_S).min(1.0);
        let missing = if self.fields.is_empty() {
            Some("a magnetic field: there is no sample of one".into())
        } else {
            (share < 1.0).then(|| {
                format!(
                    "{:.1} s in which the rate changes; turn the unit to and fro about all axes, once or twice a second and faster than 30 °/s",
                    (TURNING_S - self.telling_s).max(0.1)
                )
            })
        };
        Coverage {
            share,
            found: format!("{} samples of the field, {:.1} s of turns to and fro", self.fields.len(), self.telling_s),
            missing: missing.into_iter().collect(),
        }
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let coverage = self.coverage();
        if coverage.share < 1.0 {
            return Err(Refusal::thin(Kind::Clock, coverage));
        }
        let weak = |missing: &str| Refusal::weak(Kind::Clock, coverage.clone(), missing.into());
        let unclear = "turns by which the delay is seen: field and gyro do not follow each other; turn the unit to and fro far from iron, and \
                       check that both have the same axes";
        let (at, sd_s) = self.fit().ok_or_else(|| weak(unclear))?;
        let delay_s = at[0];
        let rms_ut = |delay_s: f64| {
            let mut at = at;
            at[0] = delay_s;
            self.sums(&at, 1e9).map_or(f64::NAN, |(normal, _)| normal.rms())
        };
        let (before_ut, after_ut) = (rms_ut(0.0), rms_ut(delay_s));
        let is_followed = after_ut < MAX_LEFT * self.change_ut();
        if !is_followed || sd_s > MAX_SD_S || delay_s.abs() > MAX_DELAY_S {
            return Err(weak(unclear));
        }
        if !TAKEN_S.contains(&delay_s) {
            let delay_ms = 1e3 * delay_s;
            let missing = format!(
                "a driver that stamps alike: the magnetometer is {delay_ms:.1} ms late, and the fuser makes up for −10 to 40 ms; correct the stamps"
            );
            return Err(weak(&missing));
        }
        let (least, most) = TOLD_SD_S;
        Ok(Report {
            kind: "clock",
            values: vec![Value { name: "delay", value: vec![1e3 * delay_s], sd: vec![1e3 * sd_s], unit: "ms" }],
            residual: Residual {
                of: "field less what the gyro made of it a quarter of a second before, root mean square of an axis",
                before: before_ut,
                after: after_ut,
                unit: "µT",
            },
            coverage,
            notes: vec!["positive: the magnetometer is later than the gyro".into()],
            replaces: "[fuser]; its other settings stay in `set`",
            block: format!(
                "[fuser]\nstage = \"multiple-model\"\nset = {{ magnetometer_delay_s = {:.4}, magnetometer_delay_sd_s = {:.4} }}\n",
                delay_s + 0.0,
                sd_s.clamp(least, most)
            ),
        })
    }

    /// Root mean square of what the field changes by in a window, on an axis.
    fn change_ut(&self) -> f64 {
        let mut sum = 0.0;
        let pairs = self.windows().inspect(|((_, first_ut), (_, last_ut))| sum += (last_ut - first_ut).norm_squared());
        let count = pairs.count();
        (sum / (3 * count.max(1)) as f64).sqrt()
    }

    /// The field at the beginning and at the end of each window.
    fn windows(&self) -> impl Iterator<Item = (&Field, &Field)> {
        let mut last = 0;
        self.fields.iter().map_while(move |first| {
            while self.fields.get(last)?.0 - first.0 < WINDOW_NS {
                last += 1;
            }
            Some((first, &self.fields[last]))
        })
    }

    /// What fits best, and the delay's standard deviation.
    fn fit(&self) -> Option<(Parameters, f64)> {
        let mut at = Parameters::zeros();
        let mut sd_ut = 1e9;
        for _ in 0..MAX_STEPS {
            let (mut normal, found_sd_ut) = self.sums(&at, sd_ut)?;
            sd_ut = found_sd_ut;
            let step = normal.step()?;
            at += step;
            // Farther away than that nothing is found again.
            at[0] = at[0].clamp(-2.0 * MAX_DELAY_S, 2.0 * MAX_DELAY_S);
            if step[0].abs() < 1e-7 {
                break;
            }
        }
        let covariance = self.sums(&at, sd_ut)?.0.block_covariance()?;
        Some((at, covariance[(0, 0)].max(0.0).sqrt()))
    }

    /// The sums over all windows at these parameters, and the usual size of a residual.
    fn sums(&self, at: &Parameters, sd_ut: f64) -> Option<(Normal<7>, f64)> {
        let (delay_s, hard_ut) = (at[0], Vector3::new(at[1], at[2], at[3]));
        let bias_rad_s = Vector3::new(at[4], at[5], at[6]);
        let mut normal = Normal::<7>::new();
        let mut sizes = Vec::new();
        let mut block_ns = i64::MIN;
        for ((first_ns, first_ut), (last_ns, last_ut)) in self.windows() {
            let length_s = (last_ns - first_ns) as f64 * 1e-9;
            let turn = |delay_s: f64| self.turn(*first_ns, *last_ns, delay_s);
            let (Some(here), Some(after)) = (turn(delay_s), turn(delay_s + DIFFERENCE_S)) else { continue };
            if *first_ns >= block_ns {
                normal.end_block();
                block_ns = first_ns + BLOCK_NS;
            }
            let unbiased = UnitQuaternion::from_scaled_axis(bias_rad_s * length_s);
            let arm = first_ut - hard_ut;
            let seen = unbiased * (here * arm);
            let residual = last_ut - hard_ut - seen;
            let by_delay = (seen - unbiased * (after * arm)) / DIFFERENCE_S;
            let turned = (unbiased * here).to_rotation_matrix();
            let by_bias = seen.cross_matrix() * length_s;
            let trust = (HUBER * sd_ut / residual.norm().max(f64::MIN_POSITIVE)).min(1.0);
            for axis in 0..3 {
                let by_hard = |part: usize| turned[(axis, part)] - f64::from(u8::from(axis == part));
                let jacobian = [
                    by_delay[axis],
                    by_hard(0),
                    by_hard(1),
                    by_hard(2),
                    by_bias[(axis, 0)],
                    by_bias[(axis, 1)],
                    by_bias[(axis, 2)],
                ];
                normal.add(residual[axis], &jacobian.into(), trust);
            }
            sizes.push(residual.norm());
        }
        normal.end_block();
        let middle = sizes.len() / 2;
        // Of three normal errors half have a norm below 1.538 standard deviations; Huber's weights are of the norm.
        let sd_ut =
            (sizes.len() > 1).then(|| *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.538 * 1.732)?;
        Some((normal, sd_ut.max(1e-9)))
    }

    /// The turn of what stands still in the sensor's axes, as the gyro measured it so long before.
    fn turn(&self, first_ns: i64, last_ns: i64, delay_s: f64) -> Option<UnitQuaternion<f64>> {
        let delay_ns = (delay_s * 1e9).round() as i64;
        let ((from, piece), (to, same)) =
            (self.history.attitude(first_ns - delay_ns)?, self.history.attitude(last_ns - delay_ns)?);
        (piece == same).then(|| to.inverse() * from)
    }
}
