"""Stages for Plumbline in Python: a class with `step`, and `plumbline.run(Class)`. It needs nothing but Python; `sensor` needs iceoryx2, too.

attitude   points, attitudes and turns: the quantities that stages work on
values     what a stage of each slot is given and gives back
stage      the class that a stage is made of
program    answering the service that hosts the stage
sensor     readings of a sensor of your own for a running system
trial      what every stage must be able to do, as tests
"""

from .attitude import Attitude, Point, Quaternion, Turn, Vector
from .program import run
from .stage import Parameter, Stage
from .values import (
    ARBITRARY, MAGNETIC, TRUE, Bearing, CourseInput, Estimate, Fix, Fused, FuserInput, Inclination, LastReading, Motion, RateSample, Reading,
)

__all__ = [
    "ARBITRARY", "MAGNETIC", "TRUE", "Attitude", "Bearing", "CourseInput", "Estimate", "Fix", "Fused", "FuserInput", "Inclination",
    "LastReading", "Motion", "Parameter", "Point", "Quaternion", "RateSample", "Reading", "Stage", "Turn", "Vector", "run",
]
