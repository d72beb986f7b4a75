//! Check of the gyro's axes and unit against the rotation of gravity.
//!
//! When the force is rotated back by the integrated rate, its mean keeps its direction, because
//! only gravity has a non-zero mean. The spread of the rotated force about that mean is computed
//! over windows in which the force rotates in body axes. The spread obtained with the unchanged
//! rate is compared with the spreads obtained under all other hypotheses. These combine every
//! signed permutation of the axes with a unit of the rate: correct, in °/s but read as rad/s, or
//! converted to radians twice.

use attitude::{Matrix3, Vector3};

use crate::diagnosis::{self, Diagnosis, Hypothesis};

/// Length of an integration step, s. Over a window of two seconds, 250 Hz is as accurate as 8 kHz,
/// at a thirtieth of the cost.
const STEP_S: f64 = 0.004;
/// Longest sample interval that is integrated, s. It admits 10 Hz, the lowest rate at which an
/// attitude can still be tracked.
pub(crate) const MAX_SAMPLE_INTERVAL_S: f64 = 0.12;
/// Length of a window, s. Accelerations of a hand or a vehicle reverse within this time.
const WINDOW_S: f64 = 2.0;
/// Minimum spread of the force in body axes for a window to count. It corresponds to a rotation by
/// about 20°, which exceeds the effect of vibration on a body at rest.
const MIN_SPREAD: f64 = 0.04;
/// Minimum number of windows for a diagnosis. A shock affects one window, or two if it falls on
/// their boundary.
const MIN_WINDOWS: u32 = 3;
/// Largest residual of the best hypothesis, as a share of the spread in body axes. A larger
/// residual means that the spread was caused by accelerations, not by rotation. For n windows the
/// limit is multiplied by 1 − 1/n, as if one of the windows carried no information.
const MAX_RESIDUAL: f64 = 0.5;
/// Minimum ratio of the unchanged rate's residual to the smallest residual for a diagnosis. It is
/// above 1, because the best of 144 hypotheses always fits slightly better than the true one.
const MIN_RESIDUAL_RATIO: f64 = 1.5;
/// Minimum amount by which the residual of the unchanged rate must exceed [`MIN_RESIDUAL_RATIO`]
/// times the smallest residual. If all residuals are near zero, this limit prevents a diagnosis,
/// because the unchanged rate is then correct.
const MIN_RESIDUAL_DIFFERENCE: f64 = 0.08;
/// Factor in the limit `TIE_RATIO` · smallest residual + `TIE_DIFFERENCE`. Hypotheses with a
/// residual below this limit count as equally good. Several remain if the body rotates about few
/// axes.
const TIE_RATIO: f64 = 1.15;
/// Offset in the limit given at [`TIE_RATIO`].
const TIE_DIFFERENCE: f64 = 0.01;
/// Factors that correct the rates under each unit hypothesis: correct unit, °/s read as rad/s, and
/// rad/s read as °/s.
const SCALES: [f64; 3] = [1.0, std::f64::consts::PI / 180.0, 180.0 / std::f64::consts::PI];

/// Hypotheses with the same unit and the same handedness.
///
/// A rotation by the vector `t` has the matrix `R(t)`. In axes `A` with determinant ±1 it becomes
/// `A R(±t) Aᵀ`. All hypotheses of a group therefore share the product of the matrices `R(±t)` over
/// the window.
#[derive(Debug, Clone)]
struct HypothesisGroup {
    scale: f64,
    sign: f64,
    /// Rotation from the current body axes to those at the start of the window.
    to_start: Matrix3<f64>,
    /// For each component of the force, the sum of `to_start` times that component.
    moments: [Matrix3<f64>; 3],
    sums: Vec<SpreadSum>,
}

/// Accumulated spread of the force under one hypothesis.
#[derive(Debug, Clone)]
struct SpreadSum {
    axes: Matrix3<f64>,
    spread: f64,
}

/// Comparison of all hypotheses over the same windows.
#[derive(Debug, Clone)]
pub(crate) struct GyroAxesCheck {
    groups: Vec<HypothesisGroup>,
    step: Step,
    window_s: f64,
    count: f64,
    force: Vector3<f64>,
    squares: f64,
    windows: u32,
    /// Sum of the spreads in body axes.
    spread: f64,
}

/// Sums over the current step.
#[derive(Debug, Clone, Copy, Default)]
struct Step {
    dt_s: f64,
    count: f64,
    rotation_rad: Vector3<f64>,
    force: Vector3<f64>,
}

impl Default for GyroAxesCheck {
    fn default() -> Self {
        let groups = SCALES.iter().flat_map(|scale| [1.0, -1.0].map(|sign| HypothesisGroup::new(*scale, sign)));
        Self {
            groups: groups.collect(),
            step: Step::default(),
            window_s: 0.0,
            count: 0.0,
            force: Vector3::zeros(),
            squares: 0.0,
            windows: 0,
            spread: 0.0,
        }
    }
}

impl GyroAxesCheck {
    /// Returns the total duration of the windows that count, s.
    pub(crate) fn motion_s(&self) -> f64 {
        f64::from(self.windows) * WINDOW_S
    }

    /// Returns `true` if the force has rotated often enough for a diagnosis.
    pub(crate) fn has_enough_windows(&self) -> bool {
        self.windows >= MIN_WINDOWS
    }

    /// Discards the current window after a discontinuity.
    pub(crate) fn interrupt(&mut self) {
        self.step = Step::default();
        self.start_window();
    }

    fn start_window(&mut self) {
        (self.window_s, self.count, self.squares, self.force) = (0.0, 0.0, 0.0, Vector3::zeros());
        self.groups.iter_mut().for_each(HypothesisGroup::start_window);
    }

    pub(crate) fn push(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) {
        if !(0.0..MAX_SAMPLE_INTERVAL_S).contains(&dt_s) {
            return self.interrupt();
        }
        let step = &mut self.step;
        step.dt_s += dt_s;
        step.count += 1.0;
        step.rotation_rad += Vector3::from(rate_rad_s) * dt_s;
        step.force += Vector3::from(force_m_s2);
        if step.dt_s < STEP_S {
            return;
        }
        let Step { dt_s, count, rotation_rad, force } = std::mem::take(step);
        let force = force / count;
        self.window_s += dt_s;
        self.count += 1.0;
        self.force += force;
        self.squares += force.norm_squared();
        self.groups.iter_mut().for_each(|group| group.push(rotation_rad, force));
        if self.window_s >= WINDOW_S {
            self.end_window();
        }
    }

    fn end_window(&mut self) {
        let whole = self.count * self.squares;
        let spread = |sum: &Vector3<f64>| 1.0 - sum.norm_squared() / whole;
        let body_spread = spread(&self.force);
        if body_spread > MIN_SPREAD && body_spread.is_finite() {
            self.windows += 1;
            self.spread += body_spread;
            self.groups.iter_mut().for_each(|group| group.end_window(spread));
        }
        self.start_window();
    }

    pub(crate) fn diagnose(&self) -> Option<Diagnosis> {
        if !self.has_enough_windows() {
            return None;
        }
        let mut all: Vec<_> = self.groups.iter().flat_map(|group| group.hypotheses(self.spread)).collect();
        all.sort_by(|one, other| one.residual.total_cmp(&other.residual));
        let is_unchanged = |hypothesis: &&Hypothesis| hypothesis.scale == 1.0 && hypothesis.axes == Matrix3::identity();
        let (best, unchanged) = (all.first()?.residual, all.iter().find(is_unchanged)?.residual);
        let max_residual = MAX_RESIDUAL * (1.0 - f64::from(self.windows).recip());
        if !(best < max_residual && unchanged > MIN_RESIDUAL_RATIO * best + MIN_RESIDUAL_DIFFERENCE) {
            return None;
        }
        // Equally good hypotheses are sorted: those that change the axes and unit least come first.
        all.retain(|hypothesis| hypothesis.residual < TIE_RATIO * best + TIE_DIFFERENCE);
        all.sort_by(|one, other| {
            simplicity(other).total_cmp(&simplicity(one)).then(one.residual.total_cmp(&other.residual))
        });
        Some(diagnosis::gyro_mismatch(unchanged, self.motion_s(), &all))
    }
}

impl HypothesisGroup {
    fn new(scale: f64, sign: f64) -> Self {
        let axes_of_group = signed_permutations().filter(|axes| axes.determinant() * sign > 0.0);
        let sums = axes_of_group.map(|axes| SpreadSum { axes, spread: 0.0 }).collect();
        Self { scale, sign, to_start: Matrix3::identity(), moments: [Matrix3::zeros(); 3], sums }
    }

    fn start_window(&mut self) {
        (self.to_start, self.moments) = (Matrix3::identity(), [Matrix3::zeros(); 3]);
    }

    fn push(&mut self, rotation_rad: Vector3<f64>, force: Vector3<f64>) {
        self.to_start *= rotation(rotation_rad * self.sign * self.scale);
        self.moments.iter_mut().zip(force.iter()).for_each(|(moment, force)| *moment += self.to_start * *force);
    }

    /// Adds the spread in the finished window to the accumulated spread of each hypothesis. The
    /// function `spread` computes the spread in the window from the sum of its rotated forces.
    fn end_window(&mut self, spread: impl Fn(&Vector3<f64>) -> f64) {
        let Self { moments, sums, .. } = self;
        for sum in sums {
            // The sum of the terms is Aᵀ times the sum of the rotated forces under this hypothesis,
            // where A is `sum.axes`. Aᵀ does not change the length of a vector, and the spread
            // depends only on the length.
            let terms = moments.iter().zip(sum.axes.row_iter());
            let force = terms.map(|(moment, row)| moment * row.transpose()).sum();
            sum.spread += spread(&force);
        }
    }

    /// Returns the hypotheses. `spread` is the accumulated spread in body axes.
    fn hypotheses(&self, spread: f64) -> impl Iterator<Item = Hypothesis> {
        self.sums.iter().map(move |sum| Hypothesis { axes: sum.axes, scale: self.scale, residual: sum.spread / spread })
    }
}

/// Returns the simplicity of a hypothesis. Every change of the axes or of the unit lowers the
/// simplicity.
///
/// Negating all axes counts as a smaller change than negating one.
fn simplicity(Hypothesis { axes, scale, .. }: &Hypothesis) -> f64 {
    let negated = if axes == &-Matrix3::identity() { 5.0 } else { 0.0 };
    axes.trace() + negated - f64::from(u8::from(*scale != 1.0))
}

/// Returns the rotation matrix of a rotation vector of any finite length.
fn rotation(rotation_rad: Vector3<f64>) -> Matrix3<f64> {
    let angle = rotation_rad.norm();
    let Some(axis) = rotation_rad.try_normalize(1e-12) else { return Matrix3::identity() };
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity() * cos + axis.cross_matrix() * sin + axis * axis.transpose() * (1.0 - cos)
}

fn signed_permutations() -> impl Iterator<Item = Matrix3<f64>> {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    ORDERS.into_iter().flat_map(|order| {
        (0..8).map(move |signs| {
            Matrix3::from_fn(|row, column| match order[row] == column {
                true if signs >> row & 1 == 1 => -1.0,
                true => 1.0,
                false => 0.0,
            })
        })
    })
}
