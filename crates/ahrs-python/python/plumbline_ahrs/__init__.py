"""Attitude and heading from a gyro and an accelerometer, optionally with a magnetometer and a
satellite receiver.

    from plumbline_ahrs import Ahrs

    ahrs = Ahrs()
    attitude = ahrs.update((0.0, 0.0, 0.1), (0.0, 0.0, 9.81), (0.0, 20.0, -40.0), 0.01)
    attitude.quaternion

Units are SI units, with angles in radians; the magnetic field is in µT. The axes of the sensors are
right, forward, up by default. An accelerometer measures specific force: at rest it points up with
9.81 m/s². The reference axes are east, north, up.

The subpackage `stage_sdk` helps to write stages of the system Plumbline in Python.
"""

from ._native import Ahrs, Attitude, Batch
from ._values import Angles, Flags, Parameter

__all__ = ["Ahrs", "Angles", "Attitude", "Batch", "Flags", "Parameter"]
