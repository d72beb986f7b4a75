//! Setting the attitude of a running VQF.

use super::{
    filter::Vqf,
    quaternions::{conjugate, of_ours, to_ours},
};
use crate::{GRAVITY_M_S2, fuser::spread::Spread, point::Point, state::Attitude};

impl Vqf {
    /// Puts the magnetometer-free attitude elsewhere; what was averaged in its frame begins anew.
    pub(super) fn put(&mut self, attitude: Attitude) {
        let q = attitude.quaternion();
        let state = self.filter.state_mut();
        let gyro = state.gyr_quat;
        let mut level = of_ours(q) * conjugate(gyro);
        level.normalize();
        state.acc_quat = level;
        state.acc_lp_state = [[f64::NAN; 2]; 3];
        state.motion_bias_est_rlp_state = [[f64::NAN; 2]; 9];
        state.motion_bias_est_bias_lp_state = [[f64::NAN; 2]; 2];
    }

    pub(super) fn level(&mut self, up: Point) {
        self.put(Attitude::of_quaternion(to_ours(self.filter.quat_6d())).realigned(up).attitude);
        self.levelled = true;
        self.tilt = Spread::FIRST;
    }

    /// The averaged force begins as gravity in the level as it is, not as the next sample.
    pub(super) fn trust_level(&mut self) {
        let coefficients = self.filter.coeffs();
        let (b, a) = (coefficients.acc_lp_b, coefficients.acc_lp_a);
        let state = self.filter.state_mut();
        let level = state.acc_quat;
        let up = conjugate(level).rotate([0.0, 0.0, GRAVITY_M_S2]);
        state.last_acc_lp = up;
        state.acc_lp_state = up.map(|x| [x * (1.0 - b[0]), x * (b[2] - a[1])]);
    }
}
