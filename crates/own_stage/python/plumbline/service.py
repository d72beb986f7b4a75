"""The loop of a stage as a service of a running system: `run(Class)`.

It reads its orders from standard input, joins the bus, goes on from the checkpoint it is given, and then: takes what its inputs
hold, publishes what follows as far as it owns the slot, heeds decisions, says how it is, and sleeps until there is work.
"""

import ctypes
import gc
import json
import math
import os
import signal
import sys
import time

from . import messages
from .attitude import error_rad
from .bus import Bus, BusError
from .messages import Flag
from .rules import NEVER, Inlet, Tenure
from .slots import SLOTS
from .state import checkpoint, resume

_ORDERS_BYTES_MAX = 1 << 20
_FIRST_EPOCH = 1
# Longest sleep: after it a service looks for work, and whether it is to end, by itself.
_WAIT_LIMIT_S = 0.05
# How often a service says how it is: one that owns its slot, and one that is to take over or has.
_HEALTH_INTERVAL_NS = 100_000_000
_CANDIDATE_INTERVAL_NS = 10_000_000
# Messages of one input taken before the others have their turn.
_TURN = 32
_PR_SET_PDEATHSIG = 1
# Topics of which a slot has one publisher after another.
_OF_SLOTS = (messages.GyroStep, messages.AccelPoint, messages.FusedState, messages.AttitudeOutput)


def run(stage_class):
    """Runs a stage until the supervisor ends it. What is wrong is said on standard error, and the exit code is 1."""
    try:
        Service(stage_class(), _orders()).serve()
    except (BusError, OSError, ValueError) as error:
        sys.exit(f"the stage {stage_class.NAME}: {error}")


def _orders():
    """What the supervisor says; the service ends with it."""
    try:
        orders = json.loads(sys.stdin.read(_ORDERS_BYTES_MAX))
        supervisor = orders["supervisor_pid"]
    except (ValueError, TypeError, KeyError) as cause:
        raise ValueError("reading the orders: none on standard input; stages are started by `plumb up` or `plumb swap`") from cause
    # A signal that can be caught is not caught in a step that never ends.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != supervisor:
        raise ValueError("reading the orders: the supervisor that wrote them has ended")
    return orders


class Service:
    """A slot's service at work."""

    def __init__(self, stage, orders):
        self.ends = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)
        self.orders, self.incarnation = orders, orders["incarnation"]
        if orders["service"] != stage.SLOT or orders["stage"]["stage"] != stage.NAME:
            asked = f"`{orders['stage']['stage']}` for the slot {orders['service']}"
            raise ValueError(f"filling a slot: this is `{stage.NAME}` for the slot {stage.SLOT}, asked for is {asked}")
        stage.configure(orders["stage"]["set"])
        self.place = messages.SLOTS.index(stage.SLOT)
        self.slot = SLOTS[stage.SLOT](orders, stage)
        self.bus = Bus(orders, stage.SLOT)
        self.health = self.bus.publisher(messages.Health, orders["buffer_beside"])
        self.said = messages.Health(service=self.place, incarnation=self.incarnation, pid=os.getpid())
        self.said_at_ns = 0
        resumed, next_tick = self._resume()
        self.inputs = [_Input(self.bus, orders, message, next_tick) for message in self.slot.INPUTS]
        if orders["resume"] is not None:
            self.slot.expect_until(max(one.subscriber.next_tick() for one in self.inputs))
        self.output = self.bus.publisher(self.slot.OUTPUT, orders["buffer_ticks"])
        self.checkpoints = self.bus.publisher(messages.Checkpoint, orders["buffer_beside"])
        self.control = self.bus.subscriber(messages.Control, orders["buffer_beside"], late=True)
        self.candidate = orders["role"] == "Candidate"
        from_tick = None if self.candidate else orders["role"]["Owner"]["from_tick"]
        self.tenure = Tenure(self.incarnation, orders["epoch"], from_tick, orders["lateness_ticks"])
        # What is published is another stage's than before, up to the first output at this tick or after it.
        self.exchanged_at = None
        if resumed != "whole" and (self.candidate or resumed == "common"):
            self.exchanged_at = 0 if self.candidate else self.output.next_tick()
        self.shadow = _Shadow(self) if self.candidate else None
        self.next_checkpoint = self.flags = self.flawed = 0

    def serve(self):
        """Works until it is to end."""
        self._say(messages.STATE_READY)
        self.bus.wake_all()
        # What is here stays; a collection that looked through it would only cost time.
        gc.freeze()
        while not self.ends:
            self._turn()
            self._heed()
            self._note()
            self._say(messages.STATE_RUNNING if self.slot.sequence.ticks else messages.STATE_READY)
            self.said.late_wakes += self.inputs[self.slot.lacks()].subscriber.wait(_WAIT_LIMIT_S)

    def _end(self, *_):
        self.ends = True

    def _resume(self):
        """Goes on from what the orders hold: "whole" bit for bit, "common" from another stage, or not; and the tick that comes next."""
        held = self.orders["resume"]
        if not isinstance(held, dict) or "Checkpoint" not in held:
            return None, 0
        try:
            whole = resume(self.slot, self.place, held["Checkpoint"])
        except (ValueError, TypeError, ArithmeticError) as error:
            print(f"the stage {self.slot.stage.NAME} does not go on from its checkpoint: {error}; it begins anew", file=sys.stderr)
            return None, held["Checkpoint"][0]
        return "whole" if whole else "common", self.slot.sequence.next_tick

    def _turn(self):
        """Takes what the inputs hold and publishes what follows from it, as far as the slot is owned."""
        self.output.greet()
        before, published = self.slot.sequence.ticks, self.tenure.publishes()
        for _ in range(self.orders["buffer_ticks"] // _TURN + 1):
            taken = [one.drain(self.slot, self._computed) for one in self.inputs]
            if self.slot.sequence.ticks != before:
                self.output.wake()
            if not any(taken):
                break
        # Whoever takes over is confirmed by that.
        if published and not self.tenure.publishes():
            self.said_at_ns = 0

    def _computed(self, out):
        self.flags |= out.header.flags
        attitude = self.slot.attitude(out)
        self.flawed += attitude is None
        if self.shadow:
            self.shadow.computed(out.header.tick, attitude)
        self.tenure.take(out, self._publish)

    def _publish(self, out):
        if self.exchanged_at is not None:
            out.header.flags |= Flag.EXCHANGED
            self.exchanged_at = None if out.header.tick >= self.exchanged_at else self.exchanged_at
        out.header.t_sent_ns = time.monotonic_ns()
        self.output.note(out.header.tick)
        self.output.send(out)

    def _heed(self):
        """Follows the decisions about the slot."""
        decided = []

        def hear(control):
            if control.service == self.place and self.tenure.decide(control, self._publish):
                decided.append(control)

        self.control.drain(self.orders["buffer_beside"], hear)
        if decided:
            self.output.wake()
            self.said_at_ns = 0
        if self.shadow and self.tenure.publishes():
            self.shadow = None
        if self.shadow:
            self.shadow.compare()

    def _note(self):
        """Publishes the state every so many ticks."""
        next_tick = self.slot.sequence.next_tick
        if next_tick >= self.next_checkpoint:
            self.next_checkpoint = next_tick + self.orders["checkpoint_ticks"]
            self.checkpoints.send(checkpoint(self.slot, self.place, self.incarnation))

    def _say(self, state):
        """Says how the service is: at once when its state is another, else as often as is of use."""
        now_ns, said = time.monotonic_ns(), self.said
        interval_ns = _CANDIDATE_INTERVAL_NS if self.candidate else _HEALTH_INTERVAL_NS
        if said.state == state and now_ns - self.said_at_ns < interval_ns:
            return
        self.said_at_ns, said.state = now_ns, state
        sequence, tenure = self.slot.sequence, self.tenure
        said.ticks, said.lost, said.next_tick = sequence.ticks, sequence.lost, sequence.next_tick
        said.duplicated = sequence.duplicated + sum(one.duplicated() for one in self.inputs)
        said.repeated = sequence.repeated + sum(one.repeated() for one in self.inputs)
        said.flags, said.flawed = self.flags, self.flawed
        said.epoch, said.missed = tenure.decided_epoch, tenure.missed
        said.published_from = NEVER if tenure.published_from is None else tenure.published_from
        self.health.send(said)


class _Input:
    """A topic that the slot reads; of a slot's topic one stream out of all who fill it."""

    def __init__(self, bus, orders, message, next_tick):
        late = orders["resume"] is not None or message is messages.Control
        buffer = orders["buffer_beside" if message is messages.Control else "buffer_ticks"]
        self.subscriber = bus.subscriber(message, buffer, late)
        self.inlet = Inlet(next_tick, _FIRST_EPOCH, orders["lateness_ticks"] // 2) if message in _OF_SLOTS else None

    def drain(self, slot, publish):
        """Hands at most a turn's messages to the slot; whether there were any."""
        if self.inlet is None:
            return self.subscriber.drain(_TURN, lambda message: slot.offer(message, publish))
        deliver = lambda message: slot.offer(message, publish)  # noqa: E731
        return self.subscriber.drain(_TURN, lambda message: self.inlet.offer(message, deliver))

    def duplicated(self):
        return self.inlet.duplicated if self.inlet else 0

    def repeated(self):
        return self.inlet.repeated if self.inlet else 0


class _Shadow:
    """A candidate beside the stage that owns the slot: how far apart they are, said a few times a second."""

    _INTERVAL_NS, _WAITING_MAX = 100_000_000, 4096

    def __init__(self, service):
        orders = service.orders
        self.owner = service.bus.subscriber(service.slot.OUTPUT, orders["buffer_ticks"], late=True)
        self.publisher = service.bus.publisher(messages.Difference, orders["buffer_beside"])
        self.message = messages.Difference(service=service.place, incarnation=service.incarnation)
        self.attitude, self.waiting = service.slot.attitude, {}
        self.sums, self.squares, self.said_at_ns = [0.0] * 3, [0.0] * 3, 0

    def computed(self, tick, attitude):
        """The candidate has computed a tick."""
        if attitude is not None:
            if len(self.waiting) == self._WAITING_MAX:
                del self.waiting[next(iter(self.waiting))]
            self.waiting[tick] = attitude

    def compare(self):
        """Compares what both have, and says it from time to time."""
        self.owner.drain(self._WAITING_MAX, self._compare_one)
        now_ns = time.monotonic_ns()
        if self.message.ticks and now_ns - self.said_at_ns > self._INTERVAL_NS:
            self.said_at_ns = now_ns
            self.publisher.send(self.message)

    def _compare_one(self, theirs):
        own, attitude = self.waiting.pop(theirs.header.tick, None), self.attitude(theirs)
        if own is None or attitude is None or theirs.header.incarnation == self.message.incarnation:
            return
        message = self.message
        message.tick, message.ticks = theirs.header.tick, message.ticks + 1
        for place, now in enumerate(error_rad(own, attitude)):
            self.sums[place] += now
            self.squares[place] += now * now
            message.now_rad[place] = now
            message.mean_rad[place] = self.sums[place] / message.ticks
            message.rms_rad[place] = math.sqrt(self.squares[place] / message.ticks)
            message.max_rad[place] = max(message.max_rad[place], now)
