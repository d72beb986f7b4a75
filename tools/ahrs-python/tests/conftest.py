"""Recordings and systems of the tests."""

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, TypeAlias

import pytest

import plumbline_ahrs
from plumbline_ahrs import Recording, Subscriber

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ROOT / "samples/broad.csv.gz"

Frame: TypeAlias = Literal["enu-rfu", "ned-frd"]

LIMIT_S = 60.0
"""Longest wait for an event that must happen."""

LAUNCH = """\
name = "{name}"
services = ["ingest", "gyro", "accel", "fuser", "course"]
state_file = "off"
[ingest]
source = "{source}"
"""


@pytest.fixture(scope="session")
def sample() -> Recording:
    """Return the sample recording of the tree."""
    return plumbline_ahrs.read(SAMPLE)


@pytest.fixture(scope="session")
def plumb() -> str:
    """Return the path of the program `plumb`."""
    path = os.environ.get("PLUMB")
    if path is None:
        pytest.skip("set PLUMB to the program `plumb`")
    return path


def data(pattern: str) -> list[Path]:
    """Return the files of the folder PLUMBLINE_DATA that match the pattern."""
    return sorted(Path(os.environ.get("PLUMBLINE_DATA", ROOT.parent / "shared/data")).glob(pattern))


class System:
    """System of `plumb up` with its own name."""

    def __init__(self, plumb: str, folder: Path, source: str, *options: str) -> None:
        self.name = f"python-{os.getpid()}-{time.monotonic_ns() % 1_000_000}"
        launch = folder / "launch.toml"
        launch.write_text(LAUNCH.format(name=self.name, source=source), encoding="utf-8")
        command = [plumb, "up", "--quiet", "--launch", str(launch), *options]
        self.log = folder / "log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)

    def stop(self) -> None:
        """End the system and wait for its end."""
        self.process.terminate()
        try:
            self.process.wait(LIMIT_S)
        finally:
            self.process.kill()

    def subscriber(self, topic: str = "attitude", frame: Frame = "enu-rfu") -> Subscriber:
        """Return a subscriber, as soon as the topic is open."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            try:
                return Subscriber(self.name, topic, frame=frame, timeout_s=LIMIT_S)
            except ConnectionError:
                assert self.process.poll() is None, self.log.read_text(encoding="utf-8")
                assert time.monotonic() < deadline_s
                time.sleep(0.05)


@pytest.fixture(scope="session")
def simulated(plumb: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """Return a running system with a simulation in real time."""
    system = System(plumb, tmp_path_factory.mktemp("system"), "sim", "--source", "sim:s1")
    system.subscriber().close()
    yield system
    system.stop()
