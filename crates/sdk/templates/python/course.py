"""The stage `@name@` for the slot course: angles and course, from the fused attitude."""

import math
from typing import NamedTuple

import plumbline

# Nearer to the vertical yaw and roll are not told apart.
GIMBAL_RAD = math.radians(89.0)


class @Class@(plumbline.Stage):
    """The course is the fuser's heading, counted clockwise, and the declination where it is magnetic."""

    SLOT = "course"
    PARAMETERS = [
        plumbline.Parameter(
            "declination_deg", "°", -180.0, 180.0, 0.0, "Magnetic declination, east positive: makes a magnetic course a true one."
        ),
    ]

    class State(NamedTuple):
        last: plumbline.LastReading = plumbline.LastReading()

    def step(self, input):
        made_true = input.reference == plumbline.MAGNETIC and self.declination_deg != 0.0
        declination_rad = math.radians(self.declination_deg) if made_true else 0.0
        reference = plumbline.TRUE if made_true else input.reference
        yaw_rad, pitch_rad, roll_rad = input.attitude.angles()
        course_rad = (declination_rad - yaw_rad) % math.tau % math.tau
        sd_rad = min(input.heading_sd_rad, math.pi) if input.heading_sd_rad >= 0.0 else math.pi
        before, quaternion = self.state.last, input.attitude.quaternion()
        # The other sign is the same attitude, and a jump for whoever interpolates.
        if sum(a * b for a, b in zip(quaternion, before.quaternion)) < 0.0:
            quaternion = tuple(-x for x in quaternion)
        aligned = before.bearing is not None and before.bearing.reference != reference
        self.state = self.State(plumbline.LastReading(quaternion, plumbline.Bearing(course_rad, reference, sd_rad)))
        near_gimbal = abs(pitch_rad) > GIMBAL_RAD
        return plumbline.Reading(
            yaw_rad, pitch_rad, roll_rad, course_rad, reference, sd_rad, declination_rad, quaternion, near_gimbal, aligned
        )

    def check(self, state):
        state.last.check()

    def common(self):
        return self.state.last

    def adopt(self, common):
        common.check()
        self.state = self.State(common)


if __name__ == "__main__":
    plumbline.run(@Class@)
