"""Readings of a sensor and fixes of a receiver for a running system whose launch file says `[ingest] source = "bus"`.

Input: measurements in SI units and the sensor's own axes. Output: the topics `sensor` and `receiver`. Time: the measurement's, in ns on a clock that does
not run backward. Failure: a system that does not run, or takes no readings, is named with the remedy; nothing waits.

It needs the package iceoryx2 of PyPI, in the version of the bus: `pip install iceoryx2==0.10.0`.
"""

import ctypes
import fcntl
import math
import mmap
import operator
import os
import platform
import re
import stat
import struct
import time

ICEORYX2 = "0.10.0"
"""The version of the bus."""

SHARED_MEMORY = "/dev/shm"
LOOK_INTERVAL_S = 0.1
"""How often a feed looks whether the system is still the one that it joined."""

# The page of wake words: who owns the system, which run it is, and from the 64th byte on a word of 64 bytes for each topic.
PAGE_BYTES = 64 * 64
RUN_AT = 8
FUTEX = {"x86_64": 202, "armv7l": 240, "armv6l": 240}.get(platform.machine(), 98)
FUTEX_WAKE_OP = 5
ADD_ONE = 1 << 28 | 1 << 12
EVERYBODY = 0x7FFF_FFFF


class FeedError(Exception):
    """Why a reading was not given to a system."""


class _Topic:
    """A topic that programs outside the system publish on, joined again when the system begins anew."""

    def __init__(self, system, name, place, layout):
        if not re.fullmatch(r"[a-z0-9_-]{1,32}", system):
            raise FeedError(f"naming a system: {system!r} is not a name; use 1 to 32 of a-z, 0-9, - and _")
        self._system, self._name, self._place, self._layout = system, name, place, layout
        self._bytes = int(layout.split()[1])
        self._joined, self._looked_s = None, time.monotonic()
        self._join()

    @property
    def capacity(self):
        """Number of messages that the topic buffers for ingest. When it is full, the oldest one is overwritten."""
        return self._joined.capacity if self._joined else 0

    def close(self):
        """Leaves the bus; nothing of this program stays there."""
        if self._joined:
            self._joined.close()
            self._joined = None

    def publish(self, message):
        """Publishes the bytes of a message; never waits."""
        now_s = time.monotonic()
        if now_s - self._looked_s >= LOOK_INTERVAL_S:
            self._looked_s = now_s
            if not (self._joined and self._joined.is_running()):
                self._join()
        if not self._joined:
            raise self._absent()
        self._joined.publish(message)

    def _join(self):
        # Closed first: its topics have the names of the new ones.
        self.close()
        self._joined = _Joined(self._system, self._name, self._place, self._layout, self._bytes, self._absent)

    def _absent(self):
        return FeedError(f"joining the system {self._system!r}: it does not run; start it with `plumb up`")


class _Joined:
    """A place on the bus of a system that runs."""

    def __init__(self, system, name, place, layout, bytes_of_message, absent):
        iox = _iceoryx2()
        self._page_path = f"{SHARED_MEMORY}/plumbline.{system}.wake"
        self._files, self._publisher, self._node, self._word, self._page = [], None, None, None, None
        try:
            page = self._open(self._page_path, absent)
            self._lock = page
            self._page = mmap.mmap(page, PAGE_BYTES)
            self._run = self._page[RUN_AT : RUN_AT + 8]
            if not self._has_owner():
                raise absent()
            # While this is held no later owner of the name clears what this program has open.
            fcntl.flock(self._open(f"{SHARED_MEMORY}/plumbline.{system}.members", absent), fcntl.LOCK_SH)
            _own(f"{SHARED_MEMORY}/plumbline.{system}", os.lstat, stat.S_ISDIR, absent)
            self._word = (ctypes.c_char * 64).from_buffer(self._page, 64 * (place + 1))
            self._node = _node(iox, system)
            service = self._open_topic(iox, system, name, layout)
            self.capacity = service.static_config.subscriber_max_buffer_size
            builder = service.publisher_builder().max_loaned_samples(1).initial_max_slice_len(bytes_of_message)
            self._publisher = builder.create()
        except BaseException:
            self.close()
            raise

    def is_running(self):
        """The system is still the one that was joined. One whose files were removed runs on with what it has open, and so does this."""
        if not self._has_owner():
            return False
        try:
            with open(self._page_path, "rb") as page:
                page.seek(RUN_AT)
                return page.read(8) == self._run
        except FileNotFoundError:
            return True

    def publish(self, message):
        sample = self._publisher.loan_slice_uninit(len(message))
        ctypes.memmove(sample.payload_ptr, message, len(message))
        sample.assume_init().send()
        # The kernel adds one to the word, and wakes whoever waits at it.
        word = ctypes.addressof(self._word)
        _syscall(*map(ctypes.c_long, (FUTEX, word, FUTEX_WAKE_OP, EVERYBODY, 0, word, ADD_ONE)))

    def close(self):
        if self._publisher:
            self._publisher.delete()
        self._publisher = self._node = self._word = None
        if self._page:
            self._page.close()
            self._page = None
        for file in self._files:
            os.close(file)
        self._files = []

    def _open(self, path, absent):
        # Without a wait, should it be a pipe.
        try:
            file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            raise absent() from None
        self._files.append(file)
        _own(path, lambda _: os.fstat(file), stat.S_ISREG, absent)
        return file

    def _has_owner(self):
        try:
            fcntl.flock(self._lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        fcntl.flock(self._lock, fcntl.LOCK_UN)
        return False

    def _open_topic(self, iox, system, name, layout):
        builder = self._node.service_builder(iox.ServiceName.new(name)).publish_subscribe(iox.Slice[ctypes.c_uint8])
        try:
            service = builder.payload_alignment(iox.Alignment.new(8)).open()
        except iox.PublishSubscribeOpenError as cause:
            if "DoesNotExist" not in str(cause):
                raise FeedError(f"opening the topic `{name}`: {cause}") from cause
            raise FeedError(
                f'feeding the system {system!r}: its topic "{name}" is not open; set source = "bus" in [ingest] of its launch file, '
                "or wait until ingest has started"
            ) from None
        there = "".join(attribute.value.to_string() for attribute in service.attributes.values)
        if there != layout:
            raise FeedError(
                f"opening the topic `{name}`: another layout is on the bus\n  here:  {layout}\n  there: {there}\n"
                "use the Python package of the version of plumb that runs"
            )
        return service


class Sensor(_Topic):
    """An IMU of a running system, with or without a magnetometer."""

    LAYOUT = (
        "plumbline.SensorReading.1 80 t_sensor_ns:i64@0 rate_rad_s:[f64; 3]@8 force_m_s2:[f64; 3]@32 field_ut:[f64; 3]@56"
    )
    PLACE = 0

    def __init__(self, system):
        super().__init__(system, "sensor", self.PLACE, self.LAYOUT)

    def send(self, t_ns, rate_rad_s, force_m_s2, field_ut=None):
        """Publishes a reading; never waits.

        `t_ns` is when it was taken, a whole number on the sensor's clock; the rates (rad/s), the specific forces (m/s²) and the field (µT), where this
        reading has one, are three numbers each, in the sensor's axes. Of a system that was started anew meanwhile it joins the new one. Where there is
        none the reading is gone, and FeedError says so.
        """
        field_ut = (math.nan,) * 3 if field_ut is None else field_ut
        self.publish(struct.pack("=q9d", operator.index(t_ns), *_three(rate_rad_s), *_three(force_m_s2), *_three(field_ut)))


class Receiver(_Topic):
    """A satellite receiver of a running system."""

    LAYOUT = (
        "plumbline.ReceiverReading.2 64 velocity_m_s:[f64; 3]@0 velocity_sd_m_s:f64@24 age_s:f64@32 "
        "latitude_rad:f64@40 longitude_rad:f64@48 altitude_m:f64@56"
    )
    PLACE = 1

    def __init__(self, system):
        super().__init__(system, "receiver", self.PLACE, self.LAYOUT)

    def send(self, velocity_m_s, sd_m_s=None, age_s=None, latitude_rad=None, longitude_rad=None, altitude_m=None):
        """Publishes a fix; it goes with the next reading of the sensor. The velocity is over ground: east, north, up. What is None is not known."""
        known = (sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m)
        told = (math.nan if value is None else value for value in known)
        self.publish(struct.pack("=8d", *_three(velocity_m_s), *told))


def _three(numbers):
    x, y, z = numbers
    return x, y, z


def _node(iox, system):
    config = iox.config.default()
    shared = config.global_cfg
    shared.prefix = iox.FileName.new(f"plumbline.{system}.")
    shared.root_path = iox.Path.new(f"{SHARED_MEMORY}/plumbline.{system}")
    # The supervisor clears away what the killed leave.
    shared.node.cleanup_dead_nodes_on_creation = False
    shared.node.cleanup_dead_nodes_on_destruction = False
    shared.service.cleanup_dead_nodes_on_open = False
    iox.set_log_level(iox.LogLevel.Fatal)
    builder = iox.NodeBuilder.new().name(iox.NodeName.new("driver")).config(config)
    return builder.signal_handling_mode(iox.SignalHandlingMode.Disabled).create(iox.ServiceType.Ipc)


def _own(path, look, is_kind, absent):
    """Refuses what is not of this kind, or not this user's alone."""
    try:
        found = look(path)
    except FileNotFoundError:
        raise absent() from None
    alone = found.st_uid == os.geteuid() and not found.st_mode & 0o077
    if not is_kind(found.st_mode) or not alone or (stat.S_ISREG(found.st_mode) and found.st_nlink > 1):
        raise FeedError(f"using {path}: it is not this user's alone; be the user whose system runs (sudo -u '#{found.st_uid}' python3 …)")


def _iceoryx2():
    try:
        import iceoryx2
        from importlib.metadata import version
    except ImportError as cause:
        raise FeedError(f"joining a bus: {cause}; pip install iceoryx2=={ICEORYX2}") from None
    if version("iceoryx2") != ICEORYX2:
        found = version("iceoryx2")
        raise FeedError(f"joining a bus: iceoryx2 {found} cannot join one of {ICEORYX2}; pip install iceoryx2=={ICEORYX2}")
    return iceoryx2


_syscall = ctypes.CDLL(None).syscall
