"""Recordings of the tests."""

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Recording:
    """Samples of a recording: SI units, field in µT; reference attitude, NaN if unknown."""

    t_ns: NDArray[np.int64]
    gyro_rad_s: NDArray[np.float64]
    accel_m_s2: NDArray[np.float64]
    field_ut: NDArray[np.float64]
    reference: NDArray[np.float64]
    scored: NDArray[np.bool_]


def read(path: Path) -> Recording:
    """Read a recording of BROAD in the format of Plumbline."""
    with gzip.open(path, "rt", encoding="ascii") as file:
        values = np.loadtxt(file, delimiter=",", skiprows=1)
    t_ns = np.round(values[:, 0] * 1e9).astype(np.int64)
    reference = values[:, 10:14]
    scored = np.isfinite(reference).all(axis=1) & (values[:, 14] == 1.0)
    return Recording(t_ns, values[:, 1:4], values[:, 4:7], values[:, 7:10], reference, scored)


@pytest.fixture(scope="session")
def sample() -> Recording:
    """Return the sample recording of the tree."""
    return read(ROOT / "samples/broad.csv.gz")
