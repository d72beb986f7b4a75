//! Changes to the attitude of a running VQF filter.

use super::{
    filter::Vqf,
    quaternions::{conjugate, from_vqf, to_vqf},
};
use crate::{
    Complex, GRAVITY_M_S2, Vector3,
    fuser::{angle_uncertainty::AngleUncertainty, leaky_velocity::LeakyVelocity},
    point::Point,
    state::Attitude,
};

impl Vqf {
    /// Sets the magnetometer-free attitude.
    ///
    /// Also resets the low-pass filters of the force and of the bias in motion, because their
    /// states no longer fit the attitude.
    pub(super) fn set_attitude(&mut self, attitude: Attitude) {
        let q = attitude.quaternion();
        let state = self.filter.state_mut();
        let gyro = state.gyr_quat;
        let mut level = to_vqf(q) * conjugate(gyro);
        level.normalize();
        state.acc_quat = level;
        state.acc_lp_state = [[f64::NAN; 2]; 3];
        state.motion_bias_est_rlp_state = [[f64::NAN; 2]; 9];
        state.motion_bias_est_bias_lp_state = [[f64::NAN; 2]; 2];
    }

    pub(super) fn align_level(&mut self, up: Point) {
        self.set_attitude(Attitude::from_quaternion(from_vqf(self.filter.quat_6d())).realigned(up).attitude);
        self.levelled = true;
        self.velocity_sd_m_s = 0.0;
        self.tilt = AngleUncertainty::INITIAL;
    }

    /// Initialises the low-pass filter with gravity at the current level and the given velocity.
    ///
    /// Otherwise the filter would start with the next force.
    pub(super) fn seed_low_pass(&mut self, velocity_m_s: Complex<f64>) {
        let to_gyro = conjugate(self.filter.state().acc_quat);
        self.set_force_low_pass(ForceLowPass {
            force_m_s2: to_gyro.rotate([0.0, 0.0, GRAVITY_M_S2]).into(),
            velocity_m_s: to_gyro.rotate([velocity_m_s.re, velocity_m_s.im, 0.0]).into(),
        });
    }

    /// Returns the leaky velocity of the force low-pass filter, in the reference frame of the
    /// attitude. The filter tilts its level at a rate proportional to this velocity.
    pub(super) fn leaky_velocity(&self) -> LeakyVelocity {
        let Some(ForceLowPass { velocity_m_s, .. }) = self.force_low_pass().filter(|_| self.levelled) else {
            return LeakyVelocity::UNKNOWN;
        };
        let state = self.filter.state();
        let [east, north, _] = state.acc_quat.rotate(velocity_m_s.into());
        let velocity_m_s = Complex::new(east, north);
        LeakyVelocity::from_loop(velocity_m_s, self.velocity_sd_m_s).rotated(if self.magnetic {
            state.delta
        } else {
            0.0
        })
    }

    /// Returns the state of the force low-pass filter, or `None` during its initial averaging.
    ///
    /// The initial averaging ends after one time constant or when a level is handed over.
    pub(super) fn force_low_pass(&self) -> Option<ForceLowPass> {
        let ([pulse, _], resting, interval_s) = self.low_pass_response();
        let state = self.filter.state();
        if state.acc_lp_state[0][0].is_nan() {
            return None;
        }
        let force_m_s2 = Vector3::from(state.last_acc_lp);
        let delayed = Vector3::from(state.acc_lp_state.map(|[first, _]| first));
        Some(ForceLowPass { force_m_s2, velocity_m_s: (delayed - force_m_s2 * resting[0]) * (interval_s / pulse) })
    }

    /// Sets the state of the force low-pass filter.
    pub(super) fn set_force_low_pass(&mut self, ForceLowPass { force_m_s2, velocity_m_s }: ForceLowPass) {
        let (pulse, resting, interval_s) = self.low_pass_response();
        let state = self.filter.state_mut();
        state.last_acc_lp = force_m_s2.into();
        let delayed = |i: usize| [0, 1].map(|k| force_m_s2[i] * resting[k] + velocity_m_s[i] / interval_s * pulse[k]);
        state.acc_lp_state = core::array::from_fn(delayed);
    }

    /// Returns the response of the low-pass filter.
    ///
    /// The result contains its two delay elements after a single sample of 1, its two delay
    /// elements at a steady input of 1, and its sampling interval, s.
    fn low_pass_response(&self) -> ([f64; 2], [f64; 2], f64) {
        let coefficients = self.filter.coeffs();
        let (b, a) = (coefficients.acc_lp_b, coefficients.acc_lp_a);
        ([b[1] - a[0] * b[0], b[2] - a[1] * b[0]], [1.0 - b[0], b[2] - a[1]], coefficients.acc_ts)
    }
}

/// Output of the second-order force low-pass filter and its rate of change.
///
/// Both are in the frame of the gyro integration.
pub(super) struct ForceLowPass {
    force_m_s2: Vector3<f64>,
    /// Velocity change that is equivalent to the rate of change of the output, m/s.
    ///
    /// A force pulse of one sample with this velocity change causes the same rate of change in a
    /// filter at rest.
    velocity_m_s: Vector3<f64>,
}
