"""The stage `@name@` for the slot fuser: where up is, from the gyro's motion and the accelerometer's direction."""

import math

import plumbline


class @Class@(plumbline.Stage):
    """Turns with the gyro and leans towards the accelerometer, by 1 − e^{−dt/T} of the way at each tick."""

    NAME, SLOT = "@name@", "fuser"
    PARAMETERS = {"time_constant_s": (2.0, 0.01, 1000.0)}

    def __init__(self):
        self.configure({})
        self.attitude, self.started = plumbline.Attitude(), False

    def step(self, input):
        dt_s, rate_rad_s, innovation_rad, aligned = 0.0, (0.0, 0.0, 0.0), 0.0, False
        if input.motion:
            self.attitude = self.attitude.turned(input.motion.turn)
            dt_s, rate_rad_s = input.motion.dt_s, input.motion.rate_rad_s
        if input.inclination:
            seen, own = input.inclination.up.direction(), self.attitude.up.direction()
            vertical = 1.0 + sum(a * b for a, b in zip(seen, own))
            if self.started and vertical > 1e-6:
                lean = self.attitude.horizontal(seen) / vertical
                innovation_rad = 2.0 * math.atan(abs(lean))
                self.attitude = self.attitude.leaned(lean * -math.expm1(-dt_s / self.time_constant_s))
            elif not self.started:
                self.attitude = self.attitude.realigned(input.inclination.up)
                self.started = aligned = True
        return plumbline.Fused(self.attitude, rate_rad_s, innovation_rad=innovation_rad, aligned=aligned)

    def realign(self):
        """After a gap in which the body may have turned anywhere: the next inclination sets the level anew."""
        self.started = False

    def snapshot(self):
        up, z_rad = self.attitude
        return [up.w.real, up.w.imag, float(up.inverted), z_rad, float(self.started)]

    def restore(self, values):
        u, v, inverted, z_rad, started = values
        attitude = plumbline.Attitude(plumbline.Point(complex(u, v), inverted > 0.5), z_rad)
        if not attitude.is_sound():
            raise ValueError("an attitude outside its chart")
        self.attitude, self.started = attitude, started > 0.5

    def common(self):
        return plumbline.Estimate(self.attitude)

    def adopt(self, common):
        common.check()
        self.attitude, self.started = common.attitude, True


if __name__ == "__main__":
    plumbline.run(@Class@)
