"""Published filters on a recording, with their default parameters unless the name says otherwise.

Input: a `Recording`.
Output: one quaternion per sample, w, x, y, z, sensor axes to east, north, up.
Time: the intervals of the recording. VQF and the EKF have fixed sampling times: the medians of the recording.

A field that repeats the previous one is not passed to a filter. A filter that starts from a given attitude starts from the
first force and the first field. Without a field, the heading is arbitrary.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import imufusion
import numpy as np
from ahrs.filters import EKF, Madgwick, Mahony
from vqf import VQF

from recording import Array, Recording

# Default gain of `ahrs.filters.Madgwick` with and without a magnetometer.
MADGWICK_GAINS = (0.041, 0.033)
# Gains of Mahony's filter with the smallest mean error on BROAD, published with it (doi 10.3390/data6070072).
BROAD_MAHONY_GAINS = {"k_P": 0.74, "k_I": 0.0012}
GRAVITY_M_S2 = 9.80665
# Rotation from axes north, west, up to axes east, north, up.
NWU_TO_ENU = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])


def vqf(recording: Recording) -> Array:
    """Runs VQF of the package vqf."""
    is_new = recording.new_field()
    interval_s = float(np.median(np.diff(recording.t_s)))
    field_interval_s = float(np.median(np.diff(recording.t_s[is_new]))) if is_new.sum() > 1 else interval_s
    filter = VQF(interval_s, interval_s, field_interval_s)
    # The extension module expects contiguous arrays.
    rate, force, field = (np.ascontiguousarray(x) for x in (recording.rate_rad_s, recording.force_m_s2, recording.field_ut))
    estimate = np.empty((len(is_new), 4))
    for row, has_field in enumerate(is_new):
        filter.update(rate[row], force[row], field[row] if has_field else None)
        estimate[row] = filter.getQuat9D() if recording.has_field else filter.getQuat6D()
    return estimate


def madgwick(recording: Recording) -> Array:
    """Runs the Madgwick filter of the package ahrs, in axes north, west, up."""
    filter = Madgwick(gain=MADGWICK_GAINS[0 if recording.has_field else 1])

    def update(q: Array, rate: Array, force: Array, field: Array | None, dt_s: float) -> Array:
        return filter.updateIMU(q, rate, force, dt_s) if field is None else filter.updateMARG(q, rate, force, field, dt_s)

    return to_enu(run(recording, product(inverse(NWU_TO_ENU), start(recording)), update))


def mahony(recording: Recording, **gains: float) -> Array:
    """Runs the Mahony filter of the package ahrs, in axes east, north, up."""
    filter = Mahony(**gains)

    def update(q: Array, rate: Array, force: Array, field: Array | None, dt_s: float) -> Array:
        return filter.updateIMU(q, rate, force, dt_s) if field is None else filter.updateMARG(q, rate, force, field, dt_s)

    return run(recording, start(recording), update)


def mahony_broad(recording: Recording) -> Array:
    """Runs the Mahony filter of the package ahrs with the gains for BROAD."""
    return mahony(recording, **BROAD_MAHONY_GAINS)


def ekf(recording: Recording) -> Array:
    """Runs the EKF of the package ahrs, in axes north, west, up. Its magnetic dip is the median of the recording."""
    dip_rad = median_dip_rad(recording)
    filter = EKF(magnetic_ref=np.array([math.cos(dip_rad), 0.0, -math.sin(dip_rad)]))

    def update(q: Array, rate: Array, force: Array, field: Array | None, dt_s: float) -> Array:
        # The attribute selects the measurement model.
        filter.mag = field
        return filter.update(q, rate, force, field, dt_s)

    return to_enu(run(recording, product(inverse(NWU_TO_ENU), start(recording)), update))


def fusion(recording: Recording) -> Array:
    """Runs Fusion of x-io Technologies (package imufusion) with its default settings, in axes north, west, up."""
    filter = imufusion.Ahrs()
    filter.set_sample_period(float(np.median(np.diff(recording.t_s))))
    rate_deg_s, force_g, is_new = np.degrees(recording.rate_rad_s), recording.force_m_s2 / GRAVITY_M_S2, recording.new_field()
    estimate = np.empty((len(is_new), 4))
    for row, has_field in enumerate(is_new):
        if has_field:
            filter.update(rate_deg_s[row], force_g[row], recording.field_ut[row])
        else:
            filter.update_no_magnetometer(rate_deg_s[row], force_g[row])
        estimate[row] = filter.get_quaternion()
    return to_enu(estimate)


# Filters by name. `BEST_OF` are those from which the best peer is chosen.
PEERS: dict[str, Callable[[Recording], Array]] = {
    "VQF": vqf,
    "Madgwick": madgwick,
    "Mahony": mahony,
    "Mahony (BROAD)": mahony_broad,
    "EKF": ekf,
    "Fusion": fusion,
}
BEST_OF = ("VQF", "Madgwick", "Mahony", "Mahony (BROAD)", "EKF")


def run(recording: Recording, q: Array, update: Callable[..., Array]) -> Array:
    """Runs a filter whose `update` maps attitude and sample to the next attitude. The first sample has no interval."""
    is_new, estimate = recording.new_field(), np.empty((len(recording.t_s), 4))
    intervals_s = np.diff(recording.t_s, prepend=recording.t_s[0])
    for row, dt_s in enumerate(intervals_s):
        if dt_s > 0.0:
            field = recording.field_ut[row] if is_new[row] else None
            q = np.asarray(update(q, recording.rate_rad_s[row], recording.force_m_s2[row], field, dt_s))
        estimate[row] = q
    return estimate


def start(recording: Recording) -> Array:
    """Returns the attitude of the first force and the first field, sensor axes to east, north, up."""
    up = recording.force_m_s2[0] / np.linalg.norm(recording.force_m_s2[0])
    with_field = np.flatnonzero(recording.new_field())
    # Without a field, any direction that is not vertical can be north.
    north = recording.field_ut[with_field[0]] if len(with_field) else np.eye(3)[np.argmin(np.abs(up))]
    east = np.cross(north, up)
    east /= np.linalg.norm(east)
    return quaternion(np.stack([east, np.cross(up, east), up]))


def median_dip_rad(recording: Recording) -> float:
    """Returns the median angle of the field below the horizontal plane that is normal to the force."""
    force, field = recording.force_m_s2[recording.new_field()], recording.field_ut[recording.new_field()]
    if not len(field):
        return 0.0
    sine = -np.sum(force * field, axis=1) / (np.linalg.norm(force, axis=1) * np.linalg.norm(field, axis=1))
    return float(np.median(np.arcsin(np.clip(sine, -1.0, 1.0))))


def to_enu(estimate: Array) -> Array:
    """Converts attitudes relative to north, west, up to attitudes relative to east, north, up."""
    return np.stack([product(NWU_TO_ENU, q) for q in estimate])


def product(a: Array, b: Array) -> Array:
    """Returns the quaternion product."""
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[scalar], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def inverse(q: Array) -> Array:
    """Returns the inverse of a unit quaternion."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def quaternion(matrix: Array) -> Array:
    """Returns the quaternion of a rotation matrix."""
    # Four times the products of all pairs of components. The row with the largest diagonal element has
    # the smallest rounding errors.
    m, trace = matrix, np.trace(matrix)
    products = np.array([
        [1.0 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], 1.0 + 2.0 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1.0 + 2.0 * m[1, 1] - trace, m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1.0 + 2.0 * m[2, 2] - trace],
    ])
    row = products[np.argmax(np.diag(products))]
    return row / np.linalg.norm(row)
