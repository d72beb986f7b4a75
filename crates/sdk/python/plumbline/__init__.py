"""Stages for Plumbline in Python.

Derive a class from `Stage`, implement its methods and call `plumbline.run(MyStage)`. The package
needs only Python 3.9 or later. The module `sensor` also needs iceoryx2.

attitude     points, attitudes and rotations, the quantities that stages compute with
values       inputs, outputs and common states of the slots
stage        base class of a stage
program      request loop of a stage's program, which the service of the slot starts
sensor       publishers of sensor readings and fixes to a running system
stage_tests  tests that every stage must pass
"""

from .attitude import Attitude, Point, Quaternion, Rotation, Vector
from .program import run
from .stage import Parameter, Stage
from .values import (
    ARBITRARY, MAGNETIC, TRUE, CourseEstimate, CourseInput, CourseReading, Estimate, Fix, Fused, FuserInput, Inclination, LastReading,
    Motion, RateSample,
)

__all__ = [
    "ARBITRARY", "MAGNETIC", "TRUE", "Attitude", "CourseEstimate", "CourseInput", "CourseReading", "Estimate", "Fix", "Fused",
    "FuserInput", "Inclination", "LastReading", "Motion", "Parameter", "Point", "Quaternion", "RateSample", "Rotation", "Stage", "Vector",
    "run",
]
