"""What every stage must be able to do, as tests: `class MyTest(Checks, unittest.TestCase)` with `stage = MyStage`.

It is what can be said without Plumbline; `plumb stage test` says the rest.
"""

import math

from .attitude import Attitude, Point, Turn
from .values import CourseInput, Estimate, FuserInput, Inclination, LastReading, Motion, RateSample, numbers_of

_DT_S = 0.01
_GRAVITY_M_S2 = 9.80665


def inputs(slot, ticks=1000):
    """(input, true attitude) of each tick, of a body that turns about all its axes, through the inverted attitude, with exact sensors."""
    attitude = Attitude()
    for tick in range(ticks):
        t_s, dt_s = tick * _DT_S, (_DT_S if tick else 0.0)
        rate = (1.5 * math.sin(0.7 * t_s), 1.0 * math.cos(0.4 * t_s), 0.5)
        turn = Turn.of_rotation_vector(*(component * dt_s for component in rate))
        attitude = attitude.turned(turn)
        force = tuple(_GRAVITY_M_S2 * component for component in attitude.up.direction())
        # Now and then something has not come.
        motion = None if tick % 97 == 50 else Motion(attitude, turn, rate, dt_s)
        seen = None if tick % 10 == 5 else Inclination(Point.of(force), force, _GRAVITY_M_S2, 1.0)
        yield {
            "gyro": RateSample(rate, dt_s, False),
            "accel": force,
            "fuser": FuserInput(motion, seen),
            "course": CourseInput(attitude, 1, 0.1, None, dt_s),
        }[slot], attitude


class Checks:
    """The tests."""

    stage = None

    def setUp(self):
        self.given = [one for one, _ in inputs(self.stage.SLOT)]

    def _run(self, stage, given):
        return [numbers_of(stage.step(one)) for one in given]

    def test_outputs_are_finite(self):
        for tick, numbers in enumerate(self._run(self.stage(), self.given)):
            self.assertTrue(all(map(math.isfinite, numbers)), f"tick {tick}: {numbers}")

    def test_two_runs_give_the_same_bits(self):
        self.assertEqual(self._run(self.stage(), self.given), self._run(self.stage(), self.given))

    def test_a_run_goes_on_from_a_snapshot_bit_for_bit(self):
        for at in (0, 1, 7, 500):
            stage, fresh = self.stage(), self.stage()
            self._run(stage, self.given[:at])
            fresh.restore(stage.snapshot())
            self.assertEqual(self._run(stage, self.given[at:]), self._run(fresh, self.given[at:]), f"after {at} ticks")

    def test_what_is_outside_a_range_is_refused(self):
        for place, parameter in enumerate(self.stage.PARAMETERS):
            for value in (math.nan, parameter.least - 1.0, parameter.most + 1.0):
                with self.assertRaises(ValueError):
                    self.stage().set(place, value)

    def test_what_cannot_be_is_not_taken_over(self):
        bad = Attitude(Point(False, complex(math.nan, 0.0)), 0.0)
        garbage = {"gyro": bad, "accel": bad.up, "fuser": Estimate(bad), "course": LastReading((0.0,) * 4)}
        with self.assertRaises(ValueError):
            self.stage().adopt(garbage[self.stage.SLOT])
