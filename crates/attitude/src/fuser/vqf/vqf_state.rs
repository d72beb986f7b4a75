//! Traversal and validation of the state of vqf-rs.

use vqf_rs::{Quaternion, State};

/// Passes every number of the state to `visit`. A NaN, which marks a low-pass filter that has not
/// started, is passed as `f64::MAX`.
pub(super) fn visit_state(state: &mut State, visit: &mut dyn FnMut(&mut f64)) {
    let State {
        gyr_quat,
        acc_quat,
        delta,
        rest_detected,
        mag_dist_detected,
        last_acc_lp,
        acc_lp_state,
        last_acc_corr_angular_rate,
        k_mag_init,
        last_mag_dis_angle,
        last_mag_corr_angular_rate,
        bias,
        bias_p,
        motion_bias_est_rlp_state,
        motion_bias_est_bias_lp_state,
        rest_last_squared_deviations,
        rest_t,
        rest_last_gyr_lp,
        rest_gyr_lp_state,
        rest_last_acc_lp,
        rest_acc_lp_state,
        mag_ref_norm,
        mag_ref_dip,
        mag_undisturbed_t,
        mag_reject_t,
        mag_candidate_norm,
        mag_candidate_dip,
        mag_candidate_t,
        mag_norm_dip,
        mag_norm_dip_lp_state,
    } = state;
    let mut visit_number = |x: &mut f64| {
        let mut encoded = if x.is_nan() { f64::MAX } else { *x };
        visit(&mut encoded);
        *x = if encoded == f64::MAX { f64::NAN } else { encoded };
    };
    for Quaternion(w, x, y, z) in [gyr_quat, acc_quat] {
        [w, x, y, z].into_iter().for_each(&mut visit_number);
    }
    for flag in [rest_detected, mag_dist_detected] {
        let mut value = f64::from(u8::from(*flag));
        visit_number(&mut value);
        *flag = value > 0.5;
    }
    [
        delta,
        last_acc_corr_angular_rate,
        k_mag_init,
        last_mag_dis_angle,
        last_mag_corr_angular_rate,
        rest_t,
        mag_ref_norm,
        mag_ref_dip,
        mag_undisturbed_t,
        mag_reject_t,
        mag_candidate_norm,
        mag_candidate_dip,
        mag_candidate_t,
    ]
    .into_iter()
    .chain([last_acc_lp, bias, rest_last_gyr_lp, rest_last_acc_lp].into_iter().flatten())
    .chain([rest_last_squared_deviations, mag_norm_dip].into_iter().flatten())
    .chain(bias_p.0.iter_mut().flatten())
    .chain([acc_lp_state, rest_gyr_lp_state, rest_acc_lp_state].into_iter().flatten().flatten())
    .chain(motion_bias_est_rlp_state.iter_mut().flatten())
    .chain([motion_bias_est_bias_lp_state, mag_norm_dip_lp_state].into_iter().flatten().flatten())
    .for_each(visit_number);
}

/// Returns the reason why a state is invalid, or `None` if it is valid. Whether its numbers are
/// finite is not checked here.
pub(super) fn validation_error(state: &State) -> Option<&'static str> {
    let unit = |q: Quaternion| (q.norm() - 1.0).abs() <= 1e-6;
    if !(unit(state.gyr_quat) && unit(state.acc_quat)) {
        return Some("a quaternion that is not of unit length");
    }
    let p = state.bias_p.0;
    let max_element = p.iter().flatten().fold(0.0, |size: f64, x| size.max(x.abs()));
    let symmetric = [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| (p[i][j] - p[j][i]).abs() <= 1e-6 * max_element);
    if !symmetric {
        return Some("a covariance that is not symmetric");
    }
    // Sylvester's criterion for semidefiniteness: all principal minors are checked, not only the
    // leading ones, because a variance may be zero.
    let minor = |i: usize, j: usize| p[i][i] * p[j][j] - p[i][j] * p[j][i];
    let determinant = p[0][0] * minor(1, 2) - p[0][1] * (p[1][0] * p[2][2] - p[1][2] * p[2][0])
        + p[0][2] * (p[1][0] * p[2][1] - p[1][1] * p[2][0]);
    let definite = (0..3).all(|i| p[i][i] >= 0.0)
        && [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| minor(i, j) >= -1e-9 * max_element * max_element)
        && determinant >= -1e-9 * max_element * max_element * max_element;
    (!definite).then_some("a covariance that is not positive")
}
