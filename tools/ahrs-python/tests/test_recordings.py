"""Recordings in all formats, and their scores."""

import gzip
import json
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SAMPLE, data

import plumbline_ahrs
from plumbline_ahrs import Recording, Score, Segment

HEADER = "t_s,gx,gy,gz,ax,ay,az"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_arrays_hold_the_columns_of_the_file(sample: Recording) -> None:
    with gzip.open(SAMPLE, "rt", encoding="ascii") as file:
        values = np.loadtxt(file, delimiter=",", skiprows=1)
    samples, references = sample.samples, sample.references
    assert samples.shape == references.shape == (len(values),) == (len(sample),)
    assert np.array_equal(samples["t_ns"], np.round(values[:, 0] * 1e9).astype(np.int64))
    assert np.array_equal(samples["gyro_rad_s"], values[:, 1:4])
    assert np.array_equal(samples["accel_m_s2"], values[:, 4:7])
    assert np.array_equal(samples["field_ut"], values[:, 7:10], equal_nan=True)
    assert np.allclose(references["quaternion"], values[:, 10:14], atol=1e-3, equal_nan=True)
    is_known = np.isfinite(values[:, 10:14]).all(axis=1)
    assert np.array_equal(references["is_scored"], is_known & (values[:, 14] == 1.0))
    assert samples["gyro_rad_s"].dtype == np.float64
    assert len(sample.fixes) == 0
    assert (sample.notes, sample.warnings, sample.segments, sample.sensors) == ([], [], [], [])


def test_missing_values_are_nan(tmp_path: Path) -> None:
    imu = write(tmp_path / "a_imu.csv", f"{HEADER},mx,my,mz\n0,1,2,3,0,0,9.8,nan,nan,nan\n1,4,5,6,0,0,9.8,7,8,9\n")
    write(tmp_path / "a_gnss.csv", "t_s,ve,vn,vu,lat_deg\n0.25,1,2,3,nan\n0.5,4,5,6,48\n")
    recording = plumbline_ahrs.read(imu)
    assert np.isnan(recording.samples["field_ut"][0]).all()
    assert recording.samples["field_ut"][1].tolist() == [7.0, 8.0, 9.0]
    assert np.isnan(recording.references["quaternion"]).all()
    assert not recording.references["is_scored"].any()
    assert recording.fixes["t_ns"].tolist() == [250_000_000, 500_000_000]
    assert recording.fixes["velocity_m_s"].tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert np.isnan(recording.fixes["latitude_deg"][0]) and recording.fixes["latitude_deg"][1] == 48.0
    assert np.isnan(recording.fixes["altitude_m"]).all()


def test_columns_units_and_axes_are_mapped(tmp_path: Path) -> None:
    rows = "".join(f"{10 * i},0,90,0,0,0,1\n" for i in range(10))
    path = write(tmp_path / "phone.csv", f"millis,wx,wy,wz,ax,ay,az\n{rows}")
    columns = {"t": "millis", "gx": "wx", "gy": "wy", "gz": "wz", "ax": "ax", "ay": "ay", "az": "az"}
    recording = plumbline_ahrs.read(path, map=columns, units="ms,deg/s,g", frame="flu")
    assert recording.samples["t_ns"][1] == 10_000_000
    # Left is minus right.
    assert recording.samples["gyro_rad_s"][0].tolist() == pytest.approx([-np.pi / 2, 0.0, 0.0])
    assert recording.samples["accel_m_s2"][0].tolist() == pytest.approx([0.0, 0.0, 9.80665])


def test_segments_are_listed_and_chosen(tmp_path: Path) -> None:
    times = [*(10.0 + 0.1 * i for i in range(8)), *(0.1 * i for i in range(6))]
    path = write(tmp_path / "restarted.csv", HEADER + "\n" + "".join(f"{t:.1f},0,0,{t:.1f},0,0,9.8\n" for t in times))
    longest = plumbline_ahrs.read(path)
    assert longest.segments == [Segment(10_000_000_000, 10_700_000_000, 8), Segment(0, 500_000_000, 6)]
    assert longest.notes
    assert len(longest) == 8
    second = plumbline_ahrs.read(path, segment=2).samples["gyro_rad_s"][:, 2]
    assert second.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert len(plumbline_ahrs.score(path)["trials"]) == 2


def test_separate_reference_is_interpolated(tmp_path: Path) -> None:
    imu = write(tmp_path / "a.csv", f"{HEADER}\n0,0,0,0,0,0,9.8\n0.1,0,0,0,0,0,9.8\n0.9,0,0,0,0,0,9.8\n")
    reference = write(tmp_path / "b.csv", "t_s,qw,qx,qy,qz\n0,1,0,0,0\n0.2,1,0,0,0\n")
    references = plumbline_ahrs.read(imu, reference=reference).references
    assert references["quaternion"][:2].tolist() == [[1.0, 0.0, 0.0, 0.0]] * 2
    assert references["is_scored"].tolist() == [True, True, False]


def test_mcap_equals_csv(sample: Recording, plumb: str, tmp_path: Path) -> None:
    path = tmp_path / "broad.mcap"
    subprocess.run([plumb, "import", "--quiet", SAMPLE, "-o", path], check=True, stdout=subprocess.DEVNULL)
    recording = plumbline_ahrs.read(path)
    assert recording.format == "MCAP"
    assert len(recording) == len(sample)
    assert np.array_equal(recording.samples["gyro_rad_s"], sample.samples["gyro_rad_s"])


LOGS = data("logs/*.ulg") + data("reports/*.bin") + data("reports/*.mcap")


@pytest.mark.parametrize("path", [SAMPLE, *LOGS], ids=lambda path: path.name)
def test_content_equals_that_of_plumb_import(path: Path, plumb: str, tmp_path: Path) -> None:
    out = tmp_path / "out_imu.csv"
    subprocess.run([plumb, "import", "--quiet", path, "-o", out], check=True, stdout=subprocess.DEVNULL)
    read, imported = plumbline_ahrs.read(path), plumbline_ahrs.read(out)
    for name in ("samples", "references", "fixes"):
        assert getattr(read, name).tobytes() == getattr(imported, name).tobytes(), name


def without_times(score: Any) -> Any:
    """Return a score without CPU times, which differ between runs."""
    if isinstance(score, dict):
        return {key: without_times(value) for key, value in score.items() if key != "ns_per_update"}
    return [without_times(value) for value in score] if isinstance(score, list) else score


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ({}, []),
        ({"fuser": "wz", "mag": "off"}, ["--fuser", "wz", "--mag", "off"]),
        ({"parameters": {"fuser": {"time_constant_s": 3.0}}, "fuser": "wz-closed", "gnss": "off"},
         ["--fuser", "wz-closed", "--set", "fuser.time_constant_s=3", "--gnss", "off"]),
        ({"gyro_samples": "instant"}, ["--gyro-samples", "instants"]),
    ],
)
def test_score_equals_that_of_plumb(arguments: dict[str, Any], options: list[str], plumb: str) -> None:
    files = [SAMPLE, *data("logs/px4_small.ulg")]
    command = [plumb, "score", "--json", *options, *map(str, files)]
    output = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    expected = json.loads(output.splitlines()[-1])["stages"][0]
    score: Score = plumbline_ahrs.score(*files, **arguments)
    warnings = score.pop("warnings")  # type: ignore[misc]
    assert isinstance(warnings, list)
    assert without_times(score) == without_times(expected)
    assert score["trials"][0]["inclination"] is not None


def test_simulation_has_a_score() -> None:
    score = plumbline_ahrs.score("sim:s1?duration_s=8", fuser="wz")
    assert score["fuser"] == "wz"
    assert score["mean"]["inclination"] is not None
    assert score["mean"]["heading"] is None


def test_missing_file_is_not_found(tmp_path: Path) -> None:
    path = tmp_path / "missing.ulg"
    for call in (plumbline_ahrs.read, plumbline_ahrs.score):
        with pytest.raises(FileNotFoundError, match=r"opening .*missing\.ulg"):
            call(path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"units": "furlong"}, "furlong"),
        ({"frame": "sideways"}, "sideways"),
        ({"time_bits": 64}, "time_bits is 64; choose 1 to 63"),
        ({"imu": 3}, "--imu 3"),
        ({"segment": 9}, "segment"),
        ({"topics": ["/imu"]}, "topic"),
    ],
)
def test_invalid_read_arguments_are_rejected(arguments: dict[str, Any], message: str) -> None:
    for call in (plumbline_ahrs.read, plumbline_ahrs.score):
        with pytest.raises(ValueError, match=message):
            call(SAMPLE, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fuser": "vfq"}, "vfq"),
        ({"mag": "maybe"}, "unknown mag `maybe`; choose on, off or the index of a sensor"),
        ({"gnss": "on"}, "unknown gnss `on`; choose auto, off or the index of a sensor"),
        ({"parameters": {"fuser": {"x": 1.0}}}, "fuser.x"),
        ({"gyro_samples": "median"}, "unknown gyro_samples `median`; choose one of mean, instant"),
    ],
)
def test_invalid_score_arguments_are_rejected(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plumbline_ahrs.score(SAMPLE, **arguments)


def test_damaged_recording_names_line_and_user_path(tmp_path: Path) -> None:
    path = write(tmp_path / "damaged.csv", HEADER + "\n")
    with pytest.raises(ValueError, match=r"damaged\.csv"):
        plumbline_ahrs.read(path)
    with pytest.raises(ValueError, match="name at least one"):
        plumbline_ahrs.read()


def turns_during_a_read() -> int:
    """Return how often this thread ran while another one read a recording."""
    worker = threading.Thread(target=plumbline_ahrs.read, args=(SAMPLE,))
    worker.start()
    turns = 0
    while worker.is_alive():
        turns += 1
        time.sleep(0.0001)
    return turns


def test_other_threads_run_while_a_recording_is_read() -> None:
    # With the GIL, this thread runs only before and after the native call. On a busy machine, one
    # attempt may not suffice.
    assert any(turns_during_a_read() > 5 for _ in range(200))
