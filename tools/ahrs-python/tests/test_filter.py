"""The filter: arguments, single updates, attitudes and snapshots."""

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

import plumbline_ahrs
from plumbline_ahrs import Ahrs, Flags, Parameter

RATE, UP, FIELD = (0.0, 0.0, 0.1), (0.0, 0.0, 9.81), (0.0, 20.0, -40.0)


def test_first_example() -> None:
    ahrs = Ahrs()
    for i in range(200):
        # A real field is never repeated.
        attitude = ahrs.update((0.0, 0.0, 0.0), UP, (0.0, 20.0 + 1e-6 * i, -40.0), 0.01)
    assert attitude.is_aligned
    assert attitude == ahrs.attitude
    assert math.hypot(*attitude.quaternion) == pytest.approx(1.0)
    assert attitude.heading_reference == "magnetic"
    assert math.cos(attitude.heading_rad) == pytest.approx(1.0, abs=1e-3)
    assert attitude.heading_sd_rad < 1.0
    assert attitude.angles.pitch_rad == pytest.approx(0.0, abs=1e-6)
    # North is ahead: yaw is 90° in ROS and 0 in PX4.
    assert attitude.angles_in("enu-flu").yaw_rad == pytest.approx(math.pi / 2, abs=0.01)
    assert attitude.angles_in("ned-frd").yaw_rad == pytest.approx(0.0, abs=0.01)
    assert "is_aligned=True" in repr(attitude)


def test_sequences_and_arrays_are_equivalent() -> None:
    attitudes = [
        Ahrs().update(RATE, UP, FIELD, 0.01),
        Ahrs().update(list(RATE), list(UP), list(FIELD), 0.01),
        Ahrs().update(np.array(RATE), np.array(UP), np.array(FIELD), 0.01),
    ]
    assert attitudes[0] == attitudes[1] == attitudes[2]


def test_separate_sensors_equal_one_call() -> None:
    together, separate = Ahrs(), Ahrs()
    for i in range(10):
        together.update(RATE, UP, FIELD, 0.01)
        separate.update_mag(FIELD)
        separate.update(RATE, UP, None, 0.01)
    assert together.attitude == separate.attitude
    stamped = Ahrs()
    for i in range(10):
        stamped.update_mag(FIELD)
        stamped.update_at(RATE, UP, None, (i + 1) * 10_000_000)
    assert stamped.attitude == together.attitude


def test_velocity_of_a_receiver_is_used() -> None:
    ahrs = Ahrs()
    ahrs.update_gnss((1.0, 2.0, 0.0), velocity_sd_m_s=0.1, age_s=0.05, latitude_rad=0.8)
    assert ahrs.update(RATE, UP, None, 0.01).flags & Flags.FIX
    assert not ahrs.update(RATE, UP, None, 0.01).flags & Flags.FIX


def test_faults_are_flagged() -> None:
    attitude = Ahrs().update((math.nan, 0.0, 0.0), UP, None, 0.01)
    assert Flags.RATE_INVALID in attitude.flags
    ahrs = Ahrs()
    ahrs.update(RATE, UP, None, 0.01)
    ahrs.update(RATE, UP, None, 0.0)
    assert ahrs.rejected == 1


def test_snapshot_continues_with_the_same_bits() -> None:
    ahrs = Ahrs(fuser="wz")
    for _ in range(20):
        ahrs.update(RATE, UP, FIELD, 0.01)
    restored = Ahrs(fuser="wz")
    restored.restore(ahrs.snapshot())
    independent = ahrs.copy()
    assert ahrs.update(RATE, UP, None, 0.01) == restored.update(RATE, UP, None, 0.01)
    assert independent.attitude != ahrs.attitude
    seeded = Ahrs()
    seeded.seed_sensor_errors(ahrs)
    assert not seeded.attitude.is_aligned


@pytest.mark.parametrize(
    ("snapshot", "message"),
    [
        (b"", "not a snapshot"),
        (Ahrs(fuser="vqf").snapshot(), "other stages"),
        (Ahrs().snapshot()[:-8], "damaged"),
    ],
)
def test_invalid_snapshot_changes_nothing(snapshot: bytes, message: str) -> None:
    ahrs = Ahrs()
    ahrs.update(RATE, UP, None, 0.01)
    before = ahrs.attitude
    with pytest.raises(ValueError, match=message):
        ahrs.restore(snapshot)
    assert ahrs.attitude == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fuser": "vfq"}, "slot fuser has no stage `vfq`; choose one of multiple-model,"),
        ({"gyro": "x"}, "slot gyro has no stage `x`"),
        ({"gyro_range_deg_s": 0.0}, "rate_max_deg_s"),
        ({"accel_range_g": math.nan}, "force_max_g"),
        ({"mag_range_ut": 0.0}, "field_max_ut"),
        ({"gap_s": 100.0}, "gap_s"),
        ({"frozen_after_s": -1.0}, "stuck_s"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz"),
        ({"declination_deg": 181.0}, "declination_deg"),
        ({"gyro_samples": "median"}, "unknown gyro_samples `median`; choose one of mean, instant"),
        ({"mounting": "sideways"}, "expected x-DIRECTION-y-DIRECTION"),
        ({"mounting": np.zeros((3, 3))}, "rotation"),
        ({"calibration": {"baro": (np.eye(3), (0, 0, 0))}}, "unknown sensor `baro`"),
        ({"calibration": {"mag": (np.full((3, 3), math.nan), (0, 0, 0))}}, "finite"),
        ({"parameters": {"wing": {}}}, "unknown slot `wing`; choose one of gyro, accel, fuser, course"),
        ({"parameters": {"fuser": {"x": 1.0}}}, "fuser `x`"),
    ],
)
def test_invalid_arguments_are_rejected(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Ahrs(**arguments)


def test_arguments_are_applied() -> None:
    tilted = Ahrs(mounting="frd").update((0.0, 0.0, 0.0), (0.0, 0.0, -9.81), None, 0.01)
    assert tilted.angles.roll_rad == pytest.approx(0.0, abs=1e-9)
    matrix = Ahrs(mounting=[[0, 1, 0], [1, 0, 0], [0, 0, -1]]).update(RATE, (0, 0, -9.81), None, 0.01)
    assert matrix == Ahrs(mounting="frd").update(RATE, (0, 0, -9.81), None, 0.01)
    clipped = Ahrs(gyro_range_deg_s=5.0).update(RATE, UP, None, 0.01)
    assert clipped.flags & Flags.RATE_CLIPPED
    calibrated = Ahrs(calibration={"gyro": (np.eye(3), RATE)}).update(RATE, UP, None, 0.01)
    assert calibrated.rate_rad_s == (0.0, 0.0, 0.0)
    name, value = Ahrs.parameters("course")[0].name, Ahrs.parameters("course")[0].min
    assert Ahrs(parameters={"course": {name: value}}).fuser == "multiple-model"
    true = Ahrs(declination_deg=4.5)
    for _ in range(200):
        true.update((0.0, 0.0, 0.0), UP, FIELD, 0.01)
    assert true.attitude.declination_rad == pytest.approx(math.radians(4.5))


def test_parameters_describe_the_stages() -> None:
    for slot in ("gyro", "accel", "fuser", "course"):
        for stage in Ahrs.stages(slot):
            for parameter in Ahrs.parameters(slot, stage):
                assert isinstance(parameter, Parameter)
                assert parameter.min <= parameter.default <= parameter.max
                assert parameter.description
    assert any(parameter.unit for parameter in Ahrs.parameters("fuser", "wz"))


def test_wrong_vector_is_rejected() -> None:
    with pytest.raises(ValueError, match="length 3"):
        Ahrs().update((0.0, 0.0), UP, None, 0.01)
    with pytest.raises(TypeError):
        Ahrs().update("abc", UP, None, 0.01)  # type: ignore[arg-type]


def test_flags_are_those_of_the_c_header() -> None:
    header = (ROOT / "crates/ahrs-c/src/flags.rs").read_text(encoding="utf-8")
    lines = [line for line in header.splitlines() if line.startswith("pub const PLUMBLINE_FLAG_")]
    expected = [f"pub const PLUMBLINE_FLAG_{f.name}: u64 = 1 << {f.value.bit_length() - 1};" for f in Flags]
    assert lines == expected


def test_stage_sdk_is_that_of_the_tree() -> None:
    from plumbline_ahrs import stage_sdk

    folder = ROOT / "crates/sdk/python/plumbline"
    installed = next(iter(stage_sdk.__path__))
    for path in folder.glob("*.py"):
        with open(f"{installed}/{path.name}", "rb") as file:
            assert file.read() == path.read_bytes()
    assert stage_sdk.Stage.__doc__


def test_public_names_have_docstrings() -> None:
    for name in plumbline_ahrs.__all__:
        cls = getattr(plumbline_ahrs, name)
        assert cls.__doc__, name
        if cls.__module__ == "plumbline_ahrs":
            for member in vars(cls):
                assert member.startswith("_") or vars(cls)[member].__doc__, f"{name}.{member}"


def test_import_does_not_load_numpy() -> None:
    code = "import sys, plumbline_ahrs; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

