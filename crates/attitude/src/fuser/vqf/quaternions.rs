//! Conversion between the quaternions of vqf-rs and of this crate.

use crate::Quaternion;

pub(super) fn to_vqf(q: Quaternion<f64>) -> vqf_rs::Quaternion {
    vqf_rs::Quaternion(q.w, q.i, q.j, q.k)
}

pub(super) fn from_vqf(q: vqf_rs::Quaternion) -> Quaternion<f64> {
    Quaternion::new(q.0, q.1, q.2, q.3)
}

pub(super) fn conjugate(q: vqf_rs::Quaternion) -> vqf_rs::Quaternion {
    vqf_rs::Quaternion(q.0, -q.1, -q.2, -q.3)
}
