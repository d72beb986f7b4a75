"""Inputs, outputs and common states of the slots, and their conversion to numbers.

Numbers are in the order of the fields. None means that the value is missing in this tick.
"""

import functools
import math
from typing import NamedTuple, Optional, get_args

from .attitude import Attitude, Point, Quaternion, Rotation, Vector

# Reference directions of a course or heading: initial direction, magnetic north, true north.
ARBITRARY, MAGNETIC, TRUE = 0, 1, 2
ZERO = (0.0, 0.0, 0.0)


class RateSample(NamedTuple):
    """Input of a gyro stage."""

    rate_rad_s: Vector
    dt_s: float
    instant: bool  # True: the rate is the value at the end of the interval; False: the mean over it


class Motion(NamedTuple):
    """Output of a gyro stage, and an input of a fuser."""

    attitude: Attitude  # open loop, at the end of the interval
    rotation: Rotation  # rotation of the body over the interval
    rate_rad_s: Vector  # mean over the interval
    dt_s: float


class Inclination(NamedTuple):
    """Output of an accel stage, and an input of a fuser.

    The input of an accel stage is the specific force, a `Vector` in m/s².
    """

    up: Point
    force_m_s2: Vector
    norm_m_s2: float
    trust: float  # 1 at |f| = g; 0 if `up` was not computed from this force


class Fix(NamedTuple):
    """Fix from a satellite receiver. The velocity over ground is given as east, north, up."""

    velocity_m_s: Vector
    sd_m_s: Optional[float]
    age_s: Optional[float]
    latitude_rad: Optional[float]


class FuserInput(NamedTuple):
    """Input of a fuser. A value is None if it is missing or not usable."""

    motion: Optional[Motion] = None
    inclination: Optional[Inclination] = None
    field_ut: Optional[Vector] = None
    fix: Optional[Fix] = None
    rest_credible: bool = True  # gyro and accelerometer are working, so constant readings mean rest
    rate_credible: bool = True  # the measured motion is that of the body


class Fused(NamedTuple):
    """Output of a fuser. The last seven fields are the corrections and states of this tick."""

    attitude: Attitude
    rate_rad_s: Vector
    bias_rad_s: Vector = ZERO
    innovation_rad: float = 0.0  # angle between the up vectors of accelerometer and attitude
    inclination_sd_rad: float = 0.1
    heading_sd_rad: float = math.pi  # π if unknown
    reference: int = ARBITRARY
    tilt: bool = False
    bias: bool = False
    magnetic: bool = False
    velocity: bool = False
    disturbed: bool = False  # the magnetic field is disturbed
    rest: bool = False
    aligned: bool = False  # the attitude was re-initialised and jumps


class Estimate(NamedTuple):
    """State that one fuser hands over to another. Infinite standard deviations mean "unknown"."""

    attitude: Attitude
    reference: int = ARBITRARY
    bias_rad_s: Vector = ZERO
    inclination_sd_rad: float = 0.1
    heading_sd_rad: float = math.pi
    bias_sd_rad_s: float = math.inf
    gyro_scale: Vector = ZERO  # relative scale error of the rate about each axis
    gyro_scale_sd: Vector = (math.inf, math.inf, math.inf)
    hard_iron_ut: Vector = ZERO
    hard_iron_sd_ut: float = math.inf
    # Leaky integral V of the horizontal specific force h: V' = h − V/T, where T is 1.5 to 3 s. A
    # levelling loop tilts its level at a rate proportional to V. Given as east + j north.
    leaky_velocity_m_s: complex = 0j
    leaky_velocity_sd_m_s: float = math.inf

    def validate(self):
        """Raises ValueError if the estimate is invalid."""
        self.attitude.validate()
        if not all(abs(bias) <= 10.0 for bias in self.bias_rad_s) or not all(abs(part) <= 1e4 for part in self.hard_iron_ut):
            raise ValueError("a gyro bias above 10 rad/s, or a hard iron above 10,000 µT")
        if not all(abs(part) <= 0.1 for part in self.gyro_scale):
            raise ValueError("a gyro scale error above 0.1")
        if not math.hypot(self.leaky_velocity_m_s.real, self.leaky_velocity_m_s.imag) <= 100.0:
            raise ValueError("a leaky velocity above 100 m/s")
        sds = (
            self.inclination_sd_rad, self.heading_sd_rad, self.bias_sd_rad_s, *self.gyro_scale_sd, self.hard_iron_sd_ut,
            self.leaky_velocity_sd_m_s,
        )
        if not all(sd >= 0.0 for sd in sds):
            raise ValueError("a negative standard deviation")


class CourseInput(NamedTuple):
    """Input of a course stage."""

    attitude: Attitude
    reference: int
    heading_sd_rad: float
    fix: Optional[Fix]
    dt_s: float


class CourseReading(NamedTuple):
    """Output of a course stage."""

    yaw_rad: float
    pitch_rad: float
    roll_rad: float
    course_rad: float  # clockwise from above, [0, 2π)
    reference: int
    course_sd_rad: float
    declination_rad: float  # added to a magnetic heading, east positive; 0 if none was added
    quaternion: Quaternion  # body → reference, unit, with a continuous sign
    near_gimbal: bool = False
    aligned: bool = False  # the course was realigned and jumps


class CourseEstimate(NamedTuple):
    """Course with its uncertainty."""

    course_rad: float = 0.0
    reference: int = ARBITRARY
    sd_rad: float = math.pi


class LastReading(NamedTuple):
    """Last reading, which any course stage can hand over to any other."""

    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    course: Optional[CourseEstimate] = None

    def validate(self):
        """Raises ValueError if the quaternion or the course is invalid."""
        if not abs(sum(x * x for x in self.quaternion) - 1.0) <= 1e-6:
            raise ValueError("a quaternion that is not of unit length")
        if self.course and not (0.0 <= self.course.course_rad < math.tau and self.course.sd_rad >= 0.0):
            raise ValueError("a course outside [0, 2π) or a negative standard deviation")


def _append(value, numbers):
    numbers.append(value)


# Codec of a type: the count of its numbers, a function that reads a value from an iterator, and a
# function that appends a value to a list.
_SIMPLE = {
    float: (1, next, _append),
    int: (1, lambda numbers: int(next(numbers)), _append),
    bool: (1, lambda numbers: next(numbers) > 0.5, _append),
    complex: (2, lambda numbers: complex(next(numbers), next(numbers)), lambda value, numbers: numbers.extend((value.real, value.imag))),
    Vector: (3, lambda numbers: (next(numbers), next(numbers), next(numbers)), lambda value, numbers: numbers.extend(value)),
    # Transmitted as x, y, z, w.
    Quaternion: (
        4,
        lambda numbers: (lambda x, y, z, w: (w, x, y, z))(*(next(numbers) for _ in range(4))),
        lambda value, numbers: numbers.extend((*value[1:], value[0])),
    ),
}


@functools.cache
def codec(kind):
    """Returns the codec of a type."""
    if kind in _SIMPLE:
        return _SIMPLE[kind]
    if type(None) in get_args(kind):
        count, read, write = codec(get_args(kind)[0])
        absent = [0.0] * (1 + count)

        def read_optional(numbers):
            present, value = next(numbers) > 0.5, read(numbers)
            return value if present else None

        def write_optional(value, numbers):
            numbers.extend(absent if value is None else (1.0,))
            if value is not None:
                write(value, numbers)

        return 1 + count, read_optional, write_optional
    fields = [codec(field) for field in kind.__annotations__.values()]
    reads = [read for _, read, _ in fields]

    def write_fields(value, numbers):
        for (_, _, write), part in zip(fields, value):
            write(part, numbers)

    return sum(count for count, _, _ in fields), lambda numbers: kind._make([read(numbers) for read in reads]), write_fields


def numbers_of(value):
    """Returns the numbers of a value."""
    numbers = []
    codec(type(value))[2](value, numbers)
    return numbers
