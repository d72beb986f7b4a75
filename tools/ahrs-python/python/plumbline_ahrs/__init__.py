"""Attitude and heading from a gyro and an accelerometer, optionally with a magnetometer and a
satellite receiver.

    import plumbline_ahrs

    recording = plumbline_ahrs.read("flight.ulg")
    samples = recording.samples
    batch = plumbline_ahrs.Ahrs().update_batch(
        samples["gyro_rad_s"], samples["accel_m_s2"], samples["field_ut"], t_ns=samples["t_ns"]
    )
    batch.heading_rad

Units are SI units, with angles in radians; the magnetic field is in µT. The axes of the sensors are
right, forward, up by default. An accelerometer measures specific force: at rest it points up with
9.81 m/s². The reference axes are east, north, up.

`Ahrs` estimates attitudes. `read` reads recordings, and `score` computes errors against their
reference. `Subscriber` reads the topics of a running system Plumbline on this machine; `Sensor` and
`Receiver` publish readings and fixes to it. The subpackage `stage_sdk` helps to write stages of the
system in Python.
"""

from typing import TYPE_CHECKING

from ._native import Ahrs, Attitude, Batch, Recording, Subscriber, read, score
from ._values import Angles, Errors, Flags, Parameter, RecordedSensor, Score, Segment, TrialScore

if TYPE_CHECKING:
    from .stage_sdk.sensor import FeedError, Receiver, Sensor

__all__ = [
    "Ahrs", "Angles", "Attitude", "Batch", "Errors", "FeedError", "Flags", "Parameter", "Receiver",
    "RecordedSensor", "Recording", "Score", "Segment", "Sensor", "Subscriber", "TrialScore", "read",
    "score",
]


def __getattr__(name: str) -> object:
    """Import the publishers on first use, because their modules take longer than the filter."""
    if name not in ("FeedError", "Receiver", "Sensor"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .stage_sdk import sensor

    return getattr(sensor, name)
