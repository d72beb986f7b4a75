"""Publishers that feed readings and fixes to a running system with `[ingest] source = "bus"`.

Input: measurements in SI units and sensor axes.

Output: the topics `sensor` and `receiver`.

Time: the timestamp of the measurement, in ns on a monotonic clock.

Failure: FeedError if the system is not running or does not accept readings. No call blocks.

The module needs the PyPI package iceoryx2 in the version that the bus uses:
`pip install iceoryx2==0.10.0`.
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
from collections.abc import Iterable

Numbers = Iterable[float]
"""Three numbers."""

ICEORYX2 = "0.10.0"
"""Version of iceoryx2 that the bus uses."""

SHARED_MEMORY = "/dev/shm"
CHECK_INTERVAL_S = 0.1
"""Interval at which a publisher checks that the system it joined is still running."""

WORD_BYTES = 8
"""Bytes of the words that a message consists of."""

# Layout of the state that all processes of a system share. The run identifier is at byte 8. From
# byte 64 on, each topic has 64 bytes, which begin with the wake word of the topic.
SHARED_STATE_BYTES = 64 * 64
RUN_OFFSET = 8
FUTEX = {"x86_64": 202, "armv7l": 240, "armv6l": 240}.get(platform.machine(), 98)
FUTEX_WAKE_OP = 5
FUTEX_OP_ADD_ONE = 1 << 28 | 1 << 12
MAX_WOKEN = 0x7FFF_FFFF


class FeedError(Exception):
    """Error while publishing a reading. The message names the cause and the remedy."""


class _Topic:
    """Publisher on a topic of a system. It joins again after the system has been restarted."""

    def __init__(self, system, name, index, layout):
        if not re.fullmatch(r"[a-z0-9_-]{1,32}", system):
            raise FeedError(f"invalid system name {system!r}: use 1 to 32 characters of a-z, 0-9, - and _")
        self._system, self._name, self._index, self._layout = system, name, index, layout
        self._bytes = int(layout.split()[1])
        self._joined, self._checked_s = None, time.monotonic()
        self._join()

    @property
    def capacity(self) -> int:
        """Number of messages that the topic buffers for ingest.

        When the buffer is full, the oldest message is overwritten.
        """
        return self._joined.capacity if self._joined else 0

    def close(self) -> None:
        """Leaves the bus and removes all resources of this program from it."""
        if self._joined:
            self._joined.close()
            self._joined = None

    def publish(self, message):
        """Publishes the bytes of a message without blocking."""
        now_s = time.monotonic()
        if now_s - self._checked_s >= CHECK_INTERVAL_S:
            self._checked_s = now_s
            if not (self._joined and self._joined.is_running()):
                self._join()
        if not self._joined:
            raise self._not_running()
        self._joined.publish(message)

    def _join(self):
        # The old connection is closed first, because the new one uses the same topic names.
        self.close()
        self._joined = _Joined(self._system, self._name, self._index, self._layout, self._bytes, self._not_running)

    def _not_running(self):
        return FeedError(f"joining the system {self._system!r}: it is not running; start it with `plumb up`")


class _Joined:
    """Connection to the bus of a running system."""

    def __init__(self, system, name, index, layout, message_bytes, not_running):
        iox = _iceoryx2()
        self._page_path = f"{SHARED_MEMORY}/plumbline.{system}.wake"
        self._files, self._publisher, self._node, self._word, self._page = [], None, None, None, None
        try:
            page = self._open(self._page_path, not_running)
            self._lock = page
            self._page = mmap.mmap(page, SHARED_STATE_BYTES)
            self._run = self._page[RUN_OFFSET : RUN_OFFSET + 8]
            if not self._has_owner():
                raise not_running()
            # While this lock is held, no later system with this name removes the open files.
            fcntl.flock(self._open(f"{SHARED_MEMORY}/plumbline.{system}.members", not_running), fcntl.LOCK_SH)
            _check_owner(f"{SHARED_MEMORY}/plumbline.{system}", os.lstat, stat.S_ISDIR, not_running)
            self._word = (ctypes.c_char * 64).from_buffer(self._page, 64 * (index + 1))
            self._node = _node(iox, system)
            service = self._open_topic(iox, system, name, layout)
            self.capacity = service.static_config.subscriber_max_buffer_size
            builder = service.publisher_builder().max_loaned_samples(1).initial_max_slice_len(message_bytes // WORD_BYTES)
            self._publisher = builder.create()
        except BaseException:
            self.close()
            raise

    def is_running(self):
        """Returns True if the system that was joined is still running.

        If the files of a system are removed, the system and this connection continue to use the
        files that they have opened.
        """
        if not self._has_owner():
            return False
        try:
            with open(self._page_path, "rb") as page:
                page.seek(RUN_OFFSET)
                return page.read(8) == self._run
        except FileNotFoundError:
            return True

    def publish(self, message):
        sample = self._publisher.loan_slice_uninit(len(message) // WORD_BYTES)
        ctypes.memmove(sample.payload_ptr, message, len(message))
        sample.assume_init().send()
        # The kernel increments the wake word and wakes the waiting subscribers.
        word = ctypes.addressof(self._word)
        _syscall(*map(ctypes.c_long, (FUTEX, word, FUTEX_WAKE_OP, MAX_WOKEN, 0, word, FUTEX_OP_ADD_ONE)))

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

    def _open(self, path, not_running):
        # The file is opened without blocking, in case it is a pipe.
        try:
            file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            raise not_running() from None
        self._files.append(file)
        _check_owner(path, lambda _: os.fstat(file), stat.S_ISREG, not_running)
        return file

    def _has_owner(self):
        try:
            fcntl.flock(self._lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        fcntl.flock(self._lock, fcntl.LOCK_UN)
        return False

    def _open_topic(self, iox, system, name, layout):
        builder = self._node.service_builder(iox.ServiceName.new(name)).publish_subscribe(iox.Slice[ctypes.c_uint64])
        try:
            service = builder.open()
        except iox.PublishSubscribeOpenError as cause:
            if "DoesNotExist" not in str(cause):
                raise FeedError(f"opening the topic `{name}`: {cause}") from cause
            raise FeedError(
                f'feeding the system {system!r}: its topic "{name}" is not open; set source = "bus" in [ingest] of its launch file, '
                "or wait until ingest has started"
            ) from None
        found = "".join(attribute.value.to_string() for attribute in service.attributes.values)
        if found != layout:
            raise FeedError(
                f"opening the topic `{name}`: the layout on the bus differs\n  here:  {layout}\n  there: {found}\n"
                "use the Python package of the running version of plumb"
            )
        return service


class Sensor(_Topic):
    """Publisher of IMU readings, with or without a magnetometer."""

    LAYOUT = (
        "plumbline.SensorReading.1 80 t_sensor_ns:i64@0 rate_rad_s:[f64; 3]@8 force_m_s2:[f64; 3]@32 field_ut:[f64; 3]@56"
    )
    TOPIC_INDEX = 0

    def __init__(self, system: str) -> None:
        super().__init__(system, "sensor", self.TOPIC_INDEX, self.LAYOUT)

    def send(self, t_ns: int, rate_rad_s: Numbers, force_m_s2: Numbers, field_ut: "Numbers | None" = None) -> None:
        """Publishes a reading without blocking.

        `t_ns` is the time of the measurement on the sensor's clock, in ns, as an integer. The rate
        (rad/s), the specific force (m/s²) and the optional field (µT) are three numbers each, in
        sensor axes.

        If the system has been restarted, the publisher joins it again. If the system is not
        running, the reading is discarded and FeedError is raised.
        """
        field_ut = (math.nan,) * 3 if field_ut is None else field_ut
        self.publish(struct.pack("=q9d", operator.index(t_ns), *_three(rate_rad_s), *_three(force_m_s2), *_three(field_ut)))


class Receiver(_Topic):
    """Publisher of fixes from a satellite receiver."""

    LAYOUT = (
        "plumbline.ReceiverReading.2 64 velocity_m_s:[f64; 3]@0 velocity_sd_m_s:f64@24 age_s:f64@32 "
        "latitude_rad:f64@40 longitude_rad:f64@48 altitude_m:f64@56"
    )
    TOPIC_INDEX = 1

    def __init__(self, system: str) -> None:
        super().__init__(system, "receiver", self.TOPIC_INDEX, self.LAYOUT)

    def send(
        self,
        velocity_m_s: Numbers,
        sd_m_s: "float | None" = None,
        age_s: "float | None" = None,
        latitude_rad: "float | None" = None,
        longitude_rad: "float | None" = None,
        altitude_m: "float | None" = None,
    ) -> None:
        """Publishes a fix, which ingest combines with the next sensor reading.

        The velocity over ground has the components east, north and up. None means unknown.
        """
        known = (sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m)
        values = (math.nan if value is None else value for value in known)
        self.publish(struct.pack("=8d", *_three(velocity_m_s), *values))


def _three(numbers):
    x, y, z = numbers
    return x, y, z


def _node(iox, system):
    config = iox.config.default()
    shared = config.global_cfg
    shared.prefix = iox.FileName.new(f"plumbline.{system}.")
    shared.root_path = iox.Path.new(f"{SHARED_MEMORY}/plumbline.{system}")
    # The supervisor removes the resources of killed processes.
    shared.node.cleanup_dead_nodes_on_creation = False
    shared.node.cleanup_dead_nodes_on_destruction = False
    shared.service.cleanup_dead_nodes_on_open = False
    iox.set_log_level(iox.LogLevel.Fatal)
    builder = iox.NodeBuilder.new().name(iox.NodeName.new("driver")).config(config)
    return builder.signal_handling_mode(iox.SignalHandlingMode.Disabled).create(iox.ServiceType.Ipc)


def _check_owner(path, read_status, is_kind, not_running):
    """Raises FeedError unless the file is of the given kind and accessible only to this user."""
    try:
        found = read_status(path)
    except FileNotFoundError:
        raise not_running() from None
    is_private = found.st_uid == os.geteuid() and not found.st_mode & 0o077
    if not is_kind(found.st_mode) or not is_private or (stat.S_ISREG(found.st_mode) and found.st_nlink > 1):
        raise FeedError(f"using {path}: it is not accessible to this user only; run the program as the user of the system (sudo -u '#{found.st_uid}' python3 …)")


def _iceoryx2():
    try:
        import iceoryx2
        from importlib.metadata import version
    except ImportError as cause:
        raise FeedError(f"joining a bus: {cause}; run pip install iceoryx2=={ICEORYX2}") from None
    if version("iceoryx2") != ICEORYX2:
        found = version("iceoryx2")
        raise FeedError(f"joining a bus: found iceoryx2 {found}, expected {ICEORYX2}; run pip install iceoryx2=={ICEORYX2}")
    return iceoryx2


_syscall = ctypes.CDLL(None).syscall
