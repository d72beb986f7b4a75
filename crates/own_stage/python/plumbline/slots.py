"""From messages to a stage's input, and from its output to a message: one class for each slot.

What is missing or cannot be used is left out and flagged, as Plumbline's own services do it.
"""

import math
from collections import deque

from . import messages
from .attitude import Attitude, Point, Turn
from .messages import Flag
from .rules import Beside, Join, Sequence
from .stage import CourseInput, Estimate, Fix, FuserInput, Inclination, LastReading, Motion, RateSample

# Longest interval over which two rates still tell how far the body turned, s.
BRIDGE_S = 1.0
# A time without a rate after which the attitude may be anywhere, s.
BLIND_S = 0.2
# A distance between the accelerometer's up and the attitude's that noise and manoeuvres do not make: 5°.
ASTRAY_RAD = 0.087
# A rate that no bias of a gyro is: 2 °/s.
TURN_RAD_S = 0.035
# Below this a force has no direction, m/s².
FORCE_MIN_M_S2 = 0.5


class _Slot:
    def has_begun(self, own):
        return True


class _EachTick(_Slot):
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


class GyroSlot(_EachTick):
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
        up = Point.of(force) if _norm(force) >= FORCE_MIN_M_S2 else None
        if not self.aligned and up and not header.flags & (Flag.FORCE_INVALID | Flag.FORCE_SMALL):
            self.stage.align(Attitude(up))
            self.aligned, attitude = True, self.stage.common()
        _put_attitude(out, attitude)
        out.p[:], out.s[:] = _pair(motion.turn.p), _pair(motion.turn.s)
        out.rate_rad_s[:] = motion.rate_rad_s

    def attitude(self, out):
        return _attitude_of(out)

    def own(self):
        return (*_counts(self.sequence), self.aligned, self.t_end_ns is not None, self.t_end_ns or 0)

    def set_own(self, own):
        _set_counts(self.sequence, own)
        self.aligned, self.t_end_ns = bool(own[5]), own[7] if own[6] else None

    def common_values(self):
        return _flat(self.stage.common())

    def adopt_values(self, values):
        self.stage.adopt(_unflat(values))


class AccelSlot(_EachTick):
    """From `imu` to `accel`."""

    INPUTS, OUTPUT = (messages.ImuSample,), messages.AccelPoint
    OWN, COMMON = "<5Q", "<Qdd"

    def work(self, imu, out):
        seen = self.stage.step(tuple(imu.force_m_s2))
        out.header.flags |= Flag.FORCE_SMALL if seen.norm_m_s2 < FORCE_MIN_M_S2 else 0
        out.w[:], out.chart = _pair(seen.up.w), seen.up.inverted
        out.norm_m_s2, out.trust, out.force_m_s2 = seen.norm_m_s2, seen.trust, imu.force_m_s2

    def attitude(self, out):
        up = _point_of(out)
        return up and Attitude(up).quaternion()

    def own(self):
        return _counts(self.sequence)

    def set_own(self, own):
        _set_counts(self.sequence, own)

    def common_values(self):
        up = self.stage.common()
        return (up.inverted, *_pair(up.w))

    def adopt_values(self, values):
        self.stage.adopt(Point(complex(values[1], values[2]), bool(values[0])))


class FuserSlot(_Slot):
    """From `gyro` and `accel`, joined by tick, with `mag` and `gnss` where a tick has them, to `fused`.

    The stage also has `realign()`: the level is set anew by the next inclination, heading and bias stay.
    """

    INPUTS = (messages.GyroStep, messages.AccelPoint, messages.MagSample, messages.GnssFix, messages.Control)
    OUTPUT = messages.FusedState
    OWN, COMMON = "<5Q QQdddq QQd Qddd ddd Q", "<Qddd Q ddd ddd"

    def __init__(self, orders, stage):
        lateness_ticks = orders["lateness_ticks"]
        self.stage, self.join = stage, Join(lateness_ticks)
        self.field, self.fixes = Beside(Flag.FIELD, lateness_ticks), Beside(Flag.FIX, lateness_ticks)
        self.gyro_before, self.aligned, self.reset_counter, self.blind_s = None, False, 0, 0.0
        self.last, self.force_m_s2, self.turned = Attitude(), (0.0, 0.0, 0.0), False
        self.fresh = stage.snapshot()

    @property
    def sequence(self):
        return self.join.sequence

    def offer(self, message, publish):
        kind = type(message)
        if kind is messages.GyroStep:
            self.join.offer(0, message)
        elif kind is messages.AccelPoint:
            self.join.offer(1, message)
        elif kind is messages.MagSample:
            self.field.offer(message)
        elif kind is messages.GnssFix:
            self.fixes.offer(message)
        # A slot that nobody owns any more is not waited for.
        elif message.owner == 0 and message.service in (messages.SLOTS.index("gyro"), messages.SLOTS.index("accel")):
            self.join.absent_from[message.service - messages.SLOTS.index("gyro")] = message.from_tick
        while self._waits_for() is None:
            tick = self.join.take()
            if tick is None:
                break
            publish(self._fuse(*tick))

    def lacks(self):
        waits_for = self._waits_for()
        return self.join.lacks() if waits_for is None else waits_for

    def expect_until(self, tick):
        self.join.expected_until = self.field.expected_until = self.fixes.expected_until = tick

    def _waits_for(self):
        """Which of `mag` and `gnss` the next tick waits for, although motion and point are there."""
        ready = self.join.peek()
        if ready is None:
            return None
        newest_tick = self.join.newest_tick()
        if not self.field.is_ready(*ready, newest_tick):
            return 2
        return None if self.fixes.is_ready(*ready, newest_tick) else 3

    def _fuse(self, missing, gyro, accel):
        out = messages.FusedState(header=(gyro or accel).header)
        header = out.header
        self.sequence.mark(header, missing)
        header.flags |= accel.header.flags if accel else 0
        motion = self._motion(gyro) if gyro else None
        inclination = self._inclination(accel, motion, header.flags) if accel else None
        header.flags |= (0 if motion else Flag.GYRO_MISSING) | (0 if accel else Flag.ACCEL_MISSING)
        over_gap = header.flags & (Flag.GAP | Flag.LOST_BEFORE) and motion and motion.dt_s == 0.0
        if self._is_astray(header, inclination) or over_gap:
            self.stage.realign()
        suspect = Flag.RATE_INVALID | Flag.RATE_STUCK | Flag.FORCE_INVALID | Flag.FORCE_STUCK
        rest_credible, rate_credible = not header.flags & suspect, not _is_blind(header)
        field_ut, fix = self._aiding(header)
        fused = self._step(FuserInput(motion, inclination, field_ut, fix, rest_credible, rate_credible), header)
        _put_attitude(out, fused.attitude)
        out.rate_rad_s[:], out.bias_rad_s[:] = fused.rate_rad_s, fused.bias_rad_s
        out.innovation_rad, out.inclination_sd_rad = fused.innovation_rad, fused.inclination_sd_rad
        out.heading_sd_rad, out.course_reference = fused.heading_sd_rad, fused.reference
        out.reset_counter = self.reset_counter
        return out

    def _step(self, input, header):
        """One step of the stage. One that leaves the finite numbers begins anew."""
        fused = self.stage.step(input)
        if not _is_finite(fused):
            header.flags |= Flag.RESET
            self.stage.restore(self.fresh)
            fused = self.stage.step(input)
        self.last = fused.attitude
        self.reset_counter += bool(self.aligned and (fused.aligned or header.flags & Flag.RESET))
        self.aligned = self.aligned or fused.aligned
        header.flags |= (
            (Flag.ALIGNED if fused.aligned else 0)
            | (0 if self.aligned else Flag.UNALIGNED)
            | (Flag.AT_REST if fused.rest else 0)
            | (Flag.FIELD_DISTURBED if fused.disturbed else 0)
        )
        return fused

    def _motion(self, gyro):
        """The motion since the last tick that was fused; over ticks that are missing the gyro's own attitude knows it."""
        attitude, header = _read_attitude(gyro), gyro.header
        turn, rate = Turn(complex(*gyro.p), complex(*gyro.s)), tuple(gyro.rate_rad_s)
        if attitude is None or not all(map(math.isfinite, rate)) or not 0.5 <= abs(turn.p) ** 2 + abs(turn.s) ** 2 < 2.0:
            return None
        dt_s = (header.t_end_ns - header.t_start_ns) * 1e-9
        before, self.gyro_before = self.gyro_before, (attitude, header.t_end_ns)
        if before and before[1] != header.t_start_ns:
            turn, dt_s = Turn.between(before[0], attitude), (header.t_end_ns - before[1]) * 1e-9
        if dt_s > BRIDGE_S:
            turn, dt_s = Turn(), 0.0
        return Motion(attitude, turn, rate, dt_s)

    def _inclination(self, accel, motion, flags):
        """The inclination of a point, unless its flags say that it is not one."""
        force = tuple(accel.force_m_s2)
        # A body at rest repeats its force; one that turns and repeats it has a dead accelerometer.
        turns = motion is not None and _norm(motion.rate_rad_s) > TURN_RAD_S
        self.turned = turns or (self.turned and force == self.force_m_s2)
        self.force_m_s2 = force
        dead = flags & Flag.FORCE_STUCK and not flags & Flag.RATE_STUCK and self.turned
        up = _point_of(accel)
        if dead or flags & (Flag.FORCE_INVALID | Flag.FORCE_SMALL) or up is None or not all(map(math.isfinite, force)):
            return None
        return Inclination(up, force, accel.norm_m_s2, accel.trust)

    def _is_astray(self, header, inclination):
        """The gyro is back, and the body has turned away from what the attitude followed."""
        if _is_blind(header):
            self.blind_s += (header.t_end_ns - header.t_start_ns) * 1e-9
            return False
        blind_s, self.blind_s = max(self.blind_s, (header.t_end_ns - header.t_start_ns) * 1e-9), 0.0
        if inclination is None or blind_s <= BLIND_S:
            return False
        along = sum(a * b for a, b in zip(inclination.up.direction(), self.last.up.direction()))
        return math.acos(max(-1.0, min(1.0, along))) > ASTRAY_RAD

    def _aiding(self, header):
        """The field and the fix of a tick whose flags say that it has them."""
        mag, gnss = self.field.take(header.tick), self.fixes.take(header.tick)
        field_ut = tuple(mag.field_ut) if mag and all(map(math.isfinite, mag.field_ut)) else None
        fix = _fix(gnss)
        if header.flags & Flag.FIELD and field_ut is None or header.flags & Flag.FIX and fix is None:
            header.flags |= Flag.AIDING_MISSING
        return field_ut, fix

    def attitude(self, out):
        return _attitude_of(out)

    def own(self):
        attitude, t_end_ns = self.gyro_before or (Attitude(), 0)
        before = (self.gyro_before is not None, *_flat(attitude), t_end_ns)
        rest = (self.aligned, self.reset_counter, self.blind_s, *_flat(self.last), *self.force_m_s2, self.turned)
        return (*_counts(self.sequence), *before, *rest)

    def set_own(self, own):
        _set_counts(self.sequence, own)
        self.gyro_before = (_unflat(own[6:10]), own[10]) if own[5] else None
        self.aligned, self.reset_counter, self.blind_s = bool(own[11]), own[12], own[13]
        self.last, self.force_m_s2, self.turned = _unflat(own[14:18]), own[18:21], bool(own[21])

    def common_values(self):
        common = self.stage.common()
        return (*_flat(common.attitude), common.reference, *common.bias_rad_s, *common[3:])

    def has_begun(self, own):
        """What the stage told as common is more than where every stage begins."""
        return bool(own[11])

    def adopt_values(self, values):
        self.stage.adopt(Estimate(_unflat(values[:4]), values[4], tuple(values[5:8]), *values[8:]))


class CourseSlot(_Slot):
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
        fix = _fix(self.fixes.take(header.tick))
        header.flags |= Flag.AIDING_MISSING if header.flags & Flag.FIX and fix is None else 0
        seen = _read_attitude(state)
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
        return (*_counts(self.sequence), *_flat(self.last), *self.resets, *self.jump, self.epoch, self.exchanges)

    def set_own(self, own):
        _set_counts(self.sequence, own)
        self.last, self.resets, self.jump = _unflat(own[5:9]), list(own[9:11]), own[11:15]
        self.epoch, self.exchanges = own[15:]

    def common_values(self):
        quaternion, bearing = self.stage.common()
        w, x, y, z = quaternion
        return (x, y, z, w, bearing is not None, *(bearing or (0.0, 0.0, 0)))

    def adopt_values(self, values):
        x, y, z, w, told, *bearing = values
        self.stage.adopt(LastReading((w, x, y, z), tuple(bearing) if told else None))


SLOTS = {"gyro": GyroSlot, "accel": AccelSlot, "fuser": FuserSlot, "course": CourseSlot}


def _is_blind(header):
    return bool(header.flags & (Flag.RATE_INVALID | Flag.RATE_CLIPPED | Flag.RATE_STUCK | Flag.GYRO_MISSING))


def _is_finite(fused):
    numbers = (*fused.rate_rad_s, *fused.bias_rad_s, fused.innovation_rad, fused.inclination_sd_rad, fused.heading_sd_rad)
    attitude = fused.attitude
    return all(map(math.isfinite, (*_pair(attitude.up.w), attitude.z_rad, *numbers)))


def _fix(gnss):
    if gnss is None or not all(map(math.isfinite, gnss.velocity_m_s)):
        return None
    told = [value if math.isfinite(value) else None for value in (gnss.velocity_sd_m_s, gnss.age_s, gnss.latitude_rad)]
    return Fix(tuple(gnss.velocity_m_s), *told)


def _norm(vector):
    return math.sqrt(sum(x * x for x in vector))


def _pair(w):
    return (w.real, w.imag)


def _put_attitude(out, attitude):
    out.w[:], out.z_rad, out.chart = _pair(attitude.up.w), attitude.z_rad, attitude.up.inverted


def _point_of(message):
    u, v = message.w
    if message.chart > 1 or not (math.isfinite(u) and math.isfinite(v)):
        return None
    return Point(complex(u, v), message.chart == 1)


def _read_attitude(message):
    up = _point_of(message)
    return Attitude(up, message.z_rad) if up and math.isfinite(message.z_rad) else None


def _attitude_of(message):
    attitude = _read_attitude(message)
    return attitude and attitude.quaternion()


def _flat(attitude):
    return (attitude.up.inverted, *_pair(attitude.up.w), attitude.z_rad)


def _unflat(values):
    inverted, u, v, z_rad = values
    return Attitude(Point(complex(u, v), bool(inverted)), z_rad)


def _counts(sequence):
    return (sequence.next_tick, sequence.ticks, sequence.lost, sequence.duplicated, sequence.repeated)


def _set_counts(sequence, own):
    sequence.next_tick, sequence.ticks, sequence.lost, sequence.duplicated, sequence.repeated = own[:5]
