"""Subscriptions to a running system, and publishers to it."""

import itertools
import json
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import LIMIT_S, System

from plumbline_ahrs import Flags, Sensor, Subscriber

def test_iteration_yields_successive_attitudes(simulated: System) -> None:
    with simulated.subscriber() as subscriber:
        assert subscriber.topic == "attitude"
        attitudes = list(itertools.islice(subscriber, 50))
        assert not subscriber.overflowed
    ticks = [int(attitude["tick"]) for attitude in attitudes]
    assert ticks == list(range(ticks[0], ticks[0] + 50))
    for attitude in attitudes:
        assert attitude["t_end_ns"] >= 0
        assert np.linalg.norm(attitude["quaternion"]) == pytest.approx(1.0)
        assert abs(attitude["yaw_rad"]) <= np.pi
        assert 0.0 <= attitude["inclination_sd_rad"] <= np.pi
        assert Flags(int(attitude["flags"])) in ~Flags(0)


def test_read_returns_all_buffered_messages(simulated: System) -> None:
    with simulated.subscriber() as subscriber:
        first = next(subscriber)
        ticks = [int(first["tick"])]
        while len(ticks) < 100:
            messages = subscriber.read()
            assert messages.dtype == subscriber.dtype
            ticks += messages["tick"].tolist()
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))


def test_frame_is_applied(simulated: System) -> None:
    with simulated.subscriber() as native, simulated.subscriber(frame="ned-frd") as other:
        pairs: dict[int, list[np.void]] = defaultdict(list)
        deadline_s = time.monotonic() + LIMIT_S
        while not any(len(pair) == 2 for pair in pairs.values()):
            assert time.monotonic() < deadline_s
            for subscriber in (native, other):
                for message in subscriber.read():
                    pairs[int(message["tick"])].append(message)
    first, second = next(pair for pair in pairs.values() if len(pair) == 2)
    right, forward, up = first["rate_rad_s"]
    assert second["rate_rad_s"].tolist() == [forward, right, -up]
    assert first["course_rad"] == second["course_rad"]


def test_every_topic_has_a_type(simulated: System, plumb: str) -> None:
    listed = subprocess.run(
        [plumb, "topic", "list", "--json", "--for", "1ms", "--system", simulated.name],
        check=True, capture_output=True, text=True,
    )
    topics = [topic["topic"] for topic in json.loads(listed.stdout)["topics"]]
    assert "imu" in topics
    for topic in topics:
        with simulated.subscriber(topic) as subscriber:
            assert subscriber.dtype.names


def test_subscriber_moves_between_threads(simulated: System) -> None:
    with simulated.subscriber("imu") as subscriber:
        ticks: list[int] = []
        thread = threading.Thread(target=lambda: ticks.append(int(next(subscriber)["tick"])))
        thread.start()
        thread.join()
        assert next(subscriber)["tick"] > ticks[0]


def test_silent_topic_times_out(simulated: System) -> None:
    with simulated.subscriber("gnss") as subscriber:
        with pytest.raises(TimeoutError, match=r"no message of the topic gnss within 0\.01 s"):
            subscriber.read(0.01)


def test_closed_subscriber_frees_its_place(simulated: System) -> None:
    for _ in range(6):
        with simulated.subscriber() as subscriber:
            next(subscriber)
    with pytest.raises(ValueError, match="the subscriber is closed"):
        next(subscriber)


def test_interrupt_ends_the_wait(simulated: System) -> None:
    code = (
        "import signal; from plumbline_ahrs import Subscriber\n"
        # A shell lets programs in the background ignore the signal.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"with Subscriber({simulated.name!r}, 'gnss') as subscriber:\n"
        "    print('waiting', flush=True)\n"
        "    next(subscriber)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"waiting\n"
        process.send_signal(signal.SIGINT)
        assert b"KeyboardInterrupt" in process.communicate(timeout=LIMIT_S)[1]


def test_iteration_ends_with_the_system(plumb: str, tmp_path: Path) -> None:
    system = System(plumb, tmp_path, "sim", "--source", "sim:s1")
    subscriber = system.subscriber()
    next(subscriber)
    system.stop()
    last = 0
    for attitude in subscriber:
        last = int(attitude["tick"])
    assert last > 0
    with pytest.raises(ConnectionError, match=f'system "{system.name}" has ended'):
        subscriber.read()
    with pytest.raises(ConnectionError, match="it is not running; start it with `plumb up`"):
        Subscriber(system.name)


def test_published_readings_arrive(plumb: str, tmp_path: Path) -> None:
    pytest.importorskip("iceoryx2")
    system = System(plumb, tmp_path, "bus")
    try:
        subscriber = system.subscriber("imu")
        system.subscriber("sensor").close()
        sensor = Sensor(system.name)
        deadline_s = time.monotonic() + LIMIT_S
        number = 0
        while True:
            number += 1
            sensor.send(number * 10_000_000, (0.0, 0.0, 0.25), (0.0, 0.0, 9.81))
            try:
                message = subscriber.read(0.01)[0]
                break
            except TimeoutError:
                assert time.monotonic() < deadline_s
        assert message["rate_rad_s"].tolist() == [0.0, 0.0, 0.25]
        sensor.close()
    finally:
        system.stop()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"topic": "atitude"}, ValueError, "unknown topic `atitude`; did you mean `attitude`?"),
        ({"frame": "ned"}, ValueError, "unknown frame `ned`; choose one of enu-rfu"),
        ({"topic": "imu", "frame": "ned-frd"}, ValueError, "messages of the topic imu have no other frame"),
        ({"system": "No System"}, ValueError, "invalid system name"),
        ({"timeout_s": -1.0}, ValueError, "timeout_s is -1; choose 0 to"),
        ({"system": "python-not-running"}, ConnectionError, "it is not running; start it with `plumb up`"),
    ],
)
def test_invalid_subscriptions_are_rejected(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Subscriber(**arguments)
