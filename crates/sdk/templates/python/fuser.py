"""Stage `@name@` for the slot fuser: the attitude, from gyro and accelerometer."""

import math
from typing import NamedTuple

import plumbline


class @Class@(plumbline.Stage):
    """Complementary filter.

    The attitude follows the gyro. Each tick corrects a fraction 1 − e^{−dt/T} of the tilt
    difference from the accelerometer.
    """

    SLOT = "fuser"
    PARAMETERS = [
        plumbline.Parameter(
            "time_constant_s", "s", 0.01, 1000.0, 1.0, "Time constant of the correction of the tilt towards the accelerometer."
        ),
    ]

    class State(NamedTuple):
        attitude: plumbline.Attitude = plumbline.Attitude()
        started: bool = False

    def step(self, input):
        attitude, started = self.state
        dt_s, rate_rad_s, innovation_rad, tilt, aligned = 0.0, (0.0, 0.0, 0.0), 0.0, False, False
        if input.motion:
            attitude = attitude.rotated(input.motion.rotation)
            dt_s, rate_rad_s = input.motion.dt_s, input.motion.rate_rad_s
        if input.inclination:
            direction, own = input.inclination.up.direction(), attitude.up.direction()
            vertical = 1.0 + sum(a * b for a, b in zip(direction, own))
            if not started:
                attitude = attitude.realigned(input.inclination.up)
                started = aligned = True
            elif vertical > 1e-6:
                tilt_error = attitude.horizontal(direction) / vertical
                innovation_rad = 2.0 * math.atan(abs(tilt_error))
                attitude = attitude.tilted(tilt_error * -math.expm1(-dt_s / self.time_constant_s))
                tilt = True
        self.state = self.State(attitude, started)
        return plumbline.Fused(attitude, rate_rad_s, innovation_rad=innovation_rad, tilt=tilt, aligned=aligned)

    def realign(self):
        """Re-initialises the level from the next inclination, for example after a data gap."""
        self.state = self.state._replace(started=False)

    def validate(self, state):
        state.attitude.validate()

    def common(self):
        return plumbline.Estimate(self.state.attitude)

    def adopt(self, common):
        common.validate()
        self.state = self.State(common.attitude, True)


if __name__ == "__main__":
    plumbline.run(@Class@)
