#!/usr/bin/env python3
"""Soak test: disturbs a running system by kills, freezes, swaps, shadows and frozen observers.

    tests/soak.py [--seconds 1200] [--seed 1] [--pause 1.0] [--plumb target/release/plumb]

The exit code is 0 if no tick was lost or duplicated, no file was left behind and no resource use
grew. Two checks detect growth. The first compares the medians of resident memory, descriptors,
shared memory and files in the second quarter of the run with those in the last quarter. The second
fits a line to the resident memory of each process, private and mapped from the bus, over the second
half of the run. It prints the slope with its standard error and one of three verdicts: the memory
grows by more than the bound, it does not grow, or the run is too short to decide. Slopes are judged
only in runs of at least 20 minutes, because in its first minutes a process allocates memory that it
keeps.
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
# Quantities measured for each process.
PROCESS = ("private_kib", "mapped_kib", "mappings", "descriptors")
# Time allowed for a service to restart, s.
RESTART_TIMEOUT_S = 30
MAX_OBSERVERS = 3
# Largest growth that still counts as noise: a fraction of the value plus a constant.
NOISE = {
    "private_kib": (0.10, 2048),
    "mapped_kib": (0.10, 8192),
    "mappings": (0.10, 40),
    "descriptors": (0.0, 4),
    "shared_kib": (0.10, 1024),
    "files": (0.10, 20),
}
# Maximum growth of a process, KiB/h. For private memory, this corresponds to about 100 bytes for
# each of 5,000 disturbances. Memory mapped from the bus has a larger bound, because it varies with
# the contents of the topics. The topics also limit its total size.
MAX_GROWTH_KIB_H = {"private_kib": 512, "mapped_kib": 4096}
# Minimum duration of a run in which slopes are judged, s. A shorter run shows only the initial
# allocations.
MIN_SLOPE_S = 1200


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=1200)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--pause", type=float, default=1.0, help="Maximum pause between two disturbances, s")
    arguments.add_argument("--plumb", default=str(Path(__file__).parent.parent / "target/release/plumb"))
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return Soak(options.plumb, Path(folder), random.Random(options.seed), options.pause).run(options.seconds)


class Soak:
    def __init__(self, plumb, folder, rng, pause_s):
        self.plumb, self.rng, self.pause_s, self.name = plumb, rng, pause_s, f"soak-{os.getpid()}"
        self.observers, self.station, self.counts, self.samples, self.error = [], None, {}, [], ""
        launch = folder / "launch.toml"
        services = ["ingest", *STAGES, "gateway"]
        launch.write_text(f'name = "{self.name}"\nservices = {json.dumps(services)}\n[restart]\nmin_uptime_s = 0\n')
        self.log, self.report = folder / "log", folder / "report"
        with open(self.log, "wb") as log, open(self.report, "wb") as report:
            self.system = subprocess.Popen([plumb, "up", "--launch", launch, "--json"], stdout=report, stderr=log)

    def run(self, seconds):
        try:
            self.wait_for("the system to run", lambda: self.services() and all(s["state"] == "running" for s in self.services()))
            self.wait_for("the gateway to listen", self.gateway)
            command = [self.plumb, "station", "--connect", self.gateway()]
            self.station = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.disturb(seconds)
        finally:
            for observer in [*self.observers, *filter(None, [self.station])]:
                observer.kill()
            self.system.send_signal(signal.SIGINT)
            self.system.wait(60)
        return self.evaluate(seconds)

    def disturb(self, seconds):
        start = time.monotonic()
        next_sample = start
        while (now := time.monotonic()) < start + seconds:
            if now >= next_sample:
                next_sample = now + max(seconds / 200, 1)
                self.samples.append(self.measure())
            disturbance = self.rng.choice([self.kill, self.freeze, self.swap, self.swap, self.shadow, self.freeze_observer])
            disturbance()
            self.counts[disturbance.__name__] = self.counts.get(disturbance.__name__, 0) + 1
            time.sleep(self.rng.uniform(0.3, 1.0) * self.pause_s)
            if self.system.poll() is not None:
                sys.exit(f"the system ended:\n{self.log.read_text()}")

    def kill(self):
        self.send_to_service(signal.SIGKILL)

    def freeze(self):
        self.send_to_service(signal.SIGSTOP)

    def send_to_service(self, signal_number):
        service = self.rng.choice([s for s in self.services() if s["service"] in STAGES])
        if service["pid"]:
            os.kill(service["pid"], signal_number)
            self.wait_for("another incarnation", lambda: self.pid(service["service"]) not in (0, service["pid"]))

    def swap(self):
        slot = self.rng.choice(list(STAGES))
        report = self.query("swap", slot, self.rng.choice(STAGES[slot]))
        if not report:
            sys.exit(f"no response to a swap request: {self.error}\n{self.log.read_text()}")
        if report["outcome"] != "committed":
            print(f"not committed: {report}")

    def shadow(self):
        """Starts a shadow and kills its client."""
        slot = self.rng.choice(list(STAGES))
        command = [self.plumb, "shadow", slot, self.rng.choice(STAGES[slot]), "--system", self.name]
        shadow = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(self.rng.uniform(0.2, 2.0))
        shadow.kill()
        shadow.wait()

    def freeze_observer(self):
        """Starts an observer and freezes it. Kills the oldest observer if there are too many."""
        command = [self.plumb, "topic", "echo", "attitude", "--json", "--system", self.name]
        observer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.observers.append(observer)
        time.sleep(0.2)
        observer.send_signal(signal.SIGSTOP)
        if len(self.observers) > MAX_OBSERVERS:
            oldest = self.observers.pop(0)
            oldest.kill()
            oldest.wait()

    def measure(self):
        pids = {"supervisor": self.system.pid} | {s["service"]: s["pid"] for s in self.services() if s["pid"]}
        processes = {name: figures for name, pid in pids.items() if (figures := process_figures(pid))}
        shared = self.files()
        total = {what: sum(one[what] for one in processes.values()) for what in PROCESS}
        files = {"shared_kib": sum(kib(path) for path in shared), "files": len(shared)}
        return {"at_h": time.monotonic() / 3600, "processes": processes} | total | files

    def files(self):
        """Returns all files of the system."""
        folder = Path(f"/dev/shm/plumbline.{self.name}")
        segments = list(folder.parent.glob(f"{folder.name}.*"))
        walked = [Path(at) / name for at, folders, files in os.walk(folder) for name in folders + files]
        return segments + walked + [folder] * folder.exists()

    def evaluate(self, seconds):
        report = json.loads(self.report.read_text().splitlines()[-1])
        passed = (report["lost"], report["duplicated"]) == (0, 0) and self.system.returncode == 0
        print(f"{self.counts}; ticks {report['ticks_out']}, lost {report['lost']}, duplicated {report['duplicated']}")
        grew = False
        quarter = max(len(self.samples) // 4, 1)
        for what, (share, constant) in NOISE.items():
            before = statistics.median(sample[what] for sample in self.samples[quarter : 2 * quarter] or self.samples)
            after = statistics.median(sample[what] for sample in self.samples[-quarter:])
            grows = after > before * (1 + share) + constant
            grew |= grows
            print(f"{what}: {before:.0f} → {after:.0f}{' (grows)' if grows else ''}")
        grew |= self.evaluate_slopes(seconds)
        left = [path.name for path in self.files()]
        print(f"left behind: {left}")
        if not passed:
            print(self.log.read_text())
        return 0 if passed and not grew and not left else 1

    def evaluate_slopes(self, seconds):
        """Returns True if the memory of a process grew over the second half of the run."""
        half = self.samples[len(self.samples) // 2 :]
        grew = False
        for name in self.samples[-1]["processes"]:
            figures = [(sample["at_h"], sample["processes"][name]) for sample in half if name in sample["processes"]]
            verdicts = []
            for what, bound in MAX_GROWTH_KIB_H.items():
                points = [(at_h, one[what]) for at_h, one in figures]
                slope, error = fit_line(points)
                verdict = judge_slope(slope, error, bound) if seconds >= MIN_SLOPE_S else TOO_SHORT
                grew |= verdict == GROWS
                middle = statistics.median(kib for _, kib in points)
                verdicts.append(f"{what} {middle:.0f}, {slope:+.0f} ± {error:.0f} per hour: {verdict}")
            print(f"{name}: {'; '.join(verdicts)}")
        return grew

    def gateway(self):
        return next((s["address"] for s in self.services() if s["service"] == "gateway"), None)

    def services(self):
        return (self.query("ps") or {}).get("services", [])

    def pid(self, service):
        return next((s["pid"] for s in self.services() if s["service"] == service), 0)

    def query(self, *words):
        command = [self.plumb, *words, "--json", "--system", self.name]
        output = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
        self.error = output.stderr
        value = json.loads(output.stdout.splitlines()[-1]) if output.stdout.strip() else None
        # A failed command prints an object with the key "error".
        return None if isinstance(value, dict) and "error" in value else value

    def wait_for(self, what, done):
        deadline = time.monotonic() + RESTART_TIMEOUT_S
        while not done():
            if time.monotonic() > deadline:
                sys.exit(f"timed out waiting for {what}\n{self.log.read_text()}")
            time.sleep(0.02)


GROWS, STEADY = "it grows", "it does not grow"
UNKNOWN, TOO_SHORT = "undecided in this time", "too short for a verdict"


def judge_slope(slope, error, bound):
    """Returns the verdict on a slope, with an error probability of 1/40.

    >>> [judge_slope(slope, 100, 512) for slope in (800, 600, 400, 200, -900, float("nan"))]
    ['it grows', 'undecided in this time', 'undecided in this time', 'it does not grow', 'it does not grow', 'undecided in this time']
    """
    if slope - 2 * error > bound:
        return GROWS
    return STEADY if slope + 2 * error < bound else UNKNOWN


def fit_line(points):
    """Returns the slope of the least-squares line and its standard error.

    Successive samples of a process are correlated. The standard error is therefore based on an
    effective number of independent samples, computed from the correlation of neighbours.

    >>> fit_line([(0, 1), (1, 3), (2, 5), (3, 7)])
    (2.0, 0.0)
    >>> noise = random.Random(1)
    >>> slope, error = fit_line([(x, 2 * x + noise.gauss(0, 1)) for x in range(100)])
    >>> abs(slope - 2) < 2 * error < 0.02
    True
    >>> slope, error = fit_line([(x, 1000 * (x >= 70)) for x in range(100)])  # a single step
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


def process_figures(pid):
    """Returns the measured quantities of a process, or None if it has exited."""
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
