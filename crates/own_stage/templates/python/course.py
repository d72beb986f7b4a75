"""The stage `@name@` for the slot course: angles and course, from the fused attitude."""

import math

import plumbline

# Nearer to the vertical yaw and roll are not told apart.
GIMBAL_RAD = math.radians(89.9)


class @Class@(plumbline.Stage):
    """The course is the fuser's heading, counted clockwise, and the declination."""

    NAME, SLOT = "@name@", "course"
    PARAMETERS = {"declination_deg": (0.0, -180.0, 180.0)}

    def __init__(self):
        self.configure({})
        self.last = plumbline.LastReading((1.0, 0.0, 0.0, 0.0))

    def step(self, input):
        quaternion = input.attitude.quaternion()
        # The other sign is the same attitude, and a jump for whoever interpolates.
        if sum(a * b for a, b in zip(quaternion, self.last.quaternion)) < 0.0:
            quaternion = tuple(-x for x in quaternion)
        yaw_rad, pitch_rad, roll_rad = input.attitude.angles()
        course_rad = (math.radians(self.declination_deg) - yaw_rad) % math.tau % math.tau
        sd_rad = min(input.heading_sd_rad, math.pi) if input.heading_sd_rad >= 0.0 else math.pi
        made_true = input.reference == 1 and self.declination_deg != 0.0
        reference = 2 if made_true else input.reference
        self.last = plumbline.LastReading(quaternion, (course_rad, sd_rad, reference))
        near_gimbal = abs(pitch_rad) > GIMBAL_RAD
        return plumbline.Reading(quaternion, yaw_rad, pitch_rad, roll_rad, course_rad, reference, sd_rad, near_gimbal)

    def snapshot(self):
        return [*self.last.quaternion, float(self.last.bearing is not None), *(self.last.bearing or (0.0, 0.0, 0))]

    def restore(self, values):
        w, x, y, z, told, course_rad, sd_rad, reference = values
        bearing = (course_rad, sd_rad, int(reference)) if told > 0.5 else None
        self.adopt(plumbline.LastReading((w, x, y, z), bearing))

    def common(self):
        return self.last

    def adopt(self, common):
        if not abs(sum(x * x for x in common.quaternion) - 1.0) < 1e-6:
            raise ValueError("a quaternion that is not of unit length")
        if common.bearing and not (0.0 <= common.bearing[0] < math.tau and common.bearing[1] >= 0.0):
            raise ValueError("a course that is none")
        self.last = common


if __name__ == "__main__":
    plumbline.run(@Class@)
