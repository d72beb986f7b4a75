"""Recordings in the CSV format of Plumbline as numpy arrays, and the error metrics of `plumb score`.

Input: a recording with the columns t_s, gx … az, and optionally mx … mz, qw … qz, mov.
Output: arrays with one row per sample: SI units, field in µT, sensor axes; attitude from sensor axes to east, north, up.
Failure: `RecordingError` with the file and the remedy.
"""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

METRICS = ("total", "heading", "inclination")


class RecordingError(ValueError):
    """A recording that cannot be used."""


@dataclass(frozen=True)
class Recording:
    """Samples of a recording. A missing field or reference is `nan`."""

    t_s: Array
    rate_rad_s: Array
    force_m_s2: Array
    field_ut: Array
    reference: Array
    scored: Array

    @property
    def has_field(self) -> bool:
        """`True` if any sample has a field."""
        return bool(np.isfinite(self.field_ut).all(axis=1).any())

    def new_field(self) -> Array:
        """Returns a mask of the samples with a new field. A field equal to the previous one counts as repeated."""
        is_new = np.zeros(len(self.t_s), dtype=bool)
        previous = None
        for row in np.flatnonzero(np.isfinite(self.field_ut).all(axis=1)):
            field = tuple(self.field_ut[row])
            is_new[row] = field != previous
            previous = field
        return is_new


def header(path: Path) -> list[str]:
    """Returns the column names in the first line of a CSV file, or an empty list for another file."""
    try:
        with _open(path) as file:
            return [name.strip() for name in file.readline().split(",")]
    except (OSError, UnicodeDecodeError):
        return []


def is_own_format(path: Path) -> bool:
    """Returns `True` if the file needs no import."""
    return {"t_s", "gx", "gy", "gz", "ax", "ay", "az"} <= set(header(path))


def read(path: Path) -> Recording:
    """Reads a recording that has a reference attitude."""
    names = header(path)
    if not is_own_format(path):
        raise RecordingError(f"{path}: no columns t_s, gx … az; convert it with `plumb import`")
    try:
        with _open(path) as file:
            values = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as cause:
        raise RecordingError(f"{path}: {cause}; `plumb info` describes the damage") from cause
    missing = np.full(len(values), math.nan)
    columns = lambda *wanted: np.stack([values[:, names.index(x)] if x in names else missing for x in wanted], axis=1)
    reference = columns("qw", "qx", "qy", "qz")
    is_known = np.isfinite(reference).all(axis=1)
    scored = is_known & (columns("mov")[:, 0] == 1.0) if "mov" in names else is_known
    if not scored.any():
        raise RecordingError(f"{path}: no sample with mov = 1 has a reference attitude (qw, qx, qy, qz)")
    time, rate, force = columns("t_s")[:, 0], columns("gx", "gy", "gz"), columns("ax", "ay", "az")
    return Recording(time, rate, force, columns("mx", "my", "mz"), reference, scored)


def rmse_deg(estimate: Array, recording: Recording) -> dict[str, float]:
    """Returns the RMSE over the scored samples. With e = q_est q_ref*, these are the errors of `plumb score`."""
    w0, x0, y0, z0 = estimate[recording.scored].T
    w1, x1, y1, z1 = recording.reference[recording.scored].T
    w, z = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1, z0 * w1 - w0 * z1 - x0 * y1 + y0 * x1
    x, y = x0 * w1 - w0 * x1 - y0 * z1 + z0 * y1, y0 * w1 - w0 * y1 - z0 * x1 + x0 * z1
    tilt, upright = np.hypot(x, y), np.hypot(w, z)
    errors_rad = {
        "total": 2.0 * np.arctan2(np.hypot(tilt, z), np.abs(w)),
        "heading": 2.0 * np.arctan2(np.abs(z), np.abs(w)),
        "inclination": 2.0 * np.arctan2(tilt, upright),
    }
    rmse = {name: float(np.degrees(np.sqrt(np.mean(error**2)))) for name, error in errors_rad.items()}
    if not recording.has_field:
        rmse["total"] = rmse["heading"] = math.nan
    return rmse


def _open(path: Path) -> Any:
    return gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else open(path, encoding="utf-8")
