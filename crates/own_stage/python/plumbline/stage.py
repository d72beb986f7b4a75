"""What a stage of each slot is given and gives back. Vectors are three numbers in body axes; None is what a tick has not."""

import math
from typing import NamedTuple, Optional

from .attitude import Attitude, Point, Turn

ARBITRARY, MAGNETIC, TRUE = 0, 1, 2


class Stage:
    """A plain value: configuration and state in, one tick's input in, one output out. It reads no clock.

    `snapshot` must hold every number that the next output depends on: from it the next life goes on bit for bit.
    """

    # The name by which it is chosen, as in launch.toml.
    NAME = ""
    # The slot that it fills: "gyro", "accel", "fuser" or "course".
    SLOT = ""
    # What can be set: name → (default, least, most). Each becomes an attribute.
    PARAMETERS = {}

    def configure(self, settings):
        """Takes the settings of the launch file; what is no parameter, or outside its range, is refused."""
        for name, (default, _, _) in self.PARAMETERS.items():
            setattr(self, name, default)
        for name, value in settings.items():
            if name not in self.PARAMETERS:
                raise ValueError(f"`{name}` of {self.NAME}: no such parameter; there are: {', '.join(self.PARAMETERS) or 'none'}")
            _, least, most = self.PARAMETERS[name]
            if not least <= value <= most:
                raise ValueError(f"`{name}` of {self.NAME}: {value} is outside {least} to {most}")
            setattr(self, name, float(value))

    def step(self, input):
        """One tick."""
        raise NotImplementedError

    def snapshot(self):
        """The state: at most 512 finite numbers, always as many."""
        raise NotImplementedError

    def restore(self, values):
        """Takes over what `snapshot` gave; raises ValueError for what is no state, and leaves the stage as it was."""
        raise NotImplementedError

    def common(self):
        """What every stage of the slot can go on with: Attitude (gyro), Point (accel), Estimate (fuser), LastReading (course)."""
        raise NotImplementedError

    def adopt(self, common):
        """Goes on from where another stage of the slot was; raises ValueError for what cannot be taken over."""
        raise NotImplementedError


class RateSample(NamedTuple):
    """What a gyro stage is given."""

    rate_rad_s: tuple
    dt_s: float
    # The rate is the value at the interval's end, not its mean.
    instant: bool


class Motion(NamedTuple):
    """What a gyro stage gives, and a fuser is given."""

    # Open loop, at the interval's end.
    attitude: Attitude
    # Of the body over the interval.
    turn: Turn
    # Mean over the interval.
    rate_rad_s: tuple
    dt_s: float


class Inclination(NamedTuple):
    """What an accel stage, which is given the specific force in m/s², gives, and a fuser is given."""

    up: Point
    force_m_s2: tuple
    norm_m_s2: float
    # 1 at |f| = g, 0 where the point is not from this sample.
    trust: float


class Fix(NamedTuple):
    """What a satellite receiver said: velocity east, north, up; None where unknown."""

    velocity_m_s: tuple
    sd_m_s: Optional[float]
    age_s: Optional[float]
    latitude_rad: Optional[float]


class FuserInput(NamedTuple):
    """What a fuser is given: what is None has not come or cannot be used."""

    motion: Optional[Motion]
    inclination: Optional[Inclination]
    field_ut: Optional[tuple]
    fix: Optional[Fix]
    # Gyro and accelerometer are alive, so that stillness means rest.
    rest_credible: bool
    # The motion is what the body did.
    rate_credible: bool


class Fused(NamedTuple):
    """What a fuser gives."""

    attitude: Attitude
    rate_rad_s: tuple
    bias_rad_s: tuple = (0.0, 0.0, 0.0)
    # Angle between the accelerometer's up and the attitude's.
    innovation_rad: float = 0.0
    inclination_sd_rad: float = 0.1
    # π where nothing is known.
    heading_sd_rad: float = math.pi
    reference: int = ARBITRARY
    # The attitude was set anew at this tick.
    aligned: bool = False
    # The body was found to be at rest.
    rest: bool = False
    # The magnetic field is not that of the place.
    disturbed: bool = False


class Estimate(NamedTuple):
    """What every fuser can hand over to every other."""

    attitude: Attitude
    reference: int = ARBITRARY
    bias_rad_s: tuple = (0.0, 0.0, 0.0)
    inclination_sd_rad: float = 0.1
    heading_sd_rad: float = math.pi
    # Infinite where the bias is not estimated.
    bias_sd_rad_s: float = math.inf
    # Of the magnetometer, body axes; infinite where it is not estimated.
    hard_iron_ut: tuple = (0.0, 0.0, 0.0)
    hard_iron_sd_ut: float = math.inf

    def check(self):
        """Raises ValueError for what is no estimate."""
        if not self.attitude.is_sound():
            raise ValueError("an attitude outside its chart")
        if not all(abs(bias) <= 10.0 for bias in self.bias_rad_s):
            raise ValueError("a gyro bias above 10 rad/s")
        if not all(abs(part) <= 1e4 for part in self.hard_iron_ut):
            raise ValueError("a hard iron beyond every magnet")
        sds = (self.inclination_sd_rad, self.heading_sd_rad, self.bias_sd_rad_s, self.hard_iron_sd_ut)
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

    # Body → reference, w x y z, unit; its sign does not jump.
    quaternion: tuple
    yaw_rad: float
    pitch_rad: float
    roll_rad: float
    # Clockwise from above, [0, 2π).
    course_rad: float
    reference: int
    course_sd_rad: float
    near_gimbal: bool = False
    # The course was set anew at this tick.
    aligned: bool = False


class LastReading(NamedTuple):
    """What every course stage can hand over to every other."""

    quaternion: tuple
    # (course_rad, sd_rad, reference), where one was told.
    bearing: Optional[tuple] = None
