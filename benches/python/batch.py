"""Compares the time of `update_batch` with that of the batch of the package vqf.

    python3 benches/python/batch.py [RECORDING] [--rounds 9]

Input: a recording with the columns t_s, gx … az, mx … mz; without one, the sample recording.
Output: elapsed time and CPU time of all threads per sample, ns, and their ratios to vqf. Medians
over interleaved rounds.
Failure: ends with the message of numpy if the recording is damaged.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from plumbline_ahrs import Ahrs
from vqf import VQF

SAMPLE = Path(__file__).resolve().parents[2] / "samples/broad.csv.gz"


def main() -> None:
    """Measures every filter in every round."""
    parser = argparse.ArgumentParser(description="Compare the time of update_batch with that of vqf")
    parser.add_argument("recording", nargs="?", default=SAMPLE)
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    table = np.loadtxt(arguments.recording, delimiter=",", skiprows=1, usecols=range(10))
    gyro, accel, field = (np.ascontiguousarray(table[:, first : first + 3]) for first in (1, 4, 7))
    dt_s = float(np.median(np.diff(table[:, 0])))
    filters: dict[str, Callable[[], object]] = {"vqf, 9 axes": lambda: VQF(dt_s).updateBatch(gyro, accel, field)}
    for stage in Ahrs.stages("fuser"):
        filters[stage] = lambda stage=stage: Ahrs(fuser=stage).update_batch(gyro, accel, field, dt_s)
    times_ns: dict[str, list[tuple[float, float]]] = {name: [] for name in filters}
    for _ in range(arguments.rounds):
        for name, run in filters.items():
            started_ns = (time.perf_counter_ns(), time.process_time_ns())
            run()
            ended_ns = (time.perf_counter_ns(), time.process_time_ns())
            elapsed, cpu = ((end - start) / len(table) for start, end in zip(started_ns, ended_ns))
            times_ns[name].append((elapsed, cpu))
    peer = times_ns[next(iter(filters))]
    print("| filter | elapsed, ns | ratio to vqf | CPU, ns | ratio to vqf |\n| --- | --- | --- | --- | --- |")
    for name, times in times_ns.items():
        cells = [name]
        for clock in range(2):
            cells.append(f"{statistics.median(own[clock] for own in times):.0f}")
            cells.append(f"{statistics.median(own[clock] / other[clock] for own, other in zip(times, peer)):.2f}")
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
