//! Setting the attitude of a running VQF.

use super::{
    filter::Vqf,
    quaternions::{conjugate, of_ours, to_ours},
};
use crate::{
    Complex, GRAVITY_M_S2, Vector3,
    fuser::{leaky_velocity::LeakyVelocity, spread::Spread},
    point::Point,
    state::Attitude,
};

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
        self.velocity_sd_m_s = 0.0;
        self.tilt = Spread::FIRST;
    }

    /// The averaged force begins as gravity in the level as it is, not as the next sample, and with this velocity.
    pub(super) fn trust_level(&mut self, velocity_m_s: Complex<f64>) {
        let to_gyro = conjugate(self.filter.state().acc_quat);
        self.average(Averaged {
            force_m_s2: to_gyro.rotate([0.0, 0.0, GRAVITY_M_S2]).into(),
            velocity_m_s: to_gyro.rotate([velocity_m_s.re, velocity_m_s.im, 0.0]).into(),
        });
    }

    /// The velocity by which the level leans, in the frame of the attitude.
    pub(super) fn leaky_velocity(&self) -> LeakyVelocity {
        let Some(Averaged { velocity_m_s, .. }) = self.averaged().filter(|_| self.levelled) else {
            return LeakyVelocity::UNKNOWN;
        };
        let state = self.filter.state();
        let [east, north, _] = state.acc_quat.rotate(velocity_m_s.into());
        let velocity_m_s = Complex::new(east, north);
        LeakyVelocity::of_loop(velocity_m_s, self.velocity_sd_m_s).turned(if self.magnetic { state.delta } else { 0.0 })
    }

    /// What the low-pass of the force has, once it has averaged for its time constant or a level was taken over.
    pub(super) fn averaged(&self) -> Option<Averaged> {
        let ([pulse, _], kept, interval_s) = self.low_pass();
        let state = self.filter.state();
        if state.acc_lp_state[0][0].is_nan() {
            return None;
        }
        let force_m_s2 = Vector3::from(state.last_acc_lp);
        let delayed = Vector3::from(state.acc_lp_state.map(|[first, _]| first));
        Some(Averaged { force_m_s2, velocity_m_s: (delayed - force_m_s2 * kept[0]) * (interval_s / pulse) })
    }

    /// The low-pass of the force goes on from there.
    pub(super) fn average(&mut self, Averaged { force_m_s2, velocity_m_s }: Averaged) {
        let (pulse, kept, interval_s) = self.low_pass();
        let state = self.filter.state_mut();
        state.last_acc_lp = force_m_s2.into();
        let delayed = |i: usize| [0, 1].map(|k| force_m_s2[i] * kept[k] + velocity_m_s[i] / interval_s * pulse[k]);
        state.acc_lp_state = core::array::from_fn(delayed);
    }

    /// What the two delays of the low-pass hold after one sample of 1, and while it rests at 1; its interval, s.
    fn low_pass(&self) -> ([f64; 2], [f64; 2], f64) {
        let coefficients = self.filter.coeffs();
        let (b, a) = (coefficients.acc_lp_b, coefficients.acc_lp_a);
        ([b[1] - a[0] * b[0], b[2] - a[1] * b[0]], [1.0 - b[0], b[2] - a[1]], coefficients.acc_ts)
    }
}

/// The low-pass of the force, of second order: its output and the rate of that. In the frame of the gyro's integration.
pub(super) struct Averaged {
    force_m_s2: Vector3<f64>,
    /// Area of the pulse of one sample that would give a resting low-pass this one's rate of change, m/s.
    velocity_m_s: Vector3<f64>,
}
