"""The attitudes equal those of the Rust crate bit for bit and have the same errors on BROAD."""

import csv
import struct
from collections import defaultdict
from collections.abc import Iterable
from typing import Literal

import numpy as np
import pytest
from conftest import ROOT, SAMPLE, data
from numpy.typing import NDArray

import plumbline_ahrs
from plumbline_ahrs import Ahrs, Attitude, Recording

REFERENCES = ("arbitrary", "magnetic", "true")


def golden() -> dict[tuple[str, str], dict[int, str]]:
    """Return the digests of the Rust crate by slot and stage, and by number of samples."""
    digests: dict[tuple[str, str], dict[int, str]] = defaultdict(dict)
    with open(ROOT / "crates/ahrs/golden/broad.csv", encoding="ascii") as file:
        for row in csv.DictReader(file):
            digests[row["slot"], row["stage"]][int(row["samples"])] = row["digest"]
    return digests


def add(digest: int, attitude: Attitude) -> int:
    """Add all values of an attitude to a digest, as `crates/ahrs/tests/all/digest.rs` does."""
    numbers: Iterable[float] = (
        *attitude.angles, attitude.heading_rad, attitude.heading_sd_rad, attitude.declination_rad,
        attitude.inclination_sd_rad, attitude.innovation_rad, *attitude.quaternion, *attitude.rate_rad_s,
        *attitude.gyro_bias_rad_s, *attitude.jump,
    )
    words = (
        attitude.tick, attitude.t_ns, int(attitude.flags), REFERENCES.index(attitude.heading_reference),
        attitude.reset_counter, *struct.unpack("22Q", struct.pack("22d", *numbers)),
    )
    for word in words:
        digest = (digest ^ word) * 0x100000001B3 & 0xFFFF_FFFF_FFFF_FFFF
    return digest


def filter_with(slot: str, stage: str) -> Ahrs:
    match slot:
        case "gyro":
            return Ahrs(gyro=stage)
        case "accel":
            return Ahrs(accel=stage)
        case "fuser":
            return Ahrs(fuser=stage)
        case _:
            return Ahrs(course=stage)


@pytest.mark.parametrize(("slot", "stage"), golden())
def test_attitudes_have_the_golden_bits(sample: Recording, slot: str, stage: str) -> None:
    expected = golden()[slot, stage]
    ahrs, digest = filter_with(slot, stage), 0xCBF29CE484222325
    for i, (t_ns, gyro_rad_s, accel_m_s2, field_ut) in enumerate(sample.samples.tolist(), 1):
        digest = add(digest, ahrs.update_at(gyro_rad_s, accel_m_s2, field_ut, t_ns))
        if i in expected:
            assert f"{digest:016x}" == expected[i], f"after {i} samples"


def test_golden_covers_every_stage() -> None:
    slots: tuple[Literal["gyro", "accel", "fuser", "course"], ...] = ("gyro", "accel", "fuser", "course")
    assert list(golden()) == [(slot, stage) for slot in slots for stage in Ahrs.stages(slot)]


def rmse_deg(estimate: NDArray[np.float64], recording: Recording) -> float:
    """Return the RMSE of the total angle, degrees, as `score` does."""
    scored = recording.references["is_scored"]
    w0, x0, y0, z0 = estimate[scored].T
    w1, x1, y1, z1 = recording.references["quaternion"][scored].T
    w = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1
    x = x0 * w1 - w0 * x1 - y0 * z1 + z0 * y1
    y = y0 * w1 - w0 * y1 - z0 * x1 + x0 * z1
    z = z0 * w1 - w0 * z1 - x0 * y1 + y0 * x1
    angle_rad = 2.0 * np.arctan2(np.hypot(np.hypot(x, y), z), np.abs(w))
    return float(np.degrees(np.sqrt(np.mean(angle_rad**2))))


def test_errors_of_the_filter_equal_the_score() -> None:
    trials = data("broad/*.csv.gz") or [SAMPLE]
    scores = plumbline_ahrs.score(*trials, gnss="off")["trials"]
    for path, score in zip(trials, scores, strict=True):
        recording = plumbline_ahrs.read(path)
        samples = recording.samples
        batch = Ahrs().update_batch(
            samples["gyro_rad_s"], samples["accel_m_s2"], samples["field_ut"], t_ns=samples["t_ns"]
        )
        assert score["total"] == pytest.approx(rmse_deg(batch.quaternion, recording), rel=1e-9), path
