//! The magnetic field in the reference frame of the gyro's heading, as means over a fifth of a second.
//!
//! Samples are gathered over windows of some 20 ms, in which a body turns little: at 10 rad/s the mean of a turning field is short by
//! 0.2 %. The mean of a window was true when the body was where it was a delay and the samples' mean age ago: the attitude is taken back
//! by the rotation of that time. R' being that attitude, the interval's means are those of R'm, of R' and of Ω = R'ω.

use crate::{Complex, Vector3, numbers::Numbers, state::Axes, turn::Turn};

use super::{input::HeadingInput, vibration::Vibration};

/// Length of a window, s; less a little, for sums of intervals that are rounded. So the others.
const WINDOW_S: f64 = 0.0185;
/// Length of an interval, s.
const INTERVAL_S: f64 = 0.1999;
/// Rates and forces beyond these are no motion of a body, rad/s, m/s².
const RATE_MAX_RAD_S: f64 = 100.0;
const FORCE_MAX_M_S2: f64 = 1000.0;
/// Longest time between intervals when no field comes, s.
const SILENCE_S: f64 = 1.0;

/// Means over an interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Interval {
    /// Its length, s.
    pub(super) duration_s: f64,
    /// How much of it, or beside it, nobody saw the body turn, s.
    pub(super) gyro_outage_s: f64,
    /// Windows in it that had a field; with none, the means below are zero.
    pub(super) windows: f64,
    /// R'm, µT, reference axes.
    pub(super) field_ut: [f64; 3],
    /// R', row by row: body axes to reference axes.
    pub(super) axes: [[f64; 3]; 3],
    /// R'ω, rad/s, reference axes.
    pub(super) rate_rad_s: [f64; 3],
    /// Turn about the vertical that each body axis made, rad.
    pub(super) turned_rad: [f64; 3],
    /// Root mean square of the rate, rad/s.
    pub(super) turning_rad_s: f64,
    /// Root mean square of the horizontal acceleration, m/s².
    pub(super) acceleration_m_s2: f64,
    /// The body rested at its end.
    pub(super) at_rest: bool,
    /// The body vibrated.
    pub(super) shaken: bool,
    /// Variance of what is left of the gyro's scale at its end, each axis.
    pub(super) scale_variance: [f64; 3],
}

/// Gathers samples into intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levelled {
    /// Of the window: the samples, their ages, the rotation.
    field_sum_ut: Vector3<f64>,
    age_sum_s: f64,
    samples: f64,
    rotation_rad: Vector3<f64>,
    window_s: f64,
    /// Mean rate of the window before, rad/s.
    rate_before_rad_s: Vector3<f64>,
    vibration: Vibration,
    /// Sums of the interval.
    sums: Interval,
}

impl Default for Levelled {
    fn default() -> Self {
        Self {
            field_sum_ut: Vector3::zeros(),
            age_sum_s: 0.0,
            samples: 0.0,
            rotation_rad: Vector3::zeros(),
            window_s: 0.0,
            rate_before_rad_s: Vector3::zeros(),
            vibration: Vibration::default(),
            sums: Interval::default(),
        }
    }
}

impl Levelled {
    /// No sample is waiting for the end of its interval.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.samples == 0.0 && self.sums.windows == 0.0
    }

    /// One tick; the interval that ends with it, the samples being `delay_s` late. The first of all is a single window: whoever
    /// starts waits for a heading.
    #[inline]
    pub(super) fn step(
        &mut self,
        input: &HeadingInput,
        field_ut: Option<Vector3<f64>>,
        delay_s: f64,
        first: bool,
    ) -> Option<Interval> {
        let dt_s = input.dt_s;
        self.window_s += dt_s;
        self.sums.gyro_outage_s += input.gyro_outage_s;
        self.age_sum_s += self.samples * dt_s;
        let rate_rad_s = input.rate_rad_s.map(|rate| rate.clamp(-RATE_MAX_RAD_S, RATE_MAX_RAD_S));
        self.rotation_rad += rate_rad_s * dt_s;
        self.sums.turning_rad_s += rate_rad_s.norm_squared() * dt_s;
        self.sums.acceleration_m_s2 += input.force_m_s2.norm_sqr().min(FORCE_MAX_M_S2 * FORCE_MAX_M_S2) * dt_s;
        if let Some(norm_m_s2) = input.norm_m_s2 {
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
        let enough = match (self.sums.windows > 0.0, first) {
            (true, true) => 0.0,
            (true, false) => INTERVAL_S,
            (false, _) => SILENCE_S,
        };
        (self.sums.duration_s >= enough).then(|| self.end_interval(input))
    }

    #[inline(never)]
    fn end_window(&mut self, input: &HeadingInput, delay_s: f64) {
        let rate_rad_s = self.rotation_rad / self.window_s;
        if self.samples > 0.0 {
            let age_s = delay_s + self.age_sum_s / self.samples;
            let earlier_s = age_s - self.window_s;
            let back_rad = if earlier_s > 0.0 {
                self.rotation_rad + self.rate_before_rad_s * earlier_s
            } else {
                rate_rad_s * age_s
            };
            self.gather(input, back_rad, self.field_sum_ut / self.samples, rate_rad_s);
        }
        self.sums.duration_s += self.window_s;
        let turned_rad = input.attitude.up.direction().component_mul(&self.rotation_rad);
        self.sums.turned_rad.iter_mut().zip(turned_rad.iter()).for_each(|(sum, part)| *sum += part);
        self.rate_before_rad_s = rate_rad_s;
        self.rotation_rad = Vector3::zeros();
        self.window_s = 0.0;
        self.field_sum_ut = Vector3::zeros();
        self.age_sum_s = 0.0;
        self.samples = 0.0;
    }

    fn gather(&mut self, input: &HeadingInput, back_rad: Vector3<f64>, field: Vector3<f64>, rate: Vector3<f64>) {
        let (mut attitude, mut azimuth) = (input.attitude, input.azimuth);
        let back = Turn::of_rotation_vector(-back_rad);
        let Axes { horizontal, up } = attitude.turn_and_lean(back, Complex::new(0.0, 0.0), &mut azimuth);
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

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let Self { age_sum_s, samples, window_s, sums, .. } = self;
        let sums = [sums.duration_s, sums.gyro_outage_s, sums.windows, sums.turning_rad_s, sums.acceleration_m_s2];
        let negative = [*age_sum_s, *samples, *window_s].iter().chain(&sums).any(|sum| *sum < 0.0);
        negative.then_some("sums of the levelled field that nothing adds up to").or_else(|| self.vibration.flaw())
    }

    fn end_interval(&mut self, input: &HeadingInput) -> Interval {
        let mut means = core::mem::take(&mut self.sums);
        means.turning_rad_s = libm::sqrt(means.turning_rad_s / means.duration_s);
        means.acceleration_m_s2 = libm::sqrt(means.acceleration_m_s2 / means.duration_s);
        (means.at_rest, means.shaken) = (input.at_rest, self.vibration.take());
        means.scale_variance = input.scale_variance;
        if means.windows > 0.0 {
            let share = means.windows.recip();
            let Interval { field_ut, axes, rate_rad_s, .. } = &mut means;
            field_ut.iter_mut().chain(axes.as_flattened_mut()).chain(rate_rad_s).for_each(|sum| *sum *= share);
        }
        means
    }
}

impl Numbers for Levelled {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.field_sum_ut.visit(visit);
        self.age_sum_s.visit(visit);
        self.samples.visit(visit);
        self.rotation_rad.visit(visit);
        self.window_s.visit(visit);
        self.rate_before_rad_s.visit(visit);
        self.vibration.visit(visit);
        let Interval {
            duration_s,
            gyro_outage_s,
            windows,
            turned_rad,
            field_ut,
            axes,
            rate_rad_s,
            turning_rad_s,
            acceleration_m_s2,
            at_rest: _,
            shaken: _,
            scale_variance: _,
        } = &mut self.sums;
        let vectors = field_ut.iter_mut().chain(axes.as_flattened_mut()).chain(rate_rad_s).chain(turned_rad);
        vectors.for_each(&mut *visit);
        [duration_s, gyro_outage_s, windows, turning_rad_s, acceleration_m_s2].into_iter().for_each(&mut *visit);
    }
}
