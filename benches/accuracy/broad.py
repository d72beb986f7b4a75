"""Converts trials of the data set BROAD to recordings of Plumbline.

    python3 benches/accuracy/broad.py broad/data_hdf5/*.hdf5 --out recordings

Input: HDF5 files of https://github.com/dlaidig/broad: data sets imu_gyr (rad/s), imu_acc (m/s²), imu_mag (µT), opt_quat (sensor to
east, north, up; `nan` while the cameras lost the markers) and movement; attribute sampling_rate (Hz).
Output: one .csv.gz per trial with the columns t_s, gx … gz, ax … az, mx … mz, qw … qz, mov.
Failure: exits with 2 and the reason. A file that exists is not replaced.
"""

from __future__ import annotations

import argparse
import gzip
import sys
from pathlib import Path

import h5py
import numpy as np

# Data set, columns and decimals. The rounding errors are below the quantisation of the sensor.
COLUMNS = (
    ("imu_gyr", ("gx", "gy", "gz"), 5),
    ("imu_acc", ("ax", "ay", "az"), 4),
    ("imu_mag", ("mx", "my", "mz"), 2),
    ("opt_quat", ("qw", "qx", "qy", "qz"), 6),
    ("movement", ("mov",), 0),
)


class TrialError(ValueError):
    """A file that is not a trial of BROAD, or an output that cannot be written."""


def trial_lines(path: Path) -> list[str]:
    """Returns the lines of the recording, the first of which is the header."""
    try:
        with h5py.File(path, "r") as file:
            rate_hz = float(file.attrs["sampling_rate"])
            values = [np.asarray(file[name], dtype=float).reshape(len(file[name]), -1) for name, _, _ in COLUMNS]
    except (OSError, KeyError) as cause:
        raise TrialError(f"{path}: {cause}; expected an HDF5 file of BROAD, from its folder data_hdf5") from cause
    rows = len(values[0])
    for (name, columns, _), found in zip(COLUMNS, values):
        if found.shape != (rows, len(columns)):
            raise TrialError(f"{path}: {name} has the shape {found.shape}, expected {(rows, len(columns))}")
    if not rate_hz > 0.0:
        raise TrialError(f"{path}: sampling_rate is {rate_hz} Hz, expected a positive number")
    decimals = [decimals for _, columns, decimals in COLUMNS for _ in columns]
    header = ",".join(["t_s", *(name for _, columns, _ in COLUMNS for name in columns)])
    table = np.concatenate(values, axis=1)
    return [header, *(f"{row / rate_hz:.6f}," + ",".join(f"{x:.{n}f}" for x, n in zip(table[row], decimals)) for row in range(rows))]


def convert(path: Path, folder: Path) -> Path:
    """Converts a trial and returns the path of the recording."""
    out = folder / f"{path.stem}.csv.gz"
    text = "\n".join(trial_lines(path)) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # No time of the conversion in the file, so that equal trials give equal bytes.
        with open(out, "xb") as file, gzip.GzipFile(filename="", fileobj=file, mode="wb", mtime=0) as packed:
            packed.write(text.encode())
    except OSError as cause:
        raise TrialError(f"{out}: {cause}; delete it, or set another folder with --out") from cause
    return out


def main() -> int:
    """Converts the trials that the command line names."""
    parser = argparse.ArgumentParser(description="Convert trials of BROAD to recordings of Plumbline")
    parser.add_argument("trials", nargs="+", type=Path, help="HDF5 files of the folder data_hdf5")
    parser.add_argument("--out", type=Path, default=Path(), help="folder for the recordings [default: current]")
    arguments = parser.parse_args()
    try:
        for path in arguments.trials:
            print(convert(path, arguments.out))
    except TrialError as cause:
        print(f"broad.py: {cause}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
