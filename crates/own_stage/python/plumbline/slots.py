"""The other slots: from messages to a stage's input, and from its output to a message."""

import math
from collections import deque

from . import messages
from .attitude import Attitude, Point, Turn
from .fuser import FuserSlot
from .messages import Flag
from .rules import Beside, Sequence
from .stage import CourseInput, LastReading, RateSample
from .values import (
    BRIDGE_S,
    EachTick,
    Slot,
    attitude_of,
    counts,
    fix_of,
    flat,
    norm,
    pair,
    point_of,
    put_attitude,
    read_attitude,
    set_counts,
    unflat,
)

# Below this a force has no direction, m/s².
FORCE_MIN_M_S2 = 0.5


class GyroSlot(EachTick):
    """From `imu` to `gyro`. The stage also has `align(attitude)`: where to integrate from."""

    INPUTS, OUTPUT = (messages.ImuSample,), messages.GyroStep
    OWN, COMMON = "<5Q QQq", "<Qddd"

    def __init__(self, orders, stage):
        super().__init__(orders, stage)
        self.aligned, self.t_end_ns = False, None

    def work(self, imu, out):
        header = out.header
        before_ns = header.t_start_ns if self.t_end_ns is None else self.t_end_ns
        self.t_end_ns = header.t_end_ns
        dt_s = (header.t_end_ns - before_ns) * 1e-9
        sample = RateSample(tuple(imu.rate_rad_s), dt_s if dt_s <= BRIDGE_S else 0.0, bool(header.flags & Flag.RATE_INSTANT))
        motion = self.stage.step(sample)
        attitude = motion.attitude
        force = tuple(imu.force_m_s2)
        up = Point.of(force) if norm(force) >= FORCE_MIN_M_S2 else None
        if not self.aligned and up and not header.flags & (Flag.FORCE_INVALID | Flag.FORCE_SMALL):
            self.stage.align(Attitude(up))
            self.aligned, attitude = True, self.stage.common()
        put_attitude(out, attitude)
        out.p[:], out.s[:] = pair(motion.turn.p), pair(motion.turn.s)
        out.rate_rad_s[:] = motion.rate_rad_s

    def attitude(self, out):
        return attitude_of(out)

    def own(self):
        return (*counts(self.sequence), self.aligned, self.t_end_ns is not None, self.t_end_ns or 0)

    def set_own(self, own):
        set_counts(self.sequence, own)
        self.aligned, self.t_end_ns = bool(own[5]), own[7] if own[6] else None

    def common_values(self):
        return flat(self.stage.common())

    def adopt_values(self, values):
        self.stage.adopt(unflat(values))


class AccelSlot(EachTick):
    """From `imu` to `accel`."""

    INPUTS, OUTPUT = (messages.ImuSample,), messages.AccelPoint
    OWN, COMMON = "<5Q", "<Qdd"

    def work(self, imu, out):
        seen = self.stage.step(tuple(imu.force_m_s2))
        out.header.flags |= Flag.FORCE_SMALL if seen.norm_m_s2 < FORCE_MIN_M_S2 else 0
        out.w[:], out.chart = pair(seen.up.w), seen.up.inverted
        out.norm_m_s2, out.trust, out.force_m_s2 = seen.norm_m_s2, seen.trust, imu.force_m_s2

    def attitude(self, out):
        up = point_of(out)
        return up and Attitude(up).quaternion()

    def own(self):
        return counts(self.sequence)

    def set_own(self, own):
        set_counts(self.sequence, own)

    def common_values(self):
        up = self.stage.common()
        return (up.inverted, *pair(up.w))

    def adopt_values(self, values):
        self.stage.adopt(Point(complex(values[1], values[2]), bool(values[0])))


class CourseSlot(Slot):
    """From `fused`, with `gnss` where a tick has it, to `attitude`."""

    INPUTS, OUTPUT = (messages.FusedState, messages.GnssFix), messages.AttitudeOutput
    OWN, COMMON = "<5Q Qddd QQ dddd QQ", "<dddd Qdd Q"

    def __init__(self, orders, stage):
        self.stage, self.sequence, self.queue = stage, Sequence(), deque()
        self.fixes = Beside(Flag.FIX, orders["lateness_ticks"])
        self.last, self.resets, self.jump = Attitude(), [0, 0], (1.0, 0.0, 0.0, 0.0)
        self.epoch, self.exchanges = 1, 0

    def offer(self, message, publish):
        (self.queue.append if type(message) is messages.FusedState else self.fixes.offer)(message)
        while self.queue and not self._waits_for_fix():
            state = self.queue.popleft()
            missing = self.sequence.admit(state.header)
            if missing is not None:
                publish(self._read(state, missing))

    def lacks(self):
        return int(self._waits_for_fix())

    def expect_until(self, tick):
        self.fixes.expected_until = tick

    def _waits_for_fix(self):
        if not self.queue:
            return False
        header = self.queue[0].header
        return not self.fixes.is_ready(header.tick, header.flags, self.queue[-1].header.tick)

    def _read(self, state, missing):
        out = messages.AttitudeOutput(header=state.header)
        header = out.header
        self.sequence.mark(header, missing)
        fix = fix_of(self.fixes.take(header.tick))
        header.flags |= Flag.AIDING_MISSING if header.flags & Flag.FIX and fix is None else 0
        seen = read_attitude(state)
        header.flags |= 0 if seen else Flag.RESET
        attitude = seen or self.last
        dt_s = (header.t_end_ns - header.t_start_ns) * 1e-9
        exchanged = bool(header.flags & Flag.EXCHANGED) and header.epoch != self.epoch
        reset = state.reset_counter != self.resets[0] or exchanged
        self.epoch = header.epoch
        if reset:
            expected = self.last.turned(Turn.of_rotation_vector(*(rate * dt_s for rate in state.rate_rad_s)))
            turn = Turn.between(expected, attitude)
            self.jump = (turn.p.real, turn.s.real, turn.s.imag, turn.p.imag)
            self.resets[0] = state.reset_counter
            self.exchanges += exchanged
        self.last = attitude
        reading = self.stage.step(CourseInput(attitude, state.course_reference, state.heading_sd_rad, fix, dt_s))
        self.resets[1] += bool(reading.aligned and not reset)
        header.flags |= (Flag.NEAR_GIMBAL if reading.near_gimbal else 0) | (Flag.ALIGNED if reading.aligned else 0)
        out.quaternion[:] = reading.quaternion
        out.yaw_rad, out.pitch_rad, out.roll_rad = reading.yaw_rad, reading.pitch_rad, reading.roll_rad
        out.course_rad, out.course_reference = reading.course_rad, reading.reference
        out.course_sd_rad, out.inclination_sd_rad = reading.course_sd_rad, state.inclination_sd_rad
        out.rate_rad_s, out.jump[:] = state.rate_rad_s, self.jump
        out.reset_counter = sum(self.resets) + self.exchanges
        return out

    def attitude(self, out):
        finite = all(map(math.isfinite, (*out.quaternion, out.course_rad)))
        return tuple(out.quaternion) if finite else None

    def own(self):
        return (*counts(self.sequence), *flat(self.last), *self.resets, *self.jump, self.epoch, self.exchanges)

    def set_own(self, own):
        set_counts(self.sequence, own)
        self.last, self.resets, self.jump = unflat(own[5:9]), list(own[9:11]), own[11:15]
        self.epoch, self.exchanges = own[15:]

    def common_values(self):
        quaternion, bearing = self.stage.common()
        w, x, y, z = quaternion
        return (x, y, z, w, bearing is not None, *(bearing or (0.0, 0.0, 0)))

    def adopt_values(self, values):
        x, y, z, w, told, *bearing = values
        self.stage.adopt(LastReading((w, x, y, z), tuple(bearing) if told else None))


SLOTS = {"gyro": GyroSlot, "accel": AccelSlot, "fuser": FuserSlot, "course": CourseSlot}
