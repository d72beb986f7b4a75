"""The stage `@name@` for the slot accel: where up seems to be, from the specific force."""

import math

import plumbline

GRAVITY_M_S2 = 9.80665


class @Class@(plumbline.Stage):
    """Up is where the force points, trusted as far as the force is as large as gravity."""

    NAME, SLOT = "@name@", "accel"
    PARAMETERS = {"distrusted_g": (0.5, 0.001, 10.0)}

    def __init__(self):
        self.configure({})
        self.up = plumbline.Point()

    def step(self, force_m_s2):
        norm_m_s2 = math.sqrt(sum(min(abs(x), 1e150) ** 2 for x in force_m_s2))
        seen = plumbline.Point.of(force_m_s2)
        self.up = seen or self.up
        off_g = abs(norm_m_s2 / GRAVITY_M_S2 - 1.0)
        trust = max(0.0, 1.0 - off_g / self.distrusted_g) if seen else 0.0
        return plumbline.Inclination(self.up, force_m_s2, norm_m_s2, trust)

    def snapshot(self):
        return [self.up.w.real, self.up.w.imag, float(self.up.inverted)]

    def restore(self, values):
        u, v, inverted = values
        self.adopt(plumbline.Point(complex(u, v), inverted > 0.5))

    def common(self):
        return self.up

    def adopt(self, common):
        if not abs(common.w) <= 1.2:
            raise ValueError("a point outside its chart")
        self.up = common


if __name__ == "__main__":
    plumbline.run(@Class@)
