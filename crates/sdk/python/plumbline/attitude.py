"""Points, attitudes and rotations, based on the pair (w, z) of Matveev 2025. Angles are in rad.

A point is the up vector in body axes, projected from the pole that is farther away. An attitude is
a point and a rotation z about the vertical. A rotation is a pair of complex numbers (p, s), which
stands for the unit quaternion d0 + d1 i + d2 j + d3 k with p = d0 + j d3 and s = d1 + j d2.
"""

import cmath
import math
from typing import NamedTuple, NewType

# A vector is three numbers, in body axes unless stated otherwise. A quaternion is w, x, y, z.
Vector = NewType("Vector", tuple)
Quaternion = NewType("Quaternion", tuple)

# Maximum |w|², above which the chart changes. The modulus of 1.2 provides hysteresis for attitudes
# near the equator.
MAX_CHART_NORM_SQUARED = 1.44


class Point(NamedTuple):
    """Unit vector in body axes: w is projected from −ζ or, if inverted, from +ζ."""

    inverted: bool = False
    w: complex = 0j

    @staticmethod
    def from_direction(direction):
        """Projects a vector into the chart in which |w| ≤ 1.

        Returns None if the vector is zero or not finite.
        """
        x, y, z = direction
        norm = math.sqrt(x * x + y * y + z * z)
        if not 0.0 < norm < math.inf:
            return None
        sign = 1.0 if z >= 0.0 else -1.0
        return Point(z < 0.0, complex(x, sign * y) / (norm + sign * z))

    def direction(self):
        """Returns the unit vector in body axes."""
        rho, sign = _norm2(self.w), -1.0 if self.inverted else 1.0
        scale = 1.0 / (1.0 + rho)
        return (2.0 * self.w.real * scale, sign * 2.0 * self.w.imag * scale, sign * (1.0 - rho) * scale)


class Rotation(NamedTuple):
    """Rotation of the body in its own axes."""

    p: complex = 1 + 0j
    s: complex = 0j

    @staticmethod
    def from_rotation_vector(x, y, z):
        """Creates the rotation exp(½ φ) from a rotation vector φ (rad, body axes)."""
        angle = math.sqrt(x * x + y * y + z * z)
        half = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
        return Rotation(complex(math.cos(0.5 * angle), half * z), complex(half * x, half * y))

    @staticmethod
    def between(start, end):
        """Returns the rotation from one attitude to another."""
        (a, b, c, d), (e, f, g, h) = start.quaternion(), end.quaternion()
        w, x = a * e + b * f + c * g + d * h, a * f - b * e - c * h + d * g
        y, z = a * g + b * h - c * e - d * f, a * h - b * g + c * f - d * e
        return Rotation(complex(w, z), complex(x, y))


class Attitude(NamedTuple):
    """Attitude of a body.

    It consists of a rotation z about the vertical, followed by the shortest rotation that tilts the
    body to w.
    """

    up: Point = Point()
    z_rad: float = 0.0

    def rotated(self, rotation):
        """Returns the attitude after a rotation of the body.

        w⁺ = (p̄ w + j s)/m, z⁺ = z + 2 arg m, m = p + j s̄ w.
        """
        p, s = rotation
        if self.up.inverted:
            p, s = p.conjugate(), s.conjugate()
        w = self.up.w
        return self._mapped(p.conjugate() * w + 1j * s, p + 1j * s.conjugate() * w)

    def tilted(self, tilt):
        """Returns the attitude after its level frame has been tilted about a horizontal axis.

        w⁺ = (w + l)/m, z⁺ = z + 2 arg m, m = 1 − w̄ l.
        """
        return self._mapped(self.up.w + tilt, 1.0 - self.up.w.conjugate() * tilt)

    def realigned(self, up):
        """Returns the attitude after the shortest tilt that makes `up` the up vector.

        The heading is kept.
        """
        direction, own = up.direction(), self.up.direction()
        vertical = 1.0 + sum(a * b for a, b in zip(direction, own))
        return self.tilted(self.horizontal(direction) / vertical if vertical > 1e-9 else 1e9 + 0j)

    def horizontal(self, body):
        """Returns the horizontal part ξ + j η of a body vector in the level frame.

        The level frame is horizontal, but its heading is arbitrary. Multiply by e^(j z_rad) for
        the part in earth axes, east + j north.
        """
        x, y, z = body
        sign = -1.0 if self.up.inverted else 1.0
        w, plane = self.up.w, complex(x, sign * y)
        return plane - w * (2.0 / (1.0 + _norm2(w)) * (sign * z + w.real * plane.real + w.imag * plane.imag))

    def quaternion(self):
        """Returns the unit quaternion from body to reference, in the order w, x, y, z."""
        first = cmath.rect(1.0 / math.sqrt(1.0 + _norm2(self.up.w)), 0.5 * self.z_rad)
        second = -1j * self.up.w * first
        alpha, beta = (second, -first) if self.up.inverted else (first, second)
        return (alpha.real, beta.real, beta.imag, alpha.imag)

    def angles(self):
        """Returns yaw (counter-clockwise from above), pitch (nose up), roll (right side down)."""
        u, v = self.up.w.real, self.up.w.imag
        rho, sign = u * u + v * v, -1.0 if self.up.inverted else 1.0
        sin, cos = math.sin(self.z_rad), math.cos(self.z_rad)
        level, pitch_rad = math.hypot(2.0 * u, 1.0 - rho), math.atan2(sign * 2.0 * v, math.hypot(2.0 * u, 1.0 - rho))
        if level < 1e-8 * (1.0 + rho):
            # Only the sum or difference of yaw and roll is defined. It is assigned to yaw alone.
            across, north = 1.0 - u * u + v * v, 2.0 * u * v
            return math.atan2(across * sin - north * cos, across * cos + north * sin), pitch_rad, 0.0
        east, north = 1.0 + u * u - v * v, 2.0 * u * v
        yaw_rad = math.atan2(sign * (east * sin + north * cos), sign * (east * cos - north * sin))
        return yaw_rad, pitch_rad, math.atan2(-2.0 * u, sign * (1.0 - rho))

    def validate(self):
        """Raises ValueError if the attitude is outside its chart or not a number."""
        if not (_norm2(self.up.w) <= 2.0 and abs(self.z_rad) <= 4.0):
            raise ValueError("an attitude outside its chart")

    def _mapped(self, numerator, m):
        if _norm2(numerator) > MAX_CHART_NORM_SQUARED * _norm2(m):
            up = Point(not self.up.inverted, m / numerator)
            return Attitude(up, wrapped_rad(self.z_rad + 2.0 * cmath.phase(1j * numerator)))
        return Attitude(Point(self.up.inverted, numerator / m), wrapped_rad(self.z_rad + 2.0 * cmath.phase(m)))


def wrapped_rad(angle_rad):
    """Wraps an angle to (−π, π]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi) if math.isfinite(angle_rad) else math.nan
    return math.pi if wrapped == -math.pi else wrapped


def _norm2(z):
    return z.real * z.real + z.imag * z.imag
