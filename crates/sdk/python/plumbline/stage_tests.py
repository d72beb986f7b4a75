"""Tests that every stage must pass.

To use them, define `class MyTest(StageTests, unittest.TestCase)` with `stage = MyStage`. They run
without Plumbline. `plumb stage test` runs the complete conformance checks.
"""

import math

from .attitude import Attitude, Point, Rotation
from .values import CourseInput, Estimate, FuserInput, Inclination, LastReading, Motion, RateSample, numbers_of

_INTERVAL_S = 0.01
_GRAVITY_M_S2 = 9.80665


def inputs(slot, ticks=1000):
    """Yields the input and the true attitude of each tick, with exact sensors.

    The body rotates about all axes and passes through the inverted attitude.
    """
    attitude = Attitude()
    for tick in range(ticks):
        t_s, dt_s = tick * _INTERVAL_S, (_INTERVAL_S if tick else 0.0)
        rate = (1.5 * math.sin(0.7 * t_s), 1.0 * math.cos(0.4 * t_s), 0.5)
        rotation = Rotation.from_rotation_vector(*(component * dt_s for component in rate))
        attitude = attitude.rotated(rotation)
        force = tuple(_GRAVITY_M_S2 * component for component in attitude.up.direction())
        # Some inputs are missing.
        motion = None if tick % 97 == 50 else Motion(attitude, rotation, rate, dt_s)
        inclination = None if tick % 10 == 5 else Inclination(Point.from_direction(force), force, _GRAVITY_M_S2, 1.0)
        yield {
            "gyro": RateSample(rate, dt_s, False),
            "accel": force,
            "fuser": FuserInput(motion, inclination),
            "course": CourseInput(attitude, 1, 0.1, None, dt_s),
        }[slot], attitude


class StageTests:
    """Mix-in for a `unittest.TestCase`. The subclass sets `stage` to the class of the stage."""

    stage = None

    def setUp(self):
        self.inputs = [value for value, _ in inputs(self.stage.SLOT)]

    def _run(self, stage, stage_inputs):
        return [numbers_of(stage.step(value)) for value in stage_inputs]

    def test_outputs_are_finite(self):
        for tick, numbers in enumerate(self._run(self.stage(), self.inputs)):
            self.assertTrue(all(map(math.isfinite, numbers)), f"tick {tick}: {numbers}")

    def test_two_runs_are_bit_identical(self):
        self.assertEqual(self._run(self.stage(), self.inputs), self._run(self.stage(), self.inputs))

    def test_restored_run_is_bit_identical(self):
        for at in (0, 1, 7, 500):
            stage, restored = self.stage(), self.stage()
            self._run(stage, self.inputs[:at])
            restored.restore(stage.snapshot())
            self.assertEqual(self._run(stage, self.inputs[at:]), self._run(restored, self.inputs[at:]), f"after {at} ticks")

    def test_values_out_of_range_are_rejected(self):
        for index, parameter in enumerate(self.stage.PARAMETERS):
            for value in (math.nan, parameter.min - 1.0, parameter.max + 1.0):
                with self.assertRaises(ValueError):
                    self.stage().set(index, value)

    def test_invalid_common_state_is_rejected(self):
        invalid = Attitude(Point(False, complex(math.nan, 0.0)), 0.0)
        common = {"gyro": invalid, "accel": invalid.up, "fuser": Estimate(invalid), "course": LastReading((0.0,) * 4)}
        with self.assertRaises(ValueError):
            self.stage().adopt(common[self.stage.SLOT])
