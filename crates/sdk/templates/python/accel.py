"""Stage `@name@` for the slot accel: the measured up direction, from the specific force."""

import math
from typing import NamedTuple

import plumbline

GRAVITY_M_S2 = 9.80665
# Smallest usable force. The direction of a smaller force is only noise.
MIN_FORCE_M_S2 = 0.5


class @Class@(plumbline.Stage):
    """Up is the direction of the force. The trust decreases with the difference from gravity."""

    SLOT = "accel"
    PARAMETERS = [
        plumbline.Parameter(
            "zero_trust_difference_g", "g", 0.001, 10.0, 0.5, "Difference from gravity at which the trust in a force is zero."
        ),
    ]

    class State(NamedTuple):
        up: plumbline.Point = plumbline.Point()

    def step(self, force_m_s2):
        norm_m_s2 = math.hypot(*force_m_s2)
        up = plumbline.Point.from_direction(force_m_s2) if norm_m_s2 >= MIN_FORCE_M_S2 else None
        self.state = self.State(up or self.state.up)
        difference_g = abs(norm_m_s2 / GRAVITY_M_S2 - 1.0)
        trust = max(0.0, 1.0 - difference_g / self.zero_trust_difference_g) if up else 0.0
        return plumbline.Inclination(self.state.up, force_m_s2, min(norm_m_s2, 1e300), trust)

    def validate(self, state):
        plumbline.Attitude(state.up).validate()

    def common(self):
        return self.state.up

    def adopt(self, common):
        plumbline.Attitude(common).validate()
        self.state = self.State(common)


if __name__ == "__main__":
    plumbline.run(@Class@)
