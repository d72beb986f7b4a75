"""What a stage of each slot is given and gives back, and all of it as numbers, in the order of the fields. None is what a tick has not."""

import functools
import math
from typing import NamedTuple, Optional, get_args

from .attitude import Attitude, Point, Quaternion, Turn, Vector

# What a course is counted from.
ARBITRARY, MAGNETIC, TRUE = 0, 1, 2
ZERO = (0.0, 0.0, 0.0)


class RateSample(NamedTuple):
    """What a gyro stage is given."""

    rate_rad_s: Vector
    dt_s: float
    instant: bool  # the rate is the value at the interval's end, not its mean


class Motion(NamedTuple):
    """What a gyro stage gives, and a fuser is given."""

    attitude: Attitude  # open loop, at the interval's end
    turn: Turn  # of the body over the interval
    rate_rad_s: Vector  # mean over the interval
    dt_s: float


class Inclination(NamedTuple):
    """What an accel stage, which is given the specific force in m/s², gives, and a fuser is given."""

    up: Point
    force_m_s2: Vector
    norm_m_s2: float
    trust: float  # 1 at |f| = g, 0 where the point is not from this sample


class Fix(NamedTuple):
    """What a satellite receiver said: velocity east, north, up; None where unknown."""

    velocity_m_s: Vector
    sd_m_s: Optional[float]
    age_s: Optional[float]
    latitude_rad: Optional[float]


class FuserInput(NamedTuple):
    """What a fuser is given: what is None has not come or cannot be used."""

    motion: Optional[Motion] = None
    inclination: Optional[Inclination] = None
    field_ut: Optional[Vector] = None
    fix: Optional[Fix] = None
    rest_credible: bool = True  # gyro and accelerometer are alive, so that stillness means rest
    rate_credible: bool = True  # the motion is what the body did


class Fused(NamedTuple):
    """What a fuser gives. The last seven say what this tick was corrected by, or what was found."""

    attitude: Attitude
    rate_rad_s: Vector
    bias_rad_s: Vector = ZERO
    innovation_rad: float = 0.0  # angle between the accelerometer's up and the attitude's
    inclination_sd_rad: float = 0.1
    heading_sd_rad: float = math.pi  # π where nothing is known
    reference: int = ARBITRARY
    tilt: bool = False
    bias: bool = False
    magnetic: bool = False
    velocity: bool = False
    disturbed: bool = False  # the magnetic field is not that of the place
    rest: bool = False
    aligned: bool = False  # the attitude was set anew and jumps


class Estimate(NamedTuple):
    """What every fuser can hand over to every other. A standard deviation is infinite where nobody estimated what it is of."""

    attitude: Attitude
    reference: int = ARBITRARY
    bias_rad_s: Vector = ZERO
    inclination_sd_rad: float = 0.1
    heading_sd_rad: float = math.pi
    bias_sd_rad_s: float = math.inf
    gyro_scale: Vector = ZERO  # by which part of itself the rate about each axis is read too large
    gyro_scale_sd: Vector = (math.inf, math.inf, math.inf)
    hard_iron_ut: Vector = ZERO
    hard_iron_sd_ut: float = math.inf
    leaky_velocity_m_s: complex = 0j  # V by which the level leans, east + j north: V' = h − V/T, h the horizontal force, T 1.5 to 3 s
    leaky_velocity_sd_m_s: float = math.inf

    def check(self):
        """Raises ValueError for what is no estimate."""
        self.attitude.check()
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
            raise ValueError("a standard deviation below zero")


class CourseInput(NamedTuple):
    """What a course stage is given."""

    attitude: Attitude
    reference: int
    heading_sd_rad: float
    fix: Optional[Fix]
    dt_s: float


class Reading(NamedTuple):
    """What a course stage gives."""

    yaw_rad: float
    pitch_rad: float
    roll_rad: float
    course_rad: float  # clockwise from above, [0, 2π)
    reference: int
    course_sd_rad: float
    declination_rad: float  # what made a magnetic heading a true course; 0 where nothing did
    quaternion: Quaternion  # body → reference, unit; its sign does not jump
    near_gimbal: bool = False
    aligned: bool = False  # the course was set anew and jumps


class Bearing(NamedTuple):
    """A course and how far it can be believed."""

    course_rad: float = 0.0
    reference: int = ARBITRARY
    sd_rad: float = math.pi


class LastReading(NamedTuple):
    """What every course stage can hand over to every other."""

    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    bearing: Optional[Bearing] = None

    def check(self):
        """Raises ValueError for what is no reading."""
        if not abs(sum(x * x for x in self.quaternion) - 1.0) <= 1e-6:
            raise ValueError("a quaternion that is not of unit length")
        if self.bearing and not (0.0 <= self.bearing.course_rad < math.tau and self.bearing.sd_rad >= 0.0):
            raise ValueError("a course that is none")


def _append(value, numbers):
    numbers.append(value)


# How many numbers, a function that makes a value from an iterator of them, one that puts a value's at the end of a list.
_SIMPLE = {
    float: (1, next, _append),
    int: (1, lambda numbers: int(next(numbers)), _append),
    bool: (1, lambda numbers: next(numbers) > 0.5, _append),
    complex: (2, lambda numbers: complex(next(numbers), next(numbers)), lambda value, numbers: numbers.extend((value.real, value.imag))),
    Vector: (3, lambda numbers: (next(numbers), next(numbers), next(numbers)), lambda value, numbers: numbers.extend(value)),
    # Sent as x, y, z, w.
    Quaternion: (
        4,
        lambda numbers: (lambda x, y, z, w: (w, x, y, z))(*(next(numbers) for _ in range(4))),
        lambda value, numbers: numbers.extend((*value[1:], value[0])),
    ),
}


@functools.cache
def codec(kind):
    """The same three for any kind of value."""
    if kind in _SIMPLE:
        return _SIMPLE[kind]
    if type(None) in get_args(kind):
        count, read, write = codec(get_args(kind)[0])
        absent = [0.0] * (1 + count)

        def read_optional(numbers):
            there, value = next(numbers) > 0.5, read(numbers)
            return value if there else None

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
    """Every number of a value."""
    numbers = []
    codec(type(value))[2](value, numbers)
    return numbers
