"""Between messages and the values of stages; what every slot has."""

import math

from .attitude import Attitude, Point
from .rules import Sequence
from .stage import Fix

# Longest interval over which two rates still tell how far the body turned, s.
BRIDGE_S = 1.0


class Slot:
    """What messages and a stage are to each other. Each has `INPUTS`, `OUTPUT`, and the formats of its words (`state`)."""

    def has_begun(self, own):
        """What the stage told as common is more than where every stage begins."""
        return True


class EachTick(Slot):
    """A slot with one input: one message out for each message in."""

    def __init__(self, orders, stage):
        self.stage, self.sequence = stage, Sequence()

    def offer(self, message, publish):
        missing = self.sequence.admit(message.header)
        if missing is not None:
            out = self.OUTPUT(header=message.header)
            self.sequence.mark(out.header, missing)
            self.work(message, out)
            publish(out)

    def lacks(self):
        return 0

    def expect_until(self, tick):
        pass


def fix_of(gnss):
    """The fix; None where the velocity is not finite."""
    if gnss is None or not all(map(math.isfinite, gnss.velocity_m_s)):
        return None
    told = [value if math.isfinite(value) else None for value in (gnss.velocity_sd_m_s, gnss.age_s, gnss.latitude_rad)]
    return Fix(tuple(gnss.velocity_m_s), *told)


def norm(vector):
    """Length of a vector."""
    return math.sqrt(sum(x * x for x in vector))


def pair(w):
    """u and v of a point."""
    return (w.real, w.imag)


def put_attitude(out, attitude):
    """Writes an attitude into a message."""
    out.w[:], out.z_rad, out.chart = pair(attitude.up.w), attitude.z_rad, attitude.up.inverted


def point_of(message):
    """The point of a message; None where it is none."""
    u, v = message.w
    if message.chart > 1 or not (math.isfinite(u) and math.isfinite(v)):
        return None
    return Point(complex(u, v), message.chart == 1)


def read_attitude(message):
    """The attitude of a message; None where it is none."""
    up = point_of(message)
    return Attitude(up, message.z_rad) if up and math.isfinite(message.z_rad) else None


def attitude_of(message):
    """The same as a quaternion."""
    attitude = read_attitude(message)
    return attitude and attitude.quaternion()


def flat(attitude):
    """An attitude as the numbers of a checkpoint."""
    return (attitude.up.inverted, *pair(attitude.up.w), attitude.z_rad)


def unflat(values):
    """And back."""
    inverted, u, v, z_rad = values
    return Attitude(Point(complex(u, v), bool(inverted)), z_rad)


def counts(sequence):
    """A stream as the numbers of a checkpoint."""
    return (sequence.next_tick, sequence.ticks, sequence.lost, sequence.duplicated, sequence.repeated)


def set_counts(sequence, own):
    """And back."""
    sequence.next_tick, sequence.ticks, sequence.lost, sequence.duplicated, sequence.repeated = own[:5]
