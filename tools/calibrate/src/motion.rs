//! Gravity felt in motion: forces of two seconds, turned into one frame by the gyro, and their mean.
//!
//! A hand that turns a unit about does not carry it far: over two seconds its accelerations nearly cancel, where they are added in one frame, and
//! gravity stays. They are weighted by a raised cosine (Hann), so that the speeds at both ends do not count. The mean of R f, R the turn since the window's first reading, is linear in what the force is corrected by.

use attitude::{GRAVITY_M_S2, Matrix3, Vector3, calibration::Calibration};
use nalgebra::UnitQuaternion;

use crate::{Sample, sphere::face};

/// Length of a window, ns, and the longest interval between its readings.
const WINDOW_NS: i64 = 2_000_000_000;
const GAP_NS: i64 = 100_000_000;
/// Fewest readings of a window.
const MIN_READINGS: usize = 20;
/// A window in which the unit turns faster is not taken, rad/s: gyro and accelerometer are not in one place, nor of one time.
const MAX_RATE_RAD_S: f64 = 6.0;
/// A side that was up for so long counts, ns.
const UP_NS: f64 = 250e6;
/// Windows kept: three hours. What comes later is not looked at.
const MAX_WINDOWS: usize = 5_000;

/// The mean of forces, each turned into the sensor's axes at the beginning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seen {
    /// Mean of R f_x, R f_y, R f_z, so that the mean of R M f is the sum over the columns of M.
    pub(crate) turned: [Matrix3<f64>; 3],
    /// Mean of R.
    pub(crate) turn: Matrix3<f64>,
    /// Which sides were up for a quarter of a second or longer: +x, −x, +y, −y, +z, −z.
    pub(crate) sides_up: [bool; 6],
}

impl Seen {
    /// One that was not turned.
    pub(crate) fn still(force_m_s2: &Vector3<f64>) -> Self {
        let turned = [0, 1, 2].map(|axis| Matrix3::identity() * force_m_s2[axis]);
        let mut sides_up = [false; 6];
        sides_up[face(force_m_s2)] = true;
        Self { turned, turn: Matrix3::identity(), sides_up }
    }

    /// Mean of R M (f − b).
    pub(crate) fn corrected(&self, matrix: &Matrix3<f64>, bias: &Vector3<f64>) -> Vector3<f64> {
        let sum: Vector3<f64> = (0..3).map(|axis| self.turned[axis] * matrix.column(axis)).sum();
        sum - self.turn * (matrix * bias)
    }

    /// Mean of R f.
    pub(crate) fn force_m_s2(&self) -> Vector3<f64> {
        self.corrected(&Matrix3::identity(), &Vector3::zeros())
    }
}

/// Makes windows while readings come.
#[derive(Debug, Clone)]
pub(crate) struct Windows {
    gyro: Calibration,
    whole: Vec<Seen>,
    open: Option<Open>,
}

#[derive(Debug, Clone)]
struct Open {
    since_ns: i64,
    last_ns: i64,
    attitude: UnitQuaternion<f64>,
    turned: [Matrix3<f64>; 3],
    turn: Matrix3<f64>,
    weight: f64,
    count: usize,
    /// Readings with each side up.
    sides_up: [usize; 6],
    is_slow: bool,
}

impl Open {
    fn mean(&self) -> Seen {
        let share = self.weight.recip();
        let is_long = |count: usize| count as f64 / self.count as f64 * WINDOW_NS as f64 >= UP_NS;
        Seen {
            turned: self.turned.map(|sum| sum * share),
            turn: self.turn * share,
            sides_up: self.sides_up.map(is_long),
        }
    }
}

impl Windows {
    pub(crate) fn new(gyro: Calibration) -> Self {
        Self { gyro, whole: Vec::new(), open: None }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        if self.whole.len() >= MAX_WINDOWS {
            return;
        }
        let rate_rad_s = self.gyro.apply(sample.rate_rad_s);
        let goes_on = |open: &Open| sample.t_ns - open.last_ns <= GAP_NS && sample.t_ns - open.since_ns < WINDOW_NS;
        if let Some(ended) = self.open.take_if(|open| !goes_on(open)) {
            let is_whole = ended.last_ns - ended.since_ns >= WINDOW_NS - GAP_NS && ended.count >= MIN_READINGS;
            if is_whole && ended.is_slow {
                let mean = ended.mean();
                let feels_gravity = (0.5..2.0).contains(&(mean.force_m_s2().norm() / GRAVITY_M_S2));
                self.whole.extend(feels_gravity.then_some(mean));
            }
        }
        let begun = Open {
            since_ns: sample.t_ns,
            last_ns: sample.t_ns,
            attitude: UnitQuaternion::identity(),
            turned: [Matrix3::zeros(); 3],
            turn: Matrix3::zeros(),
            weight: 0.0,
            count: 0,
            sides_up: [0; 6],
            is_slow: true,
        };
        let open = self.open.get_or_insert(begun);
        let dt_s = (sample.t_ns - open.last_ns) as f64 * 1e-9;
        open.attitude *= UnitQuaternion::from_scaled_axis(rate_rad_s * dt_s);
        let turn = open.attitude.to_rotation_matrix().into_inner();
        let weight = 1.0 - ((sample.t_ns - open.since_ns) as f64 / WINDOW_NS as f64 * std::f64::consts::TAU).cos();
        open.weight += weight;
        open.turn += turn * weight;
        (0..3).for_each(|axis| open.turned[axis] += turn * (weight * sample.force_m_s2[axis]));
        open.last_ns = sample.t_ns;
        open.count += 1;
        open.sides_up[face(&sample.force_m_s2)] += 1;
        open.is_slow &= rate_rad_s.norm() <= MAX_RATE_RAD_S;
    }

    /// The windows so far.
    pub(crate) fn whole(&self) -> &[Seen] {
        &self.whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerations_of_a_unit_that_stays_where_it_is_cancel() {
        let mut windows = Windows::new(Calibration::default());
        let (gravity, wobble) = (Vector3::new(0.0, 0.0, 9.8), Vector3::new(2.0, -1.0, 3.0));
        for i in 0..2001 {
            let t_s = f64::from(i) * 0.01;
            let force = gravity + wobble * (std::f64::consts::TAU * 2.0 * t_s).sin();
            let rate_rad_s = Vector3::new(1.0, 0.0, 0.0);
            let attitude = UnitQuaternion::from_scaled_axis(rate_rad_s * t_s);
            let force_m_s2 = attitude.inverse() * force;
            windows.take(&Sample { t_ns: i64::from(i) * 10_000_000, rate_rad_s, force_m_s2, field_ut: None });
        }
        assert_eq!(windows.whole().len(), 10);
        for (i, window) in windows.whole().iter().enumerate() {
            let up = UnitQuaternion::from_scaled_axis(Vector3::x() * (2.0 * i as f64)).inverse() * gravity;
            assert!((window.force_m_s2() - up).amax() < 0.02, "{i}: {} {up}", window.force_m_s2());
        }
    }
}
