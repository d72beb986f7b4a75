"""Many samples in one call."""

import struct
import threading
import time
from typing import Any

import numpy as np
import pytest

import plumbline_ahrs
from conftest import data
from plumbline_ahrs import Ahrs, Batch, Flags, Recording

N = 400
SHORT = 700
"""Samples of a batch that is processed by one thread."""
COLUMNS = (
    "quaternion", "angles_rad", "heading_rad", "heading_sd_rad", "inclination_sd_rad", "rate_rad_s",
    "gyro_bias_rad_s", "flags", "tick", "reset_counter",
)


def batch_of(sample: Recording, **arguments: Any) -> Batch:
    return Ahrs().update_batch(
        sample.samples["gyro_rad_s"][:N], sample.samples["accel_m_s2"][:N], sample.samples["field_ut"][:N], t_ns=sample.samples["t_ns"][:N], **arguments
    )


def test_rows_equal_single_updates(sample: Recording) -> None:
    ahrs, batch = Ahrs(), batch_of(sample, frame="ned-frd")
    assert len(batch) == N
    for i in range(N):
        attitude = ahrs.update_at(
            sample.samples["gyro_rad_s"][i], sample.samples["accel_m_s2"][i], sample.samples["field_ut"][i], int(sample.samples["t_ns"][i])
        )
        assert tuple(batch.quaternion[i]) == attitude.quaternion_in("ned-frd")
        assert tuple(batch.angles_rad[i]) == attitude.angles_in("ned-frd")
        assert tuple(batch.rate_rad_s[i]) == attitude.rate_rad_s_in("ned-frd")
        assert tuple(batch.gyro_bias_rad_s[i]) == attitude.gyro_bias_rad_s_in("ned-frd")
        assert batch.heading_rad[i] == attitude.heading_rad
        assert batch.heading_sd_rad[i] == attitude.heading_sd_rad
        assert batch.inclination_sd_rad[i] == attitude.inclination_sd_rad
        assert batch.flags[i] == attitude.flags
        assert batch.tick[i] == attitude.tick
        assert batch.reset_counter[i] == attitude.reset_counter


def test_interval_and_intervals_are_equivalent(sample: Recording) -> None:
    rows = sample.samples["gyro_rad_s"][:N], sample.samples["accel_m_s2"][:N], sample.samples["field_ut"][:N]
    scalar, array = (Ahrs().update_batch(*rows, dt_s) for dt_s in (0.007, np.full(N, 0.007)))
    assert np.array_equal(scalar.quaternion, array.quaternion)
    ahrs = Ahrs()
    for row in zip(*rows):
        ahrs.update(*row, 0.007)
    assert tuple(scalar.quaternion[-1]) == ahrs.attitude.quaternion


def test_strides_and_types_do_not_matter(sample: Recording) -> None:
    table = np.column_stack([sample.samples["gyro_rad_s"], sample.samples["accel_m_s2"], sample.samples["field_ut"]])[:N]
    expected = batch_of(sample).quaternion
    for rows in (table, np.asfortranarray(table), np.repeat(table, 2, axis=0)[::2]):
        batch = Ahrs().update_batch(rows[:, 0:3], rows[:, 3:6], rows[:, 6:9], t_ns=sample.samples["t_ns"][:N])
        assert np.array_equal(batch.quaternion, expected)
    lists = table[:, 0:3].tolist(), table[:, 3:6].tolist(), table[:, 6:9].tolist()
    assert np.array_equal(Ahrs().update_batch(*lists, t_ns=sample.samples["t_ns"][:N]).quaternion, expected)


def test_row_of_nan_is_no_field(sample: Recording) -> None:
    field = sample.samples["field_ut"][:N].copy()
    field[::2] = np.nan
    rows = sample.samples["gyro_rad_s"][:N], sample.samples["accel_m_s2"][:N]
    batch, ahrs = Ahrs().update_batch(*rows, field, 0.007), Ahrs()
    for i in range(N):
        ahrs.update(rows[0][i], rows[1][i], field[i] if i % 2 else None, 0.007)
    assert tuple(batch.quaternion[-1]) == ahrs.attitude.quaternion


def test_batch_continues_the_filter(sample: Recording) -> None:
    rows = sample.samples["gyro_rad_s"][:N], sample.samples["accel_m_s2"][:N], sample.samples["field_ut"][:N]
    ahrs, half = Ahrs(), N // 2
    gyro, accel, field = rows
    ahrs.update_batch(gyro[:half], accel[:half], field[:half], 0.007)
    second = ahrs.update_batch(gyro[half:], accel[half:], field[half:], 0.007)
    whole = Ahrs().update_batch(*rows, 0.007)
    assert np.array_equal(second.quaternion, whole.quaternion[half:])


def columns(batches: list[Batch]) -> dict[str, bytes]:
    """Return the bits of each column of successive batches."""
    return {name: np.concatenate([getattr(batch, name) for batch in batches]).tobytes() for name in COLUMNS}


def assert_threads_change_nothing(samples: Any, snapshot: bytes | None = None, **arguments: Any) -> Batch:
    """Compare a long batch with short ones, which use one thread. Return the long batch."""
    results = []
    for step in (len(samples), SHORT):
        ahrs = Ahrs(**arguments)
        if snapshot is not None:
            ahrs.restore(snapshot)
        batches = [
            ahrs.update_batch(rows["gyro_rad_s"], rows["accel_m_s2"], rows["field_ut"], t_ns=rows["t_ns"])
            for rows in (samples[start : start + step] for start in range(0, len(samples), step))
        ]
        results.append((batches, ahrs))
    (long, first), (short, second) = results
    assert columns(long) == columns(short)
    assert first.snapshot() == second.snapshot()
    assert first.attitude == second.attitude
    assert first.rejected == second.rejected
    return long[0]


def with_faults(samples: Any) -> Any:
    """Return the samples with gaps, repeated samples, missing values and a disturbed magnetometer."""
    samples, n = samples.copy(), len(samples)
    for start, gap_ns in ((n // 9, 150_000_000), (n // 3, 900_000_000), (n // 2, 3_000_000_000)):
        samples["t_ns"][start:] += gap_ns
    samples[n // 8 : n // 8 + 40] = samples[n // 8]
    samples["gyro_rad_s"][n // 5 : n // 5 + 90] = np.nan
    samples["accel_m_s2"][n // 4 : n // 4 + 30] = np.nan
    samples["field_ut"][2 * n // 3 : 3 * n // 4] += 40.0
    # During an outage of the gyro, the body is turned unobserved.
    samples["gyro_rad_s"][4 * n // 5 : 4 * n // 5 + 90] = np.nan
    for name in ("gyro_rad_s", "accel_m_s2", "field_ut"):
        samples[name][4 * n // 5 + 50 :] = samples[name][4 * n // 5 + 50 :][:, [1, 2, 0]]
    return samples


def test_threads_change_nothing_on_recordings(sample: Recording) -> None:
    recordings = [sample] + [plumbline_ahrs.read(path) for path in data("broad/*.csv.gz") + data("flights/*imu.csv.gz")]
    for recording in recordings:
        samples = recording.samples[:40_000]
        assert_threads_change_nothing(samples)
        batch = assert_threads_change_nothing(with_faults(samples), declination_deg=3.0)
        assert batch.reset_counter[-1] > batch.reset_counter[len(samples) // 2]


@pytest.mark.parametrize("arguments", [{"course": "track"}, {"fuser": "wz"}, {"fuser": "vqf"}, {"gyro": "mobius-coning"}])
def test_threads_change_nothing_with_any_stage(sample: Recording, arguments: dict[str, Any]) -> None:
    assert_threads_change_nothing(with_faults(sample.samples), **arguments)


def test_threads_change_nothing_at_low_rate(sample: Recording) -> None:
    """At less than 5 Hz, the attitude decides at each sample whether the level is aligned."""
    samples = np.tile(sample.samples[::40], 20)
    samples["t_ns"] = np.arange(len(samples)) * 280_000_000
    batch = assert_threads_change_nothing(samples)
    assert batch.reset_counter[-1] > 10


def damaged(snapshot: bytes, word: int) -> bytes:
    """Return a snapshot with a huge number and the checksum of the new bytes."""
    words = bytearray(snapshot)
    struct.pack_into("<d", words, 8 * word, 1e300)
    checksum = 0xCBF29CE484222325
    for byte in words[32:]:
        checksum = (checksum ^ byte) * 0x100000001B3 & (1 << 64) - 1
    struct.pack_into("<Q", words, 24, checksum)
    return bytes(words)


def test_threads_change_nothing_when_the_fuser_is_reset(sample: Recording) -> None:
    ahrs = Ahrs()
    rows = sample.samples[:1000]
    ahrs.update_batch(rows["gyro_rad_s"], rows["accel_m_s2"], rows["field_ut"], t_ns=rows["t_ns"])
    reset = np.uint64(Flags.RESET | Flags.ALIGNED)
    resets: set[int] = set()
    for word in range(4, len(ahrs.snapshot()) // 8):
        snapshot = damaged(ahrs.snapshot(), word)
        try:
            Ahrs().restore(snapshot)
        except ValueError:
            continue
        batch = assert_threads_change_nothing(sample.samples[1000:5000], snapshot)
        resets.update(np.flatnonzero(batch.flags & reset == reset))
        if len(resets) > 2:
            break
    assert max(resets) > 0


def test_angles_are_computed_once(sample: Recording) -> None:
    batch = batch_of(sample)
    assert batch.heading_rad is batch.heading_rad
    assert batch.angles_rad is batch.angles_rad


def test_empty_batch_has_no_rows() -> None:
    batch = Ahrs().update_batch(np.empty((0, 3)), np.empty((0, 3)), None, 0.01)
    assert len(batch) == 0
    assert batch.quaternion.shape == (0, 4)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"gyro_rad_s": np.zeros(3)}, ValueError, r"gyro_rad_s has the shape \(3,\), expected \(n, 3\)"),
        ({"accel_m_s2": np.zeros((4, 3))}, ValueError, r"accel_m_s2 has the shape \(4, 3\), expected \(5, 3\)"),
        ({"field_ut": np.zeros((5, 2))}, ValueError, r"field_ut has the shape \(5, 2\), expected \(5, 3\)"),
        ({"dt_s": np.zeros(4)}, ValueError, r"dt_s has the shape \(4,\), expected \(\), or \(5,\)"),
        ({"dt_s": None, "t_ns": np.zeros(4, dtype=np.int64)}, ValueError, r"t_ns has the shape \(4,\)"),
        ({"dt_s": None, "t_ns": np.zeros(5)}, TypeError, "int64"),
        ({"dt_s": None}, TypeError, "pass dt_s or t_ns"),
        ({"t_ns": np.zeros(5, dtype=np.int64)}, TypeError, "dt_s and t_ns exclude each other"),
        ({"frame": "ned"}, ValueError, "unknown frame `ned`; choose one of enu-rfu, enu-flu, nwu-flu, ned-frd"),
    ],
)
def test_invalid_arguments_change_nothing(
    arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    valid = {"gyro_rad_s": np.zeros((5, 3)), "accel_m_s2": np.ones((5, 3)), "dt_s": 0.01}
    ahrs = Ahrs()
    with pytest.raises(error, match=message):
        ahrs.update_batch(**{**valid, **arguments})
    assert ahrs.attitude == Ahrs().attitude


def test_other_threads_run_during_a_batch() -> None:
    rows, ahrs = np.ones((200_000, 3)), Ahrs()
    worker = threading.Thread(target=ahrs.update_batch, args=(rows, rows, None, 0.01))
    with_gil = threading.Event()
    worker.start()
    # A call fails with RuntimeError only if this thread runs while the batch uses the filter.
    while worker.is_alive() and not with_gil.is_set():
        try:
            _ = ahrs.rejected
        except RuntimeError:
            with_gil.set()
        time.sleep(0)
    worker.join()
    assert with_gil.is_set()
