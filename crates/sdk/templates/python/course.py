"""Stage `@name@` for the slot course: angles and course, from the fused attitude."""

import math
from typing import NamedTuple

import plumbline

# Pitch beyond which yaw and roll cannot be separated.
GIMBAL_RAD = math.radians(89.0)


class @Class@(plumbline.Stage):
    """The course is the fuser's heading, measured clockwise.

    The declination is added if the heading is magnetic.
    """

    SLOT = "course"
    PARAMETERS = [
        plumbline.Parameter(
            "declination_deg",
            "°",
            -180.0,
            180.0,
            0.0,
            "Magnetic declination, east positive. It converts a magnetic course to a true one.",
        ),
    ]

    class State(NamedTuple):
        last: plumbline.LastReading = plumbline.LastReading()

    def step(self, input):
        is_corrected = input.reference == plumbline.MAGNETIC and self.declination_deg != 0.0
        declination_rad = math.radians(self.declination_deg) if is_corrected else 0.0
        reference = plumbline.TRUE if is_corrected else input.reference
        yaw_rad, pitch_rad, roll_rad = input.attitude.angles()
        course_rad = (declination_rad - yaw_rad) % math.tau % math.tau
        sd_rad = min(input.heading_sd_rad, math.pi) if input.heading_sd_rad >= 0.0 else math.pi
        previous, quaternion = self.state.last, input.attitude.quaternion()
        # The sign is kept continuous, because a change of sign would break interpolation.
        if sum(a * b for a, b in zip(quaternion, previous.quaternion)) < 0.0:
            quaternion = tuple(-x for x in quaternion)
        aligned = previous.course is not None and previous.course.reference != reference
        course = plumbline.CourseEstimate(course_rad, reference, sd_rad)
        self.state = self.State(plumbline.LastReading(quaternion, course))
        near_gimbal = abs(pitch_rad) > GIMBAL_RAD
        return plumbline.CourseReading(
            yaw_rad, pitch_rad, roll_rad, course_rad, reference, sd_rad, declination_rad, quaternion, near_gimbal, aligned
        )

    def validate(self, state):
        state.last.validate()

    def common(self):
        return self.state.last

    def adopt(self, common):
        common.validate()
        self.state = self.State(common)


if __name__ == "__main__":
    plumbline.run(@Class@)
