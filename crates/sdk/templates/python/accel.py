"""The stage `@name@` for the slot accel: where up seems to be, from the specific force."""

import math
from typing import NamedTuple

import plumbline

GRAVITY_M_S2 = 9.80665
# Below this the direction of the force is noise.
FORCE_MIN_M_S2 = 0.5


class @Class@(plumbline.Stage):
    """Up is where the force points, trusted as far as the force is as large as gravity."""

    SLOT = "accel"
    PARAMETERS = [
        plumbline.Parameter("distrusted_g", "g", 0.001, 10.0, 0.5, "Difference from gravity at which a force is no longer trusted."),
    ]

    class State(NamedTuple):
        up: plumbline.Point = plumbline.Point()

    def step(self, force_m_s2):
        norm_m_s2 = math.hypot(*force_m_s2)
        seen = plumbline.Point.of(force_m_s2) if norm_m_s2 >= FORCE_MIN_M_S2 else None
        self.state = self.State(seen or self.state.up)
        off_g = abs(norm_m_s2 / GRAVITY_M_S2 - 1.0)
        trust = max(0.0, 1.0 - off_g / self.distrusted_g) if seen else 0.0
        return plumbline.Inclination(self.state.up, force_m_s2, min(norm_m_s2, 1e300), trust)

    def check(self, state):
        plumbline.Attitude(state.up).check()

    def common(self):
        return self.state.up

    def adopt(self, common):
        plumbline.Attitude(common).check()
        self.state = self.State(common)


if __name__ == "__main__":
    plumbline.run(@Class@)
