"""Base class of a stage."""

from typing import NamedTuple

from .attitude import Attitude, Point, Vector
from .values import CourseInput, CourseReading, Estimate, Fused, FuserInput, Inclination, LastReading, Motion, RateSample, codec, numbers_of

# Input, output and common state of each slot.
SLOTS = {
    "gyro": (RateSample, Motion, Attitude),
    "accel": (Vector, Inclination, Point),
    "fuser": (FuserInput, Fused, Estimate),
    "course": (CourseInput, CourseReading, LastReading),
}


class Parameter(NamedTuple):
    """Adjustable parameter. The stage reads its value from an attribute with the same name."""

    name: str  # with the unit as its suffix, as in time_constant_s
    unit: str  # empty for a dimensionless number
    min: float
    max: float
    default: float
    description: str  # in one sentence


class Stage:
    """Estimator for a slot. It returns one output per input and reads no clock.

    `self.state` must contain every number on which the next output depends. A restarted process
    continues from this state bit for bit.
    """

    SLOT = ""  # "gyro", "accel", "fuser" or "course"
    PARAMETERS = ()

    class State(NamedTuple):
        """State between two ticks. Every field has a type and an initial value."""

    def __init__(self):
        self.state = self.State()
        for parameter in self.PARAMETERS:
            setattr(self, parameter.name, parameter.default)

    def step(self, input):
        """Processes the input of one tick.

        If it raises an exception, the stage is reset and the tick is flagged.
        """
        raise NotImplementedError

    def validate(self, state):
        """Raises ValueError if `state` is invalid."""

    def common(self):
        """Returns the state that another stage of the slot can adopt.

        Its type is Attitude (gyro), Point (accel), Estimate (fuser) or LastReading (course).
        """
        raise NotImplementedError

    def adopt(self, common):
        """Continues from the common state of another stage of the slot.

        Raises ValueError if the state is invalid.
        """
        raise NotImplementedError

    def set(self, index, value):
        """Sets the parameter with this index. Raises ValueError if the value is out of range."""
        parameter = self.PARAMETERS[index]
        if not parameter.min <= value <= parameter.max:
            raise ValueError(f"{parameter.name}: expected {parameter.min} to {parameter.max}, found {value}")
        setattr(self, parameter.name, value)

    def snapshot(self):
        """Returns the numbers of the state. Their count is constant."""
        return numbers_of(self.state)

    def restore(self, numbers):
        """Restores the state from the numbers of `snapshot`.

        Raises ValueError and leaves the stage unchanged if the numbers are invalid.
        """
        count, read, _ = codec(self.State)
        if len(numbers) != count:
            raise ValueError(f"found {len(numbers)} values, expected {count}")
        state = read(iter(numbers))
        self.validate(state)
        self.state = state
