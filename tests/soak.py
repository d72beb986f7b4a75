#!/usr/bin/env python3
"""Kills, freezes, swaps, shadows and frozen readers for a while: nothing may be lost, and nothing may grow.

    tests/soak.py [--seconds 1200] [--seed 1] [--pause 1.0] [--plumb target/release/plumb]

Exit code 0 when no tick was lost or came twice and nothing grew: neither resident memory, descriptors, shared memory and files from the
second quarter of the time to the last, nor the resident memory of any process over the second half. Of that, private and mapped from
the bus, it tells the slope and its standard error, and what they show: it grows by more than the bound, it does not, or this cannot be
told in this time. In the first minutes every process takes memory that it then keeps, so slopes are judged from 20 minutes on.
"""

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

STAGES = {
    "gyro": ["mobius", "mobius-coning", "rk4", "euler"],
    "accel": ["projector", "inclinometer-matrix", "inclinometer-quaternion"],
    "fuser": ["multiple-model", "wz", "wz-open", "wz-closed", "madgwick", "madgwick-improved", "levelling", "levelling-unified", "levelling-pi", "aided", "vqf"],
    "course": ["angles", "track"],
}
# What is looked at of every process.
PROCESS = ("private_kib", "mapped_kib", "mappings", "descriptors")
# A service is started again within this, or the soak has failed, s.
BACK_LIMIT_S = 30
READERS_MAX = 3
# Growth that is noise: a share, and what comes with a page, a port or a log line.
NOISE = {
    "private_kib": (0.10, 2048),
    "mapped_kib": (0.10, 8192),
    "mappings": (0.10, 40),
    "descriptors": (0.0, 4),
    "shared_kib": (0.10, 1024),
    "files": (0.10, 20),
}
# What a process may grow by in an hour of this, KiB. Of private memory that is about 100 bytes for each of 5,000 disturbances; what is mapped
# from the bus is bounded by the topics, and varies with what was on them.
GROWTH_MAX_KIB_H = {"private_kib": 512, "mapped_kib": 4096}
# A shorter time shows only what is taken once.
SLOPE_FROM_S = 1200


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=1200)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--pause", type=float, default=1.0, help="between two disturbances at most, s")
    arguments.add_argument("--plumb", default=str(Path(__file__).parent.parent / "target/release/plumb"))
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return Soak(asked.plumb, Path(folder), random.Random(asked.seed), asked.pause).run(asked.seconds)


class Soak:
    def __init__(self, plumb, folder, chance, pause_s):
        self.plumb, self.chance, self.pause_s, self.name = plumb, chance, pause_s, f"soak-{os.getpid()}"
        self.readers, self.station, self.done, self.samples, self.refusal = [], None, {}, [], ""
        launch = folder / "launch.toml"
        services = ["ingest", *STAGES, "gateway"]
        launch.write_text(f'name = "{self.name}"\nservices = {json.dumps(services)}\n[restart]\nmin_uptime_s = 0\n')
        self.log, self.report = folder / "log", folder / "report"
        with open(self.log, "wb") as log, open(self.report, "wb") as report:
            self.system = subprocess.Popen([plumb, "up", launch, "--json"], stdout=report, stderr=log)

    def run(self, seconds):
        try:
            self.until("the system runs", lambda: self.services() and all(s["state"] == "running" for s in self.services()))
            self.until("the gateway listens", self.gateway)
            command = [self.plumb, "station", "--connect", self.gateway()]
            self.station = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.disturb(seconds)
        finally:
            for reader in [*self.readers, *filter(None, [self.station])]:
                reader.kill()
            self.system.send_signal(signal.SIGINT)
            self.system.wait(60)
        return self.judge(seconds)

    def disturb(self, seconds):
        begin = time.monotonic()
        next_sample = begin
        while (now := time.monotonic()) < begin + seconds:
            if now >= next_sample:
                next_sample = now + max(seconds / 200, 1)
                self.samples.append(self.measure())
            what = self.chance.choice([self.kill, self.freeze, self.swap, self.swap, self.shadow, self.read])
            what()
            self.done[what.__name__] = self.done.get(what.__name__, 0) + 1
            time.sleep(self.chance.uniform(0.3, 1.0) * self.pause_s)
            if self.system.poll() is not None:
                sys.exit(f"the system ended:\n{self.log.read_text()}")

    def kill(self):
        self.hit(signal.SIGKILL)

    def freeze(self):
        self.hit(signal.SIGSTOP)

    def hit(self, what):
        service = self.chance.choice([s for s in self.services() if s["service"] in STAGES])
        if service["pid"]:
            os.kill(service["pid"], what)
            self.until("another incarnation", lambda: self.pid(service["service"]) not in (0, service["pid"]))

    def swap(self):
        slot = self.chance.choice(list(STAGES))
        answer = self.ask("swap", slot, self.chance.choice(STAGES[slot]))
        if not answer:
            sys.exit(f"a swap was not answered: {self.refusal}\n{self.log.read_text()}")
        if answer["outcome"] != "committed":
            print(f"not committed: {answer}")

    def shadow(self):
        """A stage beside the one in the slot, which ends with whoever asked for it."""
        slot = self.chance.choice(list(STAGES))
        command = [self.plumb, "shadow", slot, self.chance.choice(STAGES[slot]), "--system", self.name]
        shadow = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(self.chance.uniform(0.2, 2.0))
        shadow.kill()
        shadow.wait()

    def read(self):
        """A reader that freezes; the oldest one is killed where it stands."""
        command = [self.plumb, "topic", "echo", "attitude", "--json", "--system", self.name]
        reader = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.readers.append(reader)
        time.sleep(0.2)
        reader.send_signal(signal.SIGSTOP)
        if len(self.readers) > READERS_MAX:
            oldest = self.readers.pop(0)
            oldest.kill()
            oldest.wait()

    def measure(self):
        pids = {"supervisor": self.system.pid} | {s["service"]: s["pid"] for s in self.services() if s["pid"]}
        processes = {name: found for name, pid in pids.items() if (found := process(pid))}
        shared = self.carried()
        total = {what: sum(one[what] for one in processes.values()) for what in PROCESS}
        files = {"shared_kib": sum(kib(path) for path in shared), "files": len(shared)}
        return {"at_h": time.monotonic() / 3600, "processes": processes} | total | files

    def carried(self):
        """Everything that carries the system's name; what goes while it is looked at is left out."""
        folder = Path(f"/dev/shm/plumbline.{self.name}")
        segments = list(folder.parent.glob(f"{folder.name}.*"))
        walked = [Path(at) / name for at, folders, files in os.walk(folder) for name in folders + files]
        return segments + walked + [folder] * folder.exists()

    def judge(self, seconds):
        report = json.loads(self.report.read_text().splitlines()[-1])
        whole = (report["lost"], report["duplicated"]) == (0, 0) and self.system.returncode == 0
        print(f"{self.done}; ticks {report['ticks_out']}, lost {report['lost']}, duplicated {report['duplicated']}")
        grew = False
        quarter = max(len(self.samples) // 4, 1)
        for what, (share, constant) in NOISE.items():
            before = statistics.median(sample[what] for sample in self.samples[quarter : 2 * quarter] or self.samples)
            after = statistics.median(sample[what] for sample in self.samples[-quarter:])
            grows = after > before * (1 + share) + constant
            grew |= grows
            print(f"{what}: {before:.0f} → {after:.0f}{', which is growth' if grows else ''}")
        grew |= self.judge_slopes(seconds)
        left = [path.name for path in self.carried()]
        print(f"left behind: {left}")
        if not whole:
            print(self.log.read_text())
        return 0 if whole and not grew and not left else 1

    def judge_slopes(self, seconds):
        """Whether the memory of a process grew over the second half; a short time tells nothing of it."""
        half = self.samples[len(self.samples) // 2 :]
        grew = False
        for name in self.samples[-1]["processes"]:
            seen = [(sample["at_h"], sample["processes"][name]) for sample in half if name in sample["processes"]]
            told = []
            for what, bound in GROWTH_MAX_KIB_H.items():
                points = [(at_h, one[what]) for at_h, one in seen]
                slope, error = line(points)
                verdict = judged(slope, error, bound) if seconds >= SLOPE_FROM_S else TOO_SHORT
                grew |= verdict == GROWS
                middle = statistics.median(kib for _, kib in points)
                told.append(f"{what} {middle:.0f}, {slope:+.0f} ± {error:.0f} an hour: {verdict}")
            print(f"{name}: {'; '.join(told)}")
        return grew

    def gateway(self):
        return next((s["address"] for s in self.services() if s["service"] == "gateway"), None)

    def services(self):
        return self.ask("status") or []

    def pid(self, service):
        return next((s["pid"] for s in self.services() if s["service"] == service), 0)

    def ask(self, *words):
        command = [self.plumb, *words, "--json", "--system", self.name]
        answered = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
        self.refusal = answered.stderr
        answer = json.loads(answered.stdout.splitlines()[-1]) if answered.stdout.strip() else None
        # What failed is an object, too.
        return None if isinstance(answer, dict) and "error" in answer else answer

    def until(self, what, done):
        deadline = time.monotonic() + BACK_LIMIT_S
        while not done():
            if time.monotonic() > deadline:
                sys.exit(f"waited in vain until: {what}\n{self.log.read_text()}")
            time.sleep(0.02)


GROWS, STEADY = "it grows", "it does not grow"
UNKNOWN, TOO_SHORT = "cannot be told in this time", "the time is too short for a verdict"


def judged(slope, error, bound):
    """What a slope shows of a bound, with a risk of one in forty.

    >>> [judged(slope, 100, 512) for slope in (800, 600, 400, 200, -900, float("nan"))]
    ['it grows', 'cannot be told in this time', 'cannot be told in this time', 'it does not grow', 'it does not grow', 'cannot be told in this time']
    """
    if slope - 2 * error > bound:
        return GROWS
    return STEADY if slope + 2 * error < bound else UNKNOWN


def line(points):
    """Slope of the line of least squares, and its standard error. A process keeps what it has, so that a sample says little that the one
    before has not said: they count for as many as are independent, by the correlation of neighbours.

    >>> line([(0, 1), (1, 3), (2, 5), (3, 7)])
    (2.0, 0.0)
    >>> noise = random.Random(1)
    >>> slope, error = line([(x, 2 * x + noise.gauss(0, 1)) for x in range(100)])
    >>> abs(slope - 2) < 2 * error < 0.02
    True
    >>> slope, error = line([(x, 1000 * (x >= 70)) for x in range(100)])  # one step is no slope
    >>> 2 * error > slope
    True
    """
    if len(points) < 4:
        return float("nan"), float("nan")
    mean_x, mean_y = (statistics.fmean(axis) for axis in zip(*points))
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in points) / spread
    left = [y - mean_y - slope * (x - mean_x) for x, y in points]
    squares = sum(one**2 for one in left)
    if squares == 0:
        return slope, 0.0
    correlation = max(sum(a * b for a, b in zip(left, left[1:])) / squares, 0.0)
    independent = max(len(left) * (1 - correlation) / (1 + correlation), 3.0)
    return slope, (squares / (independent - 2) / spread) ** 0.5


def process(pid):
    """What a process has; none where it has just ended."""
    try:
        status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        mappings = len(Path(f"/proc/{pid}/maps").read_text().splitlines())
        descriptors = len(os.listdir(f"/proc/{pid}/fd"))
        private, mapped = (int(status[what].split()[0]) for what in ("RssAnon", "RssShmem"))
    except (OSError, KeyError):
        return None
    return dict(zip(PROCESS, (private, mapped, mappings, descriptors)))


def kib(path):
    try:
        return path.stat().st_blocks / 2
    except OSError:
        return 0


if __name__ == "__main__":
    sys.exit(main())
