"""The class that a stage is made of."""

from typing import NamedTuple

from .attitude import Attitude, Point, Vector
from .values import CourseInput, Estimate, Fused, FuserInput, Inclination, LastReading, Motion, RateSample, Reading, codec, numbers_of

# Of each slot: what a stage is given, what it gives, and what every stage can go on with from every other.
SLOTS = {
    "gyro": (RateSample, Motion, Attitude),
    "accel": (Vector, Inclination, Point),
    "fuser": (FuserInput, Fused, Estimate),
    "course": (CourseInput, Reading, LastReading),
}


class Parameter(NamedTuple):
    """A number by which a stage can be set; it becomes an attribute of the stage."""

    name: str  # with its unit last, as in time_constant_s
    unit: str
    least: float
    most: float
    default: float
    meaning: str


class Stage:
    """A plain value: parameters and state, one tick's input in, one output out. It reads no clock.

    `self.state` holds every number that the next output depends on: from it the next incarnation goes on bit for bit.
    """

    SLOT = ""  # "gyro", "accel", "fuser" or "course"
    PARAMETERS = ()

    class State(NamedTuple):
        """What it keeps from tick to tick; every field with its kind and what it is at the beginning."""

    def __init__(self):
        self.state = self.State()
        for parameter in self.PARAMETERS:
            setattr(self, parameter.name, parameter.default)

    def step(self, input):
        """One tick. An exception is no output: the stage begins anew, and the tick says so."""
        raise NotImplementedError

    def check(self, state):
        """Raises ValueError for numbers that are no state."""

    def common(self):
        """What every stage of the slot can go on with: Attitude (gyro), Point (accel), Estimate (fuser), LastReading (course)."""
        raise NotImplementedError

    def adopt(self, common):
        """Goes on from where another stage of the slot was; raises ValueError for what cannot be taken over."""
        raise NotImplementedError

    def set(self, place, value):
        """Sets a parameter by its place; raises ValueError for a value outside its range."""
        parameter = self.PARAMETERS[place]
        if not parameter.least <= value <= parameter.most:
            raise ValueError(f"{parameter.name}: {value} is outside {parameter.least} to {parameter.most}")
        setattr(self, parameter.name, value)

    def snapshot(self):
        """The state as numbers, always as many."""
        return numbers_of(self.state)

    def restore(self, numbers):
        """Takes over what `snapshot` gave; raises ValueError for what is no state, and leaves the stage as it was."""
        count, read, _ = codec(self.State)
        if len(numbers) != count:
            raise ValueError(f"{len(numbers)} numbers, expected {count}")
        state = read(iter(numbers))
        self.check(state)
        self.state = state
