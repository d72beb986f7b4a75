"""The stage `@name@` for the slot fuser: where up is, from the gyro's motion and the accelerometer's direction."""

import math
from typing import NamedTuple

import plumbline


class @Class@(plumbline.Stage):
    """Turns with the gyro and leans towards the accelerometer, by 1 − e^{−dt/T} of the way at each tick."""

    SLOT = "fuser"
    PARAMETERS = [
        plumbline.Parameter(
            "time_constant_s", "s", 0.01, 1000.0, 1.0, "What is faster comes from the gyro, what is slower from the accelerometer."
        ),
    ]

    class State(NamedTuple):
        attitude: plumbline.Attitude = plumbline.Attitude()
        started: bool = False

    def step(self, input):
        attitude, started = self.state
        dt_s, rate_rad_s, innovation_rad, tilt, aligned = 0.0, (0.0, 0.0, 0.0), 0.0, False, False
        if input.motion:
            attitude = attitude.turned(input.motion.turn)
            dt_s, rate_rad_s = input.motion.dt_s, input.motion.rate_rad_s
        if input.inclination:
            seen, own = input.inclination.up.direction(), attitude.up.direction()
            vertical = 1.0 + sum(a * b for a, b in zip(seen, own))
            if not started:
                attitude = attitude.realigned(input.inclination.up)
                started = aligned = True
            elif vertical > 1e-6:
                lean = attitude.horizontal(seen) / vertical
                innovation_rad = 2.0 * math.atan(abs(lean))
                attitude = attitude.leaned(lean * -math.expm1(-dt_s / self.time_constant_s))
                tilt = True
        self.state = self.State(attitude, started)
        return plumbline.Fused(attitude, rate_rad_s, innovation_rad=innovation_rad, tilt=tilt, aligned=aligned)

    def realign(self):
        """After a gap in which the body may have turned anywhere: the next inclination sets the level anew."""
        self.state = self.state._replace(started=False)

    def check(self, state):
        state.attitude.check()

    def common(self):
        return plumbline.Estimate(self.state.attitude)

    def adopt(self, common):
        common.check()
        self.state = self.State(common.attitude, True)


if __name__ == "__main__":
    plumbline.run(@Class@)
