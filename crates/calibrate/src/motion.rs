//! Gravity measured in motion: the mean of the specific forces over two seconds in one frame. The
//! gyro gives the rotation of each force into this frame.
//!
//! A unit that is turned by hand hardly changes its position. Over two seconds, the accelerations
//! caused by the hand nearly cancel in a common frame, and gravity remains. The forces are weighted
//! by a raised cosine (Hann), so that the velocities at both ends of the window have no effect.
//!
//! Let f be a specific force in the window, and R the rotation from its axes to those of the first
//! reading in the window. The corrected force is M (f − b), with the correction matrix M and the
//! bias b; see `accel`. The mean of R M (f − b) is linear in M and M b, so only the means of R and
//! of R times each component of f are stored.

use attitude::{GRAVITY_M_S2, Matrix3, Vector3, calibration::Calibration};
use nalgebra::UnitQuaternion;

use crate::{input::Sample, sphere::face};

/// Length of a window, ns.
const WINDOW_NS: i64 = 2_000_000_000;
/// Longest interval between readings in a window, ns.
const MAX_GAP_NS: i64 = 100_000_000;
/// Minimum number of readings in a window.
const MIN_READINGS: usize = 20;
/// Maximum rate in a usable window, rad/s. At higher rates, the distance and the delay between gyro
/// and accelerometer are no longer negligible.
const MAX_RATE_RAD_S: f64 = 6.0;
/// Minimum duration for which a side must point up to be counted, ns.
const MIN_SIDE_UP_NS: f64 = 250e6;
/// Maximum number of windows kept: three hours. Later readings are ignored.
const MAX_WINDOWS: usize = 5_000;

/// Mean of the forces in a window, in the sensor axes at the start of the window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MeanForce {
    /// Means of R f_x, R f_y and R f_z, with the rotation R and the components of the force f. For
    /// a matrix M with the columns m_x, m_y and m_z, the mean of R M f is
    /// mean(R f_x) m_x + mean(R f_y) m_y + mean(R f_z) m_z.
    pub(crate) component_means: [Matrix3<f64>; 3],
    /// Mean of the rotation matrix R.
    pub(crate) mean_rotation: Matrix3<f64>,
    /// Sides that pointed up for a quarter of a second or longer: +x, −x, +y, −y, +z, −z.
    pub(crate) sides_up: [bool; 6],
}

impl MeanForce {
    /// Creates the mean for a constant force and no rotation.
    pub(crate) fn at_rest(force_m_s2: &Vector3<f64>) -> Self {
        let component_means = [0, 1, 2].map(|axis| Matrix3::identity() * force_m_s2[axis]);
        let mut sides_up = [false; 6];
        sides_up[face(force_m_s2)] = true;
        Self { component_means, mean_rotation: Matrix3::identity(), sides_up }
    }

    /// Returns the mean of R M (f − b), where M is `matrix` and b is `bias`. The module
    /// documentation defines R and f.
    pub(crate) fn corrected(&self, matrix: &Matrix3<f64>, bias: &Vector3<f64>) -> Vector3<f64> {
        let sum: Vector3<f64> = (0..3).map(|axis| self.component_means[axis] * matrix.column(axis)).sum();
        sum - self.mean_rotation * (matrix * bias)
    }

    /// Returns the mean of R f, the force without correction.
    pub(crate) fn force_m_s2(&self) -> Vector3<f64> {
        self.corrected(&Matrix3::identity(), &Vector3::zeros())
    }
}

/// Collects motion windows.
#[derive(Debug, Clone)]
pub(crate) struct MotionWindows {
    gyro: Calibration,
    complete: Vec<MeanForce>,
    open: Option<OpenWindow>,
}

#[derive(Debug, Clone)]
struct OpenWindow {
    start_ns: i64,
    last_ns: i64,
    attitude: UnitQuaternion<f64>,
    component_sums: [Matrix3<f64>; 3],
    rotation_sum: Matrix3<f64>,
    weight: f64,
    count: usize,
    /// Number of readings with each side up.
    sides_up: [usize; 6],
    is_slow: bool,
}

impl OpenWindow {
    fn mean_force(&self) -> MeanForce {
        let share = self.weight.recip();
        let is_long = |count: usize| count as f64 / self.count as f64 * WINDOW_NS as f64 >= MIN_SIDE_UP_NS;
        MeanForce {
            component_means: self.component_sums.map(|sum| sum * share),
            mean_rotation: self.rotation_sum * share,
            sides_up: self.sides_up.map(is_long),
        }
    }
}

impl MotionWindows {
    pub(crate) fn new(gyro: Calibration) -> Self {
        Self { gyro, complete: Vec::new(), open: None }
    }

    pub(crate) fn push(&mut self, sample: &Sample) {
        if self.complete.len() >= MAX_WINDOWS {
            return;
        }
        let rate_rad_s = self.gyro.apply(sample.rate_rad_s);
        let continues =
            |open: &OpenWindow| sample.t_ns - open.last_ns <= MAX_GAP_NS && sample.t_ns - open.start_ns < WINDOW_NS;
        if let Some(ended) = self.open.take_if(|open| !continues(open)) {
            let is_complete = ended.last_ns - ended.start_ns >= WINDOW_NS - MAX_GAP_NS && ended.count >= MIN_READINGS;
            if is_complete && ended.is_slow {
                let mean = ended.mean_force();
                let is_plausible_gravity = (0.5..2.0).contains(&(mean.force_m_s2().norm() / GRAVITY_M_S2));
                self.complete.extend(is_plausible_gravity.then_some(mean));
            }
        }
        let new_window = OpenWindow {
            start_ns: sample.t_ns,
            last_ns: sample.t_ns,
            attitude: UnitQuaternion::identity(),
            component_sums: [Matrix3::zeros(); 3],
            rotation_sum: Matrix3::zeros(),
            weight: 0.0,
            count: 0,
            sides_up: [0; 6],
            is_slow: true,
        };
        let open = self.open.get_or_insert(new_window);
        let dt_s = (sample.t_ns - open.last_ns) as f64 * 1e-9;
        open.attitude *= UnitQuaternion::from_scaled_axis(rate_rad_s * dt_s);
        let rotation = open.attitude.to_rotation_matrix().into_inner();
        let weight = 1.0 - ((sample.t_ns - open.start_ns) as f64 / WINDOW_NS as f64 * std::f64::consts::TAU).cos();
        open.weight += weight;
        open.rotation_sum += rotation * weight;
        (0..3).for_each(|axis| open.component_sums[axis] += rotation * (weight * sample.force_m_s2[axis]));
        open.last_ns = sample.t_ns;
        open.count += 1;
        open.sides_up[face(&sample.force_m_s2)] += 1;
        open.is_slow &= rate_rad_s.norm() <= MAX_RATE_RAD_S;
    }

    /// Returns the windows completed so far.
    pub(crate) fn complete(&self) -> &[MeanForce] {
        &self.complete
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oscillating_acceleration_averages_out() {
        let mut windows = MotionWindows::new(Calibration::default());
        let (gravity, wobble) = (Vector3::new(0.0, 0.0, 9.8), Vector3::new(2.0, -1.0, 3.0));
        for i in 0..2001 {
            let t_s = f64::from(i) * 0.01;
            let force = gravity + wobble * (std::f64::consts::TAU * 2.0 * t_s).sin();
            let rate_rad_s = Vector3::new(1.0, 0.0, 0.0);
            let attitude = UnitQuaternion::from_scaled_axis(rate_rad_s * t_s);
            let force_m_s2 = attitude.inverse() * force;
            windows.push(&Sample { t_ns: i64::from(i) * 10_000_000, rate_rad_s, force_m_s2, field_ut: None });
        }
        assert_eq!(windows.complete().len(), 10);
        for (i, window) in windows.complete().iter().enumerate() {
            let up = UnitQuaternion::from_scaled_axis(Vector3::x() * (2.0 * i as f64)).inverse() * gravity;
            assert!((window.force_m_s2() - up).amax() < 0.02, "{i}: {} {up}", window.force_m_s2());
        }
    }
}
