"""Stage `@name@` for the slot gyro: the rotation of the body over each interval, from its rate."""

from typing import NamedTuple, Optional

import plumbline

# Limit to which rates are clamped. It is above the range of any gyro.
MAX_RATE_RAD_S = 1000.0


class @Class@(plumbline.Stage):
    """Rotates the attitude by the mean rate over each interval, exact if the rate is constant."""

    SLOT = "gyro"

    class State(NamedTuple):
        attitude: plumbline.Attitude = plumbline.Attitude()
        previous_rad_s: Optional[plumbline.Vector] = None

    def align(self, attitude):
        """Sets the attitude from which to integrate."""
        self.state = self.state._replace(attitude=attitude)

    def step(self, sample):
        end_rad_s = tuple(max(-MAX_RATE_RAD_S, min(MAX_RATE_RAD_S, x)) for x in sample.rate_rad_s)
        # If the rate is known at both ends of the interval, the mean is half their sum.
        start_rad_s = self.state.previous_rad_s if sample.instant and self.state.previous_rad_s else end_rad_s
        mean_rad_s = tuple(0.5 * (a + b) for a, b in zip(start_rad_s, end_rad_s))
        rotation = plumbline.Rotation.from_rotation_vector(*(x * sample.dt_s for x in mean_rad_s))
        self.state = self.State(self.state.attitude.rotated(rotation), end_rad_s)
        return plumbline.Motion(self.state.attitude, rotation, mean_rad_s, sample.dt_s)

    def validate(self, state):
        state.attitude.validate()
        if not all(abs(rate) <= MAX_RATE_RAD_S for rate in state.previous_rad_s or ()):
            raise ValueError("a rate above 1000 rad/s")

    def common(self):
        return self.state.attitude

    def adopt(self, common):
        common.validate()
        self.state = self.state._replace(attitude=common)


if __name__ == "__main__":
    plumbline.run(@Class@)
