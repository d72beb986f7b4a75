"""The slot fuser: from `gyro` and `accel`, joined by tick, with `mag` and `gnss` where a tick has them, to `fused`.

What is missing or cannot be used is left out and flagged, as Plumbline's own service does it.
"""

import math
import sys

from . import messages
from .attitude import Attitude, Turn
from .messages import Flag
from .rules import NEVER, Beside, Join
from .stage import ARBITRARY, Estimate, FuserInput, Inclination, Motion
from .values import (
    BRIDGE_S,
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

# A time without a rate after which the attitude may be anywhere, s.
BLIND_S = 0.2
# A distance between the accelerometer's up and the attitude's that noise and manoeuvres do not make: 5°.
ASTRAY_RAD = 0.087
# A rate that no bias of a gyro is: 2 °/s.
TURN_RAD_S = 0.035


class FuserSlot(Slot):
    """From `gyro` and `accel`, joined by tick, with `mag` and `gnss` where a tick has them, to `fused`.

    The stage also has `realign()`: the level is set anew by the next inclination, heading and bias stay.
    """

    INPUTS = (messages.GyroStep, messages.AccelPoint, messages.MagSample, messages.GnssFix, messages.Control)
    OUTPUT = messages.FusedState
    OWN, COMMON = "<5Q QQdddq QQd Qddd ddd Q", "<Qddd Q ddd ddd ddd d"

    def __init__(self, orders, stage):
        lateness_ticks = orders["lateness_ticks"]
        self.stage, self.join = stage, Join(lateness_ticks)
        self.field, self.fixes = Beside(Flag.FIELD, lateness_ticks), Beside(Flag.FIX, lateness_ticks)
        self.gyro_before, self.aligned, self.reset_counter, self.blind_s = None, False, 0, 0.0
        self.last, self.force_m_s2, self.turned = Attitude(), (0.0, 0.0, 0.0), False
        self._begin(orders["prior"])
        self.fresh = stage.snapshot()

    def _begin(self, prior):
        """With what an earlier run has found of the sensors, if there is one; the attitude is as unknown as at any beginning."""
        if prior is None:
            return
        try:
            nothing = {"mean": (0.0, 0.0, 0.0), "sd": math.inf}
            bias, iron = prior["bias_rad_s"] or nothing, prior["hard_iron_ut"] or nothing
            found = (tuple(bias["mean"]), math.pi, math.pi, bias["sd"], tuple(iron["mean"]), iron["sd"])
            self.stage.adopt(Estimate(Attitude(), ARBITRARY, *found))
            self.stage.realign()
        except ValueError as error:
            print(f"the stage {self.stage.NAME} begins without what an earlier run has found: {error}", file=sys.stderr)

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
        # A slot that nobody owns any more is not waited for, until somebody owns it again.
        elif message.service in (messages.SLOTS.index("gyro"), messages.SLOTS.index("accel")):
            absent_from = NEVER if message.owner else message.from_tick
            self.join.absent_from[message.service - messages.SLOTS.index("gyro")] = absent_from
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
        put_attitude(out, fused.attitude)
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
        attitude, header = read_attitude(gyro), gyro.header
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
        turns = motion is not None and norm(motion.rate_rad_s) > TURN_RAD_S
        self.turned = turns or (self.turned and force == self.force_m_s2)
        self.force_m_s2 = force
        dead = flags & Flag.FORCE_STUCK and not flags & Flag.RATE_STUCK and self.turned
        up = point_of(accel)
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
        fix = fix_of(gnss)
        if header.flags & Flag.FIELD and field_ut is None or header.flags & Flag.FIX and fix is None:
            header.flags |= Flag.AIDING_MISSING
        return field_ut, fix

    def attitude(self, out):
        return attitude_of(out)

    def own(self):
        attitude, t_end_ns = self.gyro_before or (Attitude(), 0)
        before = (self.gyro_before is not None, *flat(attitude), t_end_ns)
        rest = (self.aligned, self.reset_counter, self.blind_s, *flat(self.last), *self.force_m_s2, self.turned)
        return (*counts(self.sequence), *before, *rest)

    def set_own(self, own):
        set_counts(self.sequence, own)
        self.gyro_before = (unflat(own[6:10]), own[10]) if own[5] else None
        self.aligned, self.reset_counter, self.blind_s = bool(own[11]), own[12], own[13]
        self.last, self.force_m_s2, self.turned = unflat(own[14:18]), own[18:21], bool(own[21])

    def common_values(self):
        common = self.stage.common()
        sds = (common.inclination_sd_rad, common.heading_sd_rad, common.bias_sd_rad_s)
        iron = (*common.hard_iron_ut, common.hard_iron_sd_ut)
        return (*flat(common.attitude), common.reference, *common.bias_rad_s, *sds, *iron)

    def has_begun(self, own):
        return bool(own[11])

    def adopt_values(self, values):
        bias_rad_s, sds, iron_ut = tuple(values[5:8]), values[8:11], tuple(values[11:14])
        self.stage.adopt(Estimate(unflat(values[:4]), values[4], bias_rad_s, *sds, iron_ut, values[14]))


def _is_blind(header):
    return bool(header.flags & (Flag.RATE_INVALID | Flag.RATE_CLIPPED | Flag.RATE_STUCK | Flag.GYRO_MISSING))


def _is_finite(fused):
    numbers = (*fused.rate_rad_s, *fused.bias_rad_s, fused.innovation_rad, fused.inclination_sd_rad, fused.heading_sd_rad)
    attitude = fused.attitude
    return all(map(math.isfinite, (*pair(attitude.up.w), attitude.z_rad, *numbers)))
