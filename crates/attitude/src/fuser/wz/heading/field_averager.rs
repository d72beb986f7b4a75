//! Averages the magnetic field over 0.2 s in the reference frame of the gyro heading.
//!
//! Samples of the magnetic field m are collected over windows of about 20 ms, in which a body
//! rotates little: at 10 rad/s the mean of a rotating field is 0.2 % too short. The mean of a
//! window refers to a time that precedes the end of the window by the magnetometer delay plus the
//! mean age of the samples. The attitude is rotated back to that time, which gives R' (body axes to
//! reference axes). Each interval yields the means of R'm, of R' and of Ω = R'ω, where ω is the
//! rate.

use crate::{Complex, Vector3, rotation::Rotation, scalars::scalars, state::BodyAxes};

use super::{input::HeadingInput, vibration::VibrationDetector};

/// Minimum duration of a window, s. It is less than the nominal 20 ms, so that rounding in the sum
/// of tick intervals does not prolong the window.
const WINDOW_S: f64 = 0.0185;
/// Minimum duration of an interval, s. It is less than the nominal 0.2 s, so that rounding in the
/// sum of tick intervals does not prolong the interval.
const INTERVAL_S: f64 = 0.1999;
/// Limit to which each component of the rate is clamped, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;
/// Limit to which the horizontal force is clamped, m/s².
const MAX_FORCE_M_S2: f64 = 1000.0;
/// Duration after which an interval ends even if it contains no magnetic field sample, s.
const MAX_FIELD_GAP_S: f64 = 1.0;

/// Means over an interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct IntervalMeans {
    pub(super) duration_s: f64,
    /// Time without an observed rotation, s. It may exceed `duration_s`, because a tick without a
    /// motion has a zero interval.
    pub(super) gyro_outage_s: f64,
    /// Number of windows with a magnetic field sample. If it is zero, the means below are zero.
    pub(super) windows: f64,
    /// Mean of R'm, the magnetic field in reference axes, µT.
    pub(super) field_ut: [f64; 3],
    /// Mean of R', the rotation matrix from body axes to reference axes, row by row.
    pub(super) axes: [[f64; 3]; 3],
    /// Mean of R'ω, the rate in reference axes, rad/s.
    pub(super) rate_rad_s: [f64; 3],
    /// Rotation about the vertical contributed by each body axis, rad.
    pub(super) vertical_rotation_rad: [f64; 3],
    /// Root mean square of the rate, rad/s.
    pub(super) rate_rms_rad_s: f64,
    /// Root mean square of the horizontal acceleration, m/s².
    pub(super) acceleration_rms_m_s2: f64,
    /// Set if the body was at rest at the end of the interval.
    pub(super) at_rest: bool,
    /// Set if the body vibrated during the interval.
    pub(super) is_vibrating: bool,
    /// Variance of the remaining gyro scale error of each axis at the end of the interval.
    pub(super) scale_variance: [f64; 3],
    /// Variance of the gyro bias about the vertical at the end of the interval, rad²/s².
    pub(super) vertical_bias_variance: f64,
}

/// Accumulator of samples for the means of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FieldAverager {
    /// Sum of the magnetic field samples in the current window, µT.
    field_sum_ut: Vector3<f64>,
    /// Sum of the ages of the magnetic field samples in the current window, s.
    age_sum_s: f64,
    /// Number of magnetic field samples in the current window.
    samples: f64,
    /// Rotation in the current window, rad.
    rotation_rad: Vector3<f64>,
    /// Duration of the current window so far, s.
    window_s: f64,
    /// Mean rate over the previous window, rad/s.
    last_rate_rad_s: Vector3<f64>,
    vibration: VibrationDetector,
    /// Sums over the current interval.
    sums: IntervalMeans,
}

impl Default for FieldAverager {
    fn default() -> Self {
        Self {
            field_sum_ut: Vector3::zeros(),
            age_sum_s: 0.0,
            samples: 0.0,
            rotation_rad: Vector3::zeros(),
            window_s: 0.0,
            last_rate_rad_s: Vector3::zeros(),
            vibration: VibrationDetector::default(),
            sums: IntervalMeans::default(),
        }
    }
}

impl FieldAverager {
    /// Returns `true` if there is no sample in the current interval.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.samples == 0.0 && self.sums.windows == 0.0
    }

    /// Processes one tick and returns the means if an interval ends with it.
    ///
    /// `delay_s` is the delay of the magnetometer. The first interval is a single window, so that a
    /// heading is available early.
    #[inline]
    pub(super) fn step(
        &mut self,
        input: &HeadingInput,
        field_ut: Option<Vector3<f64>>,
        delay_s: f64,
        is_first: bool,
    ) -> Option<IntervalMeans> {
        let dt_s = input.dt_s;
        self.window_s += dt_s;
        self.sums.gyro_outage_s += input.gyro_outage_s;
        self.age_sum_s += self.samples * dt_s;
        let rate_rad_s = input.rate_rad_s.map(|rate| rate.clamp(-MAX_RATE_RAD_S, MAX_RATE_RAD_S));
        self.rotation_rad += rate_rad_s * dt_s;
        self.sums.rate_rms_rad_s += rate_rad_s.norm_squared() * dt_s;
        self.sums.acceleration_rms_m_s2 +=
            input.horizontal_force_m_s2.norm_sqr().min(MAX_FORCE_M_S2 * MAX_FORCE_M_S2) * dt_s;
        if let Some(norm_m_s2) = input.force_norm_m_s2 {
            self.vibration.observe(norm_m_s2);
        }
        if let Some(field_ut) = field_ut {
            self.field_sum_ut += field_ut;
            self.samples += 1.0;
        }
        if self.window_s < WINDOW_S {
            return None;
        }
        self.end_window(input, delay_s);
        let min_duration_s = match (self.sums.windows > 0.0, is_first) {
            (true, true) => 0.0,
            (true, false) => INTERVAL_S,
            (false, _) => MAX_FIELD_GAP_S,
        };
        (self.sums.duration_s >= min_duration_s).then(|| self.end_interval(input))
    }

    #[inline(never)]
    fn end_window(&mut self, input: &HeadingInput, delay_s: f64) {
        let rate_rad_s = self.rotation_rad / self.window_s;
        if self.samples > 0.0 {
            let age_s = delay_s + self.age_sum_s / self.samples;
            let before_window_s = age_s - self.window_s;
            let rewind_rad = if before_window_s > 0.0 {
                self.rotation_rad + self.last_rate_rad_s * before_window_s
            } else {
                rate_rad_s * age_s
            };
            self.accumulate(input, rewind_rad, self.field_sum_ut / self.samples, rate_rad_s);
        }
        self.sums.duration_s += self.window_s;
        let vertical_rotation_rad = input.attitude.up.direction().component_mul(&self.rotation_rad);
        self.sums
            .vertical_rotation_rad
            .iter_mut()
            .zip(vertical_rotation_rad.iter())
            .for_each(|(sum, part)| *sum += part);
        self.last_rate_rad_s = rate_rad_s;
        self.rotation_rad = Vector3::zeros();
        self.window_s = 0.0;
        self.field_sum_ut = Vector3::zeros();
        self.age_sum_s = 0.0;
        self.samples = 0.0;
    }

    fn accumulate(&mut self, input: &HeadingInput, rewind_rad: Vector3<f64>, field: Vector3<f64>, rate: Vector3<f64>) {
        let (mut attitude, mut azimuth) = (input.attitude, input.azimuth);
        let rewind = Rotation::from_rotation_vector(-rewind_rad);
        let BodyAxes { horizontal, up } = attitude.rotate_and_tilt(rewind, Complex::new(0.0, 0.0), &mut azimuth);
        let rows = [
            [horizontal[0].re, horizontal[1].re, horizontal[2].re],
            [horizontal[0].im, horizontal[1].im, horizontal[2].im],
            [up.x, up.y, up.z],
        ];
        for (i, row) in rows.iter().enumerate() {
            self.sums.field_ut[i] += row[0] * field.x + row[1] * field.y + row[2] * field.z;
            self.sums.rate_rad_s[i] += row[0] * rate.x + row[1] * rate.y + row[2] * rate.z;
            for (sum, part) in self.sums.axes[i].iter_mut().zip(row) {
                *sum += part;
            }
        }
        self.sums.windows += 1.0;
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { age_sum_s, samples, window_s, sums, .. } = self;
        let sums = [sums.duration_s, sums.gyro_outage_s, sums.windows, sums.rate_rms_rad_s, sums.acceleration_rms_m_s2];
        let negative = [*age_sum_s, *samples, *window_s].iter().chain(&sums).any(|sum| *sum < 0.0);
        negative.then_some("a sum of the field averager below zero").or_else(|| self.vibration.validation_error())
    }

    fn end_interval(&mut self, input: &HeadingInput) -> IntervalMeans {
        let mut means = core::mem::take(&mut self.sums);
        means.rate_rms_rad_s = libm::sqrt(means.rate_rms_rad_s / means.duration_s);
        means.acceleration_rms_m_s2 = libm::sqrt(means.acceleration_rms_m_s2 / means.duration_s);
        (means.at_rest, means.is_vibrating) = (input.at_rest, self.vibration.end_interval());
        means.scale_variance = input.scale_variance;
        means.vertical_bias_variance = input.vertical_bias_variance;
        if means.windows > 0.0 {
            let weight = means.windows.recip();
            let IntervalMeans { field_ut, axes, rate_rad_s, .. } = &mut means;
            field_ut.iter_mut().chain(axes.as_flattened_mut()).chain(rate_rad_s).for_each(|sum| *sum *= weight);
        }
        means
    }
}

scalars!(IntervalMeans:
    field_ut, axes, rate_rad_s, vertical_rotation_rad, duration_s, gyro_outage_s, windows, rate_rms_rad_s,
    acceleration_rms_m_s2;
    without at_rest, is_vibrating, scale_variance, vertical_bias_variance
);
scalars!(FieldAverager:
    field_sum_ut, age_sum_s, samples, rotation_rad, window_s, last_rate_rad_s, vibration, sums
);
