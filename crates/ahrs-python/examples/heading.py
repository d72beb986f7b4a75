"""Prints the heading over a recording, and the computing time per sample.

    python3 examples/heading.py samples/broad.csv.gz
"""

import gzip
import sys
import time

import numpy as np

from plumbline_ahrs import Ahrs, Flags

# Columns: time, s; rate, rad/s; specific force, m/s²; field, µT.
with gzip.open(sys.argv[1], "rt") as file:
    table = np.loadtxt(file, delimiter=",", skiprows=1, usecols=range(10))

ahrs = Ahrs()
start_s = time.perf_counter()
batch = ahrs.update_batch(
    table[:, 1:4], table[:, 4:7], table[:, 7:10], t_ns=np.round(table[:, 0] * 1e9).astype(np.int64)
)
cost_us = (time.perf_counter() - start_s) / len(batch) * 1e6

for row in range(0, len(batch), len(batch) // 10):
    heading_deg, sd_deg = np.degrees([batch.heading_rad[row], batch.heading_sd_rad[row]])
    flags = Flags(int(batch.flags[row]))
    print(f"{table[row, 0]:6.2f} s  {heading_deg:6.1f}° ± {sd_deg:5.1f}°  {flags!r}")
print(f"{len(batch)} samples, {cost_us:.2f} µs per sample")
