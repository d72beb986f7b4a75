#!/usr/bin/env python3
"""Kills, freezes, exchanges and frozen readers for a while: nothing may be lost, and nothing may grow.

    tests/soak.py [--seconds 1200] [--seed 1] [--plumb target/release/plumb]

Exit code 0 when no tick was lost or came twice and resident memory, descriptors, shared memory and files did not grow from the
second quarter of the time to the last.
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
    "fuser": ["wz", "wz-open", "wz-closed", "madgwick", "madgwick-improved", "levelling", "levelling-pi", "aided", "vqf"],
    "course": ["angles", "track"],
}
# Between two disturbances, s.
PAUSE_S = (0.3, 1.0)
# A service is started again within this, or the soak has failed, s.
BACK_LIMIT_S = 30
READERS_MAX = 3
# Growth that is noise: a share, and what comes with a page, a port or a log line.
NOISE = {"resident_kib": (0.10, 2048), "descriptors": (0.0, 4), "shared_kib": (0.10, 1024), "files": (0.10, 20)}


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=1200)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--plumb", default=str(Path(__file__).parent.parent / "target/release/plumb"))
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return Soak(asked.plumb, Path(folder), random.Random(asked.seed)).run(asked.seconds)


class Soak:
    def __init__(self, plumb, folder, chance):
        self.plumb, self.chance, self.name = plumb, chance, f"soak-{os.getpid()}"
        self.readers, self.done, self.samples = [], {}, []
        launch = folder / "launch.toml"
        launch.write_text(f'name = "{self.name}"\n[restart]\nsettled_s = 0\n[ingest]\nsource = "sim"\n')
        self.log, self.report = folder / "log", folder / "report"
        with open(self.log, "wb") as log, open(self.report, "wb") as report:
            self.system = subprocess.Popen([plumb, "up", launch, "--json"], stdout=report, stderr=log)

    def run(self, seconds):
        try:
            self.until("the system runs", lambda: self.services() and all(s["state"] == "running" for s in self.services()))
            self.disturb(seconds)
        finally:
            for reader in self.readers:
                reader.kill()
            self.system.send_signal(signal.SIGINT)
            self.system.wait(60)
        return self.judge()

    def disturb(self, seconds):
        begin = time.monotonic()
        next_sample = begin
        while (now := time.monotonic()) < begin + seconds:
            if now >= next_sample:
                next_sample = now + max(seconds / 200, 1)
                self.samples.append(self.measure())
            what = self.chance.choice([self.kill, self.freeze, self.swap, self.swap, self.read])
            what()
            self.done[what.__name__] = self.done.get(what.__name__, 0) + 1
            time.sleep(self.chance.uniform(*PAUSE_S))
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
            self.until("another life", lambda: self.pid(service["service"]) not in (0, service["pid"]))

    def swap(self):
        slot = self.chance.choice(list(STAGES))
        answer = self.ask("swap", slot, self.chance.choice(STAGES[slot]))
        if answer["outcome"] != "committed":
            print(f"not committed: {answer}")

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
        pids = [self.system.pid, *(s["pid"] for s in self.services() if s["pid"])]
        shared = self.carried()
        return {
            "resident_kib": sum(resident_kib(pid) for pid in pids),
            "descriptors": sum(descriptors(pid) for pid in pids),
            "shared_kib": sum(kib(path) for path in shared),
            "files": len(shared),
        }

    def carried(self):
        """Everything that carries the system's name; what goes while it is looked at is left out."""
        folder = Path(f"/dev/shm/plumbline.{self.name}")
        segments = list(folder.parent.glob(f"{folder.name}.*"))
        walked = [Path(at) / name for at, folders, files in os.walk(folder) for name in folders + files]
        return segments + walked + [folder] * folder.exists()

    def judge(self):
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
        left = [path.name for path in self.carried()]
        print(f"left behind: {left}")
        if not whole:
            print(self.log.read_text())
        return 0 if whole and not grew and not left else 1

    def services(self):
        return self.ask("ps") or []

    def pid(self, service):
        return next((s["pid"] for s in self.services() if s["service"] == service), 0)

    def ask(self, *words):
        command = [self.plumb, *words, "--json", "--system", self.name]
        answer = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False).stdout
        return json.loads(answer.splitlines()[-1]) if answer.strip() else None

    def until(self, what, done):
        deadline = time.monotonic() + BACK_LIMIT_S
        while not done():
            if time.monotonic() > deadline:
                sys.exit(f"waited in vain until: {what}\n{self.log.read_text()}")
            time.sleep(0.02)


def resident_kib(pid):
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))


def descriptors(pid):
    try:
        return len(os.listdir(f"/proc/{pid}/fd"))
    except OSError:
        return 0


def kib(path):
    try:
        return path.stat().st_blocks / 2
    except OSError:
        return 0


if __name__ == "__main__":
    sys.exit(main())
