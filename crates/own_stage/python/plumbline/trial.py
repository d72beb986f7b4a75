"""What every stage must be able to do, as tests: `class MyTest(Checks, unittest.TestCase)` with `stage = MyStage`."""

import math

from .attitude import Attitude, Point, Turn
from .stage import CourseInput, Estimate, FuserInput, Inclination, LastReading, Motion, RateSample

_DT_S = 0.01
_TICKS = 1000
_GRAVITY_M_S2 = 9.80665


def _body():
    """A body that turns about all its axes, through the inverted attitude: at each tick its attitude, rate and turn."""
    attitude = Attitude()
    for tick in range(_TICKS):
        t_s = tick * _DT_S
        rate = (1.5 * math.sin(0.7 * t_s), 1.0 * math.cos(0.4 * t_s), 0.5)
        turn = Turn.of_rotation_vector(*(component * _DT_S for component in rate)) if tick else Turn()
        attitude = attitude.turned(turn)
        yield attitude, rate, turn


def inputs(slot):
    """(input, true attitude) of each tick, as a stage of the slot is given them, with exact sensors."""
    for place, (attitude, rate, turn) in enumerate(_body()):
        dt_s, up = (_DT_S if place else 0.0), attitude.up
        force = tuple(_GRAVITY_M_S2 * component for component in up.direction())
        if slot == "gyro":
            yield RateSample(rate, dt_s, False), attitude
        elif slot == "accel":
            yield force, attitude
        elif slot == "fuser":
            motion = Motion(attitude, turn, rate, dt_s)
            seen = Inclination(Point.of(force), force, _GRAVITY_M_S2, 1.0)
            # Now and then something has not come.
            motion, seen = (None if place % 97 == 50 else motion), (None if place % 10 == 5 else seen)
            yield FuserInput(motion, seen, None, None, True, True), attitude
        else:
            yield CourseInput(attitude, 0, 0.1, None, dt_s), attitude


def _numbers(value):
    """Every number of an output."""
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return [] if value is None else [float(value)]


class Checks:
    """The tests."""

    stage = None

    def _run(self, stage, given):
        return [_numbers(stage.step(one)) for one, _ in given]

    def setUp(self):
        self.given = list(inputs(self.stage.SLOT))

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

    def test_what_is_no_parameter_is_refused(self):
        for settings in ({"no_such_parameter": 1.0}, *({name: math.nan} for name in self.stage.PARAMETERS)):
            with self.assertRaises(ValueError):
                self.stage().configure(settings)

    def test_another_stage_goes_on_where_this_one_was(self):
        stage, other = self.stage(), self.stage()
        self._run(stage, self.given[:500])
        other.adopt(stage.common())
        before, after = stage.step(self.given[500][0]), other.step(self.given[500][0])
        if self.stage.SLOT == "fuser":
            turn = Turn.between(before.attitude, after.attitude)
            self.assertLess(2.0 * math.hypot(abs(turn.s), turn.p.imag), math.radians(0.5))

    def test_what_cannot_be_is_not_taken_over(self):
        bad = Attitude(Point(complex(math.nan, 0.0)), 0.0)
        garbage = {"gyro": bad, "accel": bad.up, "fuser": Estimate(bad), "course": LastReading((0.0,) * 4)}
        with self.assertRaises(ValueError):
            self.stage().adopt(garbage[self.stage.SLOT])
