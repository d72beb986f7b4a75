"""The stage `@name@` for the slot gyro: how the body turned over each interval, from its rate."""

from typing import NamedTuple, Optional

import plumbline

# Faster than any gyro's range; what is beyond it is taken for this.
RATE_MAX_RAD_S = 1000.0


class @Class@(plumbline.Stage):
    """Turns by the mean rate of the interval: exact while the rate is constant."""

    SLOT = "gyro"

    class State(NamedTuple):
        attitude: plumbline.Attitude = plumbline.Attitude()
        before_rad_s: Optional[plumbline.Vector] = None

    def align(self, attitude):
        """Where to integrate from."""
        self.state = self.state._replace(attitude=attitude)

    def step(self, sample):
        after_rad_s = tuple(max(-RATE_MAX_RAD_S, min(RATE_MAX_RAD_S, x)) for x in sample.rate_rad_s)
        # The mean of an interval of which both ends are known is half their sum.
        before_rad_s = self.state.before_rad_s if sample.instant and self.state.before_rad_s else after_rad_s
        mean_rad_s = tuple(0.5 * (a + b) for a, b in zip(before_rad_s, after_rad_s))
        turn = plumbline.Turn.of_rotation_vector(*(x * sample.dt_s for x in mean_rad_s))
        self.state = self.State(self.state.attitude.turned(turn), after_rad_s)
        return plumbline.Motion(self.state.attitude, turn, mean_rad_s, sample.dt_s)

    def check(self, state):
        state.attitude.check()
        if not all(abs(rate) <= RATE_MAX_RAD_S for rate in state.before_rad_s or ()):
            raise ValueError("a rate that no gyro gives")

    def common(self):
        return self.state.attitude

    def adopt(self, common):
        common.check()
        self.state = self.state._replace(attitude=common)


if __name__ == "__main__":
    plumbline.run(@Class@)
