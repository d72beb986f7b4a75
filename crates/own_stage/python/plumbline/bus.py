"""The bus: typed topics in shared memory, and one futex word per topic by which readers are woken."""

import ctypes
import errno
import fcntl
import mmap
import os
import platform
import stat

import iceoryx2 as iox2

from . import messages

_SYS_FUTEX = {"x86_64": 202, "aarch64": 98}
_FUTEX_WAIT, _FUTEX_WAKE_OP = 0, 5
_EVERYBODY = 0x7FFFFFFF
# FUTEX_OP(FUTEX_OP_ADD, 1, FUTEX_OP_CMP_EQ, -1) of linux/futex.h.
_ADD_ONE = (1 << 28) | (1 << 12) | 0xFFF
_libc = ctypes.CDLL(None, use_errno=True)


class BusError(Exception):
    """The bus could not do what it was asked."""


class Bus:
    """A process's place on the bus of a system."""

    def __init__(self, orders, who):
        facts = orders["bus"]
        if platform.machine() not in _SYS_FUTEX:
            raise BusError(f"joining the bus: the futex call of {platform.machine()} is not known here")
        iox2.set_log_level(iox2.LogLevel.Fatal)
        self._facts = facts
        # While it is held, no later owner of the name clears it.
        self._member = _own(facts["members"])
        fcntl.flock(self._member, fcntl.LOCK_SH)
        with _own(facts["page"]) as page:
            self._page = mmap.mmap(page.fileno(), 0)
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(facts["prefix"])
        config.global_cfg.root_path = iox2.Path.new(facts["root"])
        builder = iox2.NodeBuilder.new().config(config).name(iox2.NodeName.new(who))
        self._node = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)

    def publisher(self, message, buffer):
        """Publishes a type of message; the topic holds `buffer` of them for each reader."""
        builder = self._topic(message, buffer).publisher_builder().max_loaned_samples(1)
        return Publisher(builder.initial_max_slice_len(ctypes.sizeof(message)).create(), self.word(message))

    def subscriber(self, message, buffer, late):
        """Reads a type of message: from the next one, or (late) from the oldest that publishers hold."""
        builder = self._topic(message, buffer).subscriber_builder().buffer_size(buffer)
        return Subscriber(builder.history_request(buffer if late else 0).create(), message, self.word(message))

    def word(self, message):
        """The wake word of a topic."""
        return Word(self._page, self._facts["word_bytes"] * (1 + messages.TOPICS.index(message.TOPIC)))

    def wake_all(self):
        """Wakes everybody who waits for any topic, so that a new reader is noticed."""
        for message in messages.MESSAGES:
            self.word(message).wake()

    def _topic(self, message, buffer):
        facts = self._facts
        everybody = message.TOPIC in facts["everybody"]
        attributes = iox2.AttributeVerifier.new()
        size = facts["layout_chunk"]
        for place in range(0, len(message.LAYOUT), size):
            key = iox2.AttributeKey.new(f"layout.{place // size}")
            attributes = attributes.require(key, iox2.AttributeValue.new(message.LAYOUT[place : place + size]))
        try:
            return (
                self._node.service_builder(iox2.ServiceName.new(message.TOPIC))
                .publish_subscribe(iox2.Slice[ctypes.c_uint8])
                .payload_alignment(iox2.Alignment.new(facts["alignment"]))
                .enable_safe_overflow(True)
                .subscriber_max_buffer_size(buffer)
                .history_size(buffer)
                .subscriber_max_borrowed_samples(1)
                .max_publishers(facts["publishers_everybody"] if everybody else facts["publishers"])
                .max_subscribers(facts["subscribers"])
                .max_nodes(facts["nodes"])
                .open_or_create_with_attributes(attributes)
            )
        except iox2.PublishSubscribeOpenOrCreateError as cause:
            remedy = "if messages.py is of another version than plumb, let `plumb stage new` write it again"
            raise BusError(f"opening the topic `{message.TOPIC}`: {cause}; {remedy}") from cause


def _own(path):
    """A file of this user alone, opened; `/dev/shm` is open to everybody."""
    try:
        file = open(os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "r+b", buffering=0)
    except OSError as cause:
        raise BusError(f"joining the bus: opening {path}: {cause.strerror}; run as the user whose system it is") from cause
    found = os.fstat(file.fileno())
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
        raise BusError(f"joining the bus: {path} is not a file of this user alone; `plumb doctor` tells what it is")
    return file


class Publisher:
    """Publishes on a topic; never waits."""

    def __init__(self, port, word):
        self._port, self._word = port, word

    def send(self, message):
        size = ctypes.sizeof(message)
        sample = self._port.loan_slice_uninit(size)
        ctypes.memmove(sample.payload_ptr, ctypes.byref(message), size)
        sample.assume_init().send()

    def greet(self):
        """Hands what it holds to readers that have come since it last acted."""
        self._port.update_connections()

    def note(self, tick):
        """Notes the tick of the message that is sent next."""
        self._word.note(tick)

    def next_tick(self):
        """The tick after the newest one that was ever about to be published."""
        return self._word.next_tick()

    def wake(self):
        self._word.wake()


class Subscriber:
    """Reads a topic."""

    def __init__(self, port, message, word):
        self._port, self._message, self._word = port, message, word
        self._size = ctypes.sizeof(message)
        self._seen = word.look()

    def drain(self, limit, take):
        """Hands what is there to `take`, oldest first, at most `limit` messages; whether there were any."""
        self._seen = self._word.look()
        for count in range(limit):
            sample = self._port.receive()
            if sample is None:
                return count > 0
            message = self._message()
            ctypes.memmove(ctypes.byref(message), sample.payload_ptr, self._size)
            sample.delete()
            take(message)
        # There may be more: the next wait is none.
        self._seen = (self._seen - 1) & 0xFFFFFFFF
        return True

    def next_tick(self):
        """The tick after the newest one that was ever about to be published."""
        return self._word.next_tick()

    def wait(self, limit_s):
        """Sleeps until something was published since the last drain, or the limit; whether a wake-up was lost."""
        late = self._word.wait(self._seen, limit_s)
        self._seen = self._word.look()
        return late


class _Timespec(ctypes.Structure):
    _fields_ = [("s", ctypes.c_long), ("ns", ctypes.c_long)]


class Word:
    """The wake word of one topic: wakes and waiting (u32), next_tick (u64)."""

    def __init__(self, page, offset):
        self._wakes = ctypes.c_uint32.from_buffer(page, offset)
        self._waiting = ctypes.c_uint32.from_buffer(page, offset + 4)
        self._next_tick = ctypes.c_uint64.from_buffer(page, offset + 8)

    def look(self):
        return self._wakes.value

    def next_tick(self):
        return self._next_tick.value

    def note(self, tick):
        # Only the slot's owner notes, so nobody else writes between the two.
        if tick + 1 > self._next_tick.value:
            self._next_tick.value = tick + 1

    def wake(self):
        # The kernel adds to the word: Python has no atomic addition.
        word = ctypes.byref(self._wakes)
        _futex(word, _FUTEX_WAKE_OP, _EVERYBODY, ctypes.c_long(_EVERYBODY), word, ctypes.c_uint32(_ADD_ONE))

    def wait(self, seen, limit_s):
        """Sleeps while the word is as it was seen; whether it was another although the limit had to pass."""
        self._waiting.value = 1
        limit = _Timespec(int(limit_s), int(limit_s % 1.0 * 1e9))
        timed_out = _futex(ctypes.byref(self._wakes), _FUTEX_WAIT, seen, ctypes.byref(limit), None, 0) == errno.ETIMEDOUT
        return timed_out and self.look() != seen


def _futex(word, operation, value, limit, second, third):
    """The error of the call, 0 for none."""
    call = ctypes.c_long(_SYS_FUTEX[platform.machine()])
    return 0 if _libc.syscall(call, word, operation, ctypes.c_uint32(value), limit, second, third) >= 0 else ctypes.get_errno()
