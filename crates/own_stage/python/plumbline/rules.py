"""Who owns a tick, and how streams become one. By ticks alone, never by arrival or a clock.

The rule for all: a tick belongs to the owner named by the decision of the highest epoch that begins at or before it.
"""

from collections import deque

from .messages import Flag

NEVER = 0xFFFFFFFFFFFFFFFF
# Messages of another stream that wait for their tick at most.
QUEUE_MAX = 65_536


class Sequence:
    """A stream in the order of ticks: what is next, what is missing, what came again."""

    def __init__(self):
        self.next_tick = self.ticks = self.lost = self.duplicated = self.repeated = self.sender = 0

    def admit(self, header):
        """Admits a tick and tells how many before it are missing; None for one that has had its turn."""
        missing = header.tick - self.next_tick
        if missing < 0:
            self.refuse(header.incarnation, self.sender)
            return None
        self.lost += missing
        self.ticks += 1
        self.next_tick, self.sender = header.tick + 1, header.incarnation
        return missing

    def refuse(self, sender, usual):
        """Leaves out a message: what a new life says again is no fault."""
        if sender == usual:
            self.duplicated += 1
        else:
            self.repeated += 1

    def mark(self, header, missing):
        """Says in a header what is missing before it."""
        header.lost_upstream = self.lost
        header.flags |= Flag.LOST_BEFORE if missing else 0


class Inlet:
    """One stream out of all who fill a slot: each tick once, in order."""

    def __init__(self, next_tick, epoch, lateness_ticks):
        self.next_tick, self.epoch, self.lateness_ticks = next_tick, epoch, lateness_ticks
        self.incarnation, self.held = None, {}
        self.duplicated = self.repeated = 0

    def offer(self, message, deliver):
        """Takes a message; hands every message that has its turn to `deliver`."""
        header = message.header
        tick = header.tick
        if tick < self.next_tick:
            if (header.epoch, header.incarnation) == (self.epoch, self.incarnation):
                self.duplicated += 1
            else:
                self.repeated += 1
            return
        if header.epoch < self.epoch:
            self.repeated += 1
            return
        # Only the publisher delivered last, under the same decision, is known to have nothing in between.
        waits = tick > self.next_tick and (header.epoch > self.epoch or header.incarnation != self.incarnation)
        if not self.held and not waits:
            return self._deliver(message, deliver)
        self._hold(message)
        while self.held:
            first = min(self.held)
            due = first <= (self.next_tick if waits else max(tick, self.next_tick))
            if not due and max(self.held) - self.next_tick < self.lateness_ticks:
                break
            self._deliver(self.held.pop(first), deliver)

    def _hold(self, message):
        """Keeps a message; of two with the same tick that of the later decision."""
        header = message.header
        held = self.held.get(header.tick)
        if held and (held.header.epoch, held.header.incarnation) == (header.epoch, header.incarnation):
            self.duplicated += 1
            return
        self.repeated += held is not None
        if held is None or held.header.epoch < header.epoch:
            self.held[header.tick] = message

    def _deliver(self, message, deliver):
        header = message.header
        if header.epoch < self.epoch:
            self.repeated += 1
            return
        self.next_tick, self.epoch, self.incarnation = header.tick + 1, header.epoch, header.incarnation
        deliver(message)


class Tenure:
    """What a service does with its outputs: publish them while it owns the slot, keep the last of them in any case."""

    def __init__(self, incarnation, epoch, from_tick, capacity):
        """An owner from `from_tick` on by the decision `epoch`; a candidate where that is None."""
        self.incarnation, self.capacity = incarnation, max(capacity, 1)
        self.kept, self.kept_from, self.next_tick = deque(), None, 0
        # (from_tick, epoch, mine), in the order of ticks.
        self.terms = []
        self.decided_epoch, self.missed, self.published_from = epoch, False, None
        if from_tick is not None:
            self.terms, self.kept_from = [(from_tick, epoch, True)], 0

    def take(self, output, publish):
        """Takes the next output; publishes it if its tick is owned."""
        tick = output.header.tick
        if tick < self.next_tick:
            return
        if not self.kept:
            self.kept_from = tick
        elif len(self.kept) == self.capacity:
            self.kept_from = self.kept.popleft().header.tick + 1
        self.next_tick = tick + 1
        self._publish(output, publish)
        self.kept.append(output)

    def decide(self, control, publish):
        """Obeys a decision; whether it is a new one. What is kept and owned by it is published at once."""
        epoch, from_tick = control.epoch, control.from_tick
        if epoch <= self.decided_epoch:
            return False
        self.decided_epoch, self.published_from = epoch, None
        mine = control.owner == self.incarnation
        if mine:
            able = self.kept_from is not None and self.kept_from <= from_tick
        else:
            able = not self._has_published(from_tick)
        self.missed = not able
        if able:
            self.terms = [term for term in self.terms if term[0] < from_tick] + [(from_tick, epoch, mine)]
            if mine:
                for output in [output for output in self.kept if output.header.tick >= from_tick]:
                    self._publish(output, publish)
            self._forget_terms()
        return True

    def publishes(self):
        """Whether the next tick would be published."""
        term = self._term(self.next_tick)
        return term is not None and term[2]

    def _publish(self, output, publish):
        term = self._term(output.header.tick)
        if term is None or not term[2]:
            return
        if term[1] == self.decided_epoch and self.published_from is None:
            self.published_from = output.header.tick
        output.header.epoch, output.header.incarnation = term[1], self.incarnation
        publish(output)

    def _term(self, tick):
        return next((term for term in reversed(self.terms) if term[0] <= tick), None)

    def _has_published(self, from_tick):
        ends = [term[0] for term in self.terms[1:]] + [NEVER]
        mine = [(max(term[0], from_tick), min(end, self.next_tick)) for term, end in zip(self.terms, ends) if term[2]]
        return any(begin < end for begin, end in mine)

    def _forget_terms(self):
        while len(self.terms) > 1 and self.terms[1][0] <= (self.kept_from or 0):
            self.terms.pop(0)


class Join:
    """Two inputs by tick. One that is silent is left out when the other is `lateness_ticks` ahead."""

    def __init__(self, lateness_ticks):
        self.queues, self.senders, self.absent_from = [deque(), deque()], [0, 0], [NEVER, NEVER]
        self.lateness_ticks, self.expected_until, self.sequence = lateness_ticks, 0, Sequence()

    def offer(self, place, message):
        """Takes a message of the first input (0) or the second (1)."""
        header, queue = message.header, self.queues[place]
        if header.tick < self.sequence.next_tick or queue and header.tick <= queue[-1].header.tick:
            self.sequence.refuse(header.incarnation, self.senders[place])
            return
        self.senders[place] = header.incarnation
        queue.append(message)

    def peek(self):
        """(tick, flags) of the next complete tick, or None."""
        first, second = (queue[0].header if queue else None for queue in self.queues)
        if first and second:
            if first.tick == second.tick:
                return first.tick, first.flags | second.flags
            return (first.tick, first.flags) if first.tick < second.tick else (second.tick, second.flags)
        for there, place in ((first, 0), (second, 1)):
            if there and (there.tick >= self.absent_from[1 - place] or self._overdue(there.tick, place)):
                return there.tick, there.flags
        return None

    def take(self):
        """(missing before, first, second) of the next complete tick, or None."""
        ready = self.peek()
        if ready is None:
            return None
        its = [queue.popleft() if queue and queue[0].header.tick == ready[0] else None for queue in self.queues]
        missing = self.sequence.admit((its[0] or its[1]).header)
        return None if missing is None else (missing, *its)

    def newest_tick(self):
        return max((queue[-1].header.tick for queue in self.queues if queue), default=0)

    def lacks(self):
        """1 where only the first input is there, else 0."""
        return int(bool(self.queues[0]) and not self.queues[1])

    def _overdue(self, tick, place):
        queue = self.queues[place]
        late = tick >= self.expected_until and queue[-1].header.tick - tick >= self.lateness_ticks
        return late or len(queue) >= QUEUE_MAX


class Beside:
    """Messages that go with some ticks of another stream, as a flag of those ticks says."""

    def __init__(self, flag, lateness_ticks):
        self.flag, self.lateness_ticks = flag, lateness_ticks
        self.queue, self.expected_until, self.next_tick = deque(), 0, 0

    def offer(self, message):
        tick = message.header.tick
        if tick >= self.next_tick and len(self.queue) < QUEUE_MAX:
            self.next_tick = tick + 1
            self.queue.append(message)

    def is_ready(self, tick, flags, newest_tick):
        """Nothing more is to be waited for at this tick."""
        late = tick >= self.expected_until and newest_tick - tick >= self.lateness_ticks
        return not flags & self.flag or self.next_tick > tick or late

    def take(self, tick):
        """The message of this tick, if it has come."""
        while self.queue and self.queue[0].header.tick < tick:
            self.queue.popleft()
        return self.queue.popleft() if self.queue and self.queue[0].header.tick == tick else None
