"""The stage `@name@` for the slot gyro: how the body turned over each interval, from its rate."""

import math

import plumbline

# Faster than any gyro's range; what is beyond it is taken for this.
RATE_MAX_RAD_S = 1000.0


class @Class@(plumbline.Stage):
    """Turns by the mean rate of the interval: exact while the rate is constant."""

    NAME, SLOT = "@name@", "gyro"

    def __init__(self):
        self.attitude, self.before_rad_s = plumbline.Attitude(), None

    def align(self, attitude):
        """Where to integrate from."""
        self.attitude = attitude

    def step(self, sample):
        rate_rad_s = tuple(max(-RATE_MAX_RAD_S, min(RATE_MAX_RAD_S, x)) for x in sample.rate_rad_s)
        before_rad_s = self.before_rad_s if sample.instant and self.before_rad_s else rate_rad_s
        mean_rad_s = tuple(0.5 * (a + b) for a, b in zip(before_rad_s, rate_rad_s))
        turn = plumbline.Turn.of_rotation_vector(*(x * sample.dt_s for x in mean_rad_s))
        self.attitude, self.before_rad_s = self.attitude.turned(turn), rate_rad_s
        return plumbline.Motion(self.attitude, turn, mean_rad_s, sample.dt_s)

    def snapshot(self):
        up, z_rad = self.attitude
        before_rad_s = self.before_rad_s or (0.0, 0.0, 0.0)
        return [up.w.real, up.w.imag, float(up.inverted), z_rad, float(self.before_rad_s is not None), *before_rad_s]

    def restore(self, values):
        u, v, inverted, z_rad, started, *before_rad_s = values
        self.adopt(plumbline.Attitude(plumbline.Point(complex(u, v), inverted > 0.5), z_rad))
        self.before_rad_s = tuple(before_rad_s) if started > 0.5 else None

    def common(self):
        return self.attitude

    def adopt(self, common):
        if not (common.is_sound() and math.isfinite(common.z_rad)):
            raise ValueError("an attitude outside its chart")
        self.attitude, self.before_rad_s = common, None


if __name__ == "__main__":
    plumbline.run(@Class@)
