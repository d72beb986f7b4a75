#!/usr/bin/env python3
"""Soak test: disturbs a running system by kills, freezes, swaps, shadows and frozen observers.

    tests/soak.py [--seconds 1200] [--seed 1] [--pause 1.0] [--plumb target/release/plumb] [--everything]

The exit code is 0 if no tick was lost or duplicated, no file was left behind and no resource use
grew. Two checks detect growth. The first compares the medians of resident memory, descriptors,
shared memory and files in the second quarter of the run with those in the last quarter. The second
fits a line to the resident memory of each process, private and mapped from the bus, over the second
half of the run. It prints the slope with its standard error and one of three verdicts: the memory
grows by more than the bound, it does not grow, or the run is too short to decide. Slopes are judged
only in runs of at least 20 minutes, because in its first minutes a process allocates memory that it
keeps.

With `--everything` the system reads a sensor on a pseudo-terminal, records its flight and writes
its attitudes. Bridges, monitors, a second recording, calibrations and browsers are attached, and
are killed and frozen, too. A replay of the flight must yield the same attitudes.
"""

import argparse
import base64
import filecmp
import itertools
import json
import math
import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import tty
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
    arguments.add_argument("--everything", action="store_true", help="Attach a sensor, recordings, bridges and browsers")
    arguments.add_argument("--ros-router", metavar="ENDPOINT", help="Zenoh router for the ROS 2 bridge of --everything")
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        soak = Everything if options.everything else Soak
        return soak(options, Path(folder), random.Random(options.seed)).run(options.seconds)


class Soak:
    services_beside = ["gateway"]
    keys, sections = "", ""
    up_options = []

    def __init__(self, options, folder, rng):
        self.plumb, self.rng, self.pause_s, self.name = options.plumb, rng, options.pause, f"soak-{os.getpid()}"
        self.observers, self.station, self.counts, self.samples, self.error = [], None, {}, [], ""
        self.disturbances = [self.kill, self.freeze, self.swap, self.swap, self.shadow, self.freeze_observer]
        launch = folder / "launch.toml"
        services = json.dumps(["ingest", *STAGES, *self.services_beside])
        launch.write_text(
            f'name = "{self.name}"\nservices = {services}\n{self.keys}[restart]\nmin_uptime_s = 0\n{self.sections}'
        )
        self.log, self.report = folder / "log", folder / "report"
        command = [self.plumb, "up", "--launch", launch, "--json", *self.up_options]
        environment = os.environ | {"XDG_STATE_HOME": str(folder)}
        with open(self.log, "wb") as log, open(self.report, "wb") as report:
            self.system = subprocess.Popen(command, stdout=report, stderr=log, env=environment)

    def run(self, seconds):
        try:
            self.wait_for("the system to run", lambda: self.services() and all(s["state"] == "running" for s in self.services()))
            self.wait_for("the gateway to listen", lambda: self.address("gateway"))
            command = [self.plumb, "station", "--connect", self.address("gateway")]
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
            disturbance = self.rng.choice(self.disturbances)
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

    def address(self, service):
        return next((s["address"] for s in self.services() if s["service"] == service), None)

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


class Everything(Soak):
    """Soak test with a real-time sensor and everything attached that can be."""

    services_beside = ["gateway", "cockpit"]
    # The sensor does not wait while a busy machine restarts a service.
    keys = "buffer_s = 10\nlateness_s = 8\n"

    def __init__(self, options, folder, rng):
        self.sensor = Sensor()
        self.flights, self.out = folder / "flights", folder / "attitude.csv"
        self.sections = (
            f'silence_s = 2\n[ingest]\nsource = "serial"\n[ingest.serial]\nport = "{self.sensor.port}"\nformat = "csv"\n'
            f'rate_hz = {SENSOR_RATE_HZ}\nclock = "device"\n[cockpit]\nlisten = "127.0.0.1:0"\n'
        )
        self.up_options = ["--record", self.flights, "--out", self.out]
        super().__init__(options, folder, rng)
        self.disturbances = [self.kill, self.freeze, self.swap, self.swap, self.shadow, self.disturb_attached]
        ports = itertools.count(1)
        self.commands = [
            lambda: ["top", "--lines", "--system", self.name],
            lambda: ["bridge", "mavlink", "--to", "udpout:127.0.0.1:14999", "--system", self.name],
            lambda: self.rng.choice(
                [
                    ["record", "-o", folder / f"part-{next(ports)}.mcap", "--for", "5s", "--system", self.name],
                    ["calibrate", "gyro", "--live", "--for", "5s", "--system", self.name],
                    ["topic", "echo", "attitude", "--json", "--system", self.name],
                    ["view", "--listen", "127.0.0.1:18088", "--for", "5s", "--system", self.name],
                ]
            ),
        ]
        if options.ros_router:
            self.commands.append(lambda: ["bridge", "ros", "--connect", options.ros_router, "--system", self.name])
        self.attached, self.viewers = {}, []

    def disturb(self, seconds):
        port = int(self.address("cockpit").split("#")[0].rstrip("/").rsplit(":", 1)[1])
        self.viewers = [Viewer(port, reads=reads) for reads in (True, True, False)]
        # The first choices attach every command.
        self.disturbances.append(self.disturb_attached)
        super().disturb(seconds)
        for process in self.attached.values():
            process.kill()
        self.sensor.stop()
        # The last readings may still be on their way.
        time.sleep(1)

    def disturb_attached(self):
        """Kills or freezes an attached program, and starts every one that does not run."""
        for index, command in enumerate(self.commands):
            process = self.attached.get(index)
            if process is None or process.poll() is not None:
                words = [self.plumb, *map(str, command())]
                self.attached[index] = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        process = self.rng.choice(list(self.attached.values()))
        process.send_signal(self.rng.choice([signal.SIGKILL, signal.SIGSTOP, signal.SIGCONT]))
        if self.rng.random() < 0.2:
            self.rng.choice(self.viewers).reconnect()

    def evaluate(self, seconds):
        code = super().evaluate(seconds)
        (flight,) = self.flights.iterdir()
        again = self.out.with_name("again.csv")
        replay = [self.plumb, "up", "--replay", flight, "--speed", "max", "--out", again]
        replay = subprocess.run(replay, cwd=self.flights, capture_output=True, text=True, check=False)
        same = replay.returncode == 0 and filecmp.cmp(self.out, again, shallow=False)
        with open(self.out, encoding="ascii") as lines:
            times = [float(line.split(",")[0]) for line in lines if line[0].isdigit()]
        complete = len(times) == round((times[-1] - times[0]) * SENSOR_RATE_HZ) + 1
        megabytes = sum(viewer.received for viewer in self.viewers) / 1e6
        print(f"readings sent {self.sensor.sent}, from {times[0]} s to {times[-1]} s {'all' if complete else 'not all'} arrived")
        print(f"received by browsers {megabytes:.0f} MB; replay: {'the same bytes' if same else replay.stderr}")
        return code if same and complete else 1


# Rate of the sensor of `--everything`, Hz.
SENSOR_RATE_HZ = 200


class Sensor:
    """Sensor that writes lines of numbers to a pseudo-terminal, at a fixed rate."""

    def __init__(self):
        self.controller, device = os.openpty()
        tty.setraw(device)
        self.port, self.sent, self.stopped = os.ttyname(device), 0, False
        self.thread = threading.Thread(target=self.write, daemon=True)
        self.thread.start()

    def write(self):
        start = time.monotonic()
        while not self.stopped:
            t = self.sent / SENSOR_RATE_HZ
            rate = [0.3 * math.sin(0.7 * t), 0.2 * math.cos(0.5 * t), 0.1]
            tilt = 0.4 * math.sin(0.3 * t)
            numbers = [t, *rate, 9.81 * math.sin(tilt), 0.0, 9.81 * math.cos(tilt)]
            os.write(self.controller, (",".join(f"{number:.6f}" for number in numbers) + "\n").encode())
            self.sent += 1
            time.sleep(max(start + self.sent / SENSOR_RATE_HZ - time.monotonic(), 0))

    def stop(self):
        self.stopped = True
        self.thread.join(10)


class Viewer:
    """Connection of a browser to the cockpit. It reads all pictures or none, and reconnects."""

    def __init__(self, port, reads):
        self.port, self.reads, self.received = port, reads, 0
        self.connection = None
        threading.Thread(target=self.view, daemon=True).start()

    def reconnect(self):
        if self.connection:
            self.connection.close()

    def view(self):
        key = base64.b64encode(os.urandom(16)).decode()
        request = (
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n"
        )
        while True:
            try:
                with socket.create_connection(("127.0.0.1", self.port), 5) as self.connection:
                    self.connection.sendall(request.encode())
                    while self.reads and (data := self.connection.recv(1 << 16)):
                        self.received += len(data)
                    time.sleep(5)
            except OSError:
                time.sleep(1)


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
