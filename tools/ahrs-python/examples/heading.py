"""Prints the heading over a recording, and the computing time per sample.

    python3 examples/heading.py samples/broad.csv.gz
"""

import sys
import time

import numpy as np

import plumbline_ahrs
from plumbline_ahrs import Ahrs, Flags

samples = plumbline_ahrs.read(sys.argv[1]).samples

start_s = time.perf_counter()
batch = Ahrs().update_batch(
    samples["gyro_rad_s"], samples["accel_m_s2"], samples["field_ut"], t_ns=samples["t_ns"]
)
cost_us = (time.perf_counter() - start_s) / len(batch) * 1e6

for row in range(0, len(batch), len(batch) // 10):
    heading_deg, sd_deg = np.degrees([batch.heading_rad[row], batch.heading_sd_rad[row]])
    flags = Flags(int(batch.flags[row]))
    print(f"{samples['t_ns'][row] * 1e-9:6.2f} s  {heading_deg:6.1f}° ± {sd_deg:5.1f}°  {flags!r}")
print(f"{len(batch)} samples, {cost_us:.2f} µs per sample")
