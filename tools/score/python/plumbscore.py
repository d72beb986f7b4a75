"""Results of `plumb score` as numpy arrays: per-tick tables (`--csv DIR`) and scores (`--json`). Requires only numpy; `to_pandas` requires pandas.

Input: a table, the standard output of `plumb score`, or recordings and simulations to score.
Output: arrays with one element per tick in the units of their names; errors in degrees; unknown values are `nan`.
Time: that of the samples, s.
Failure: `ScoreError` with the file, the line and the remedy.
"""

from __future__ import annotations

import json
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import pandas

Array = NDArray[Any]

TEXT_COLUMNS = ("chart", "course_reference", "heading_reference", "gyro_chart", "accel_chart", "true_chart")
ATTITUDE = ("qw", "qx", "qy", "qz", "chart", "u", "v", "z_rad", "yaw_rad", "pitch_rad", "roll_rad", "course_rad")
BIAS = ("bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s")
SENSORS = ("gyro_chart", "gyro_u", "gyro_v", "gyro_z_rad", "accel_chart", "accel_u", "accel_v")
COLUMNS = ("t_s", *ATTITUDE, "course_reference", *BIAS, "inclination_sd_rad", "course_sd_rad")
COLUMNS += ("heading_reference", "heading_sd_rad", *SENSORS, *("true_" + name for name in ATTITUDE + BIAS), "scored")
# Largest pitch for which roll, yaw and course are defined.
MAX_PITCH_RAD = math.radians(89.0)


class ScoreError(ValueError):
    """Input that `plumb score` did not write, or a run that failed."""


def _pandas() -> ModuleType:
    try:
        import pandas
    except ImportError as cause:
        raise ScoreError(f"no DataFrame without pandas: {cause}; install it with `pip install pandas`") from cause
    return pandas


def wrapped_deg(angle_rad: ArrayLike) -> Array:
    """Converts angles to degrees in (-180, 180]."""
    angle_deg = np.degrees(angle_rad)
    return angle_deg - 360.0 * np.ceil((angle_deg - 180.0) / 360.0)


def rms(values: Array, mask: Array) -> float:
    """Returns the root mean square of the finite values in `mask`; `nan` if there are none."""
    finite = values[mask & np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan


@dataclass(frozen=True)
class Table:
    """Estimates of a chain of stages and the reference at each tick. `table["roll_rad"]` is a column."""

    columns: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        if name not in self.columns:
            raise ScoreError(f"no column {name}; available: {', '.join(self.columns)}")
        return self.columns[name]

    def to_pandas(self) -> pandas.DataFrame:
        """Returns the columns as a DataFrame with one row per tick, indexed by `t_s`."""
        return _pandas().DataFrame(self.columns).set_index("t_s")

    @property
    def scored(self) -> Array:
        """Mask of the scored ticks."""
        return self["scored"] == 1.0

    def quaternion(self, prefix: str = "") -> Array:
        """Returns w, x, y, z, body to earth, one row per tick; `true_` selects the reference."""
        return np.stack([self[f"{prefix}q{axis}"] for axis in "wxyz"], axis=1)

    def bias_rad_s(self, prefix: str = "") -> Array:
        """Returns the gyro bias in body axes, one row per tick; `true_` selects the true bias."""
        return np.stack([self[f"{prefix}bias_{axis}_rad_s"] for axis in "xyz"], axis=1)

    def w(self, prefix: str = "") -> Array:
        """Returns the up vector as the point u + jv of the upright chart; `gyro_`, `accel_` and `true_` select other sources."""
        w = self[f"{prefix}u"] + 1j * self[f"{prefix}v"]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self[f"{prefix}chart"] == "inverted", 1.0 / w, w)

    def errors_deg(self) -> dict[str, Array]:
        """Returns estimate minus reference, wrapped. Total, inclination and bias (°/s) are magnitudes; `heading` is the rotation about the vertical.

        With an arbitrary heading, `yaw`, `heading` and `total` drift. With an arbitrary course reference, `course` is `nan`.
        """
        w0, x0, y0, z0 = self.quaternion().T
        w1, x1, y1, z1 = self.quaternion("true_").T
        # e = q_est q_ref*, in earth axes.
        w, z = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1, z0 * w1 - w0 * z1 - x0 * y1 + y0 * x1
        x, y = x0 * w1 - w0 * x1 - y0 * z1 + z0 * y1, y0 * w1 - w0 * y1 - z0 * x1 + x0 * z1
        tilt, upright = np.hypot(x, y), np.hypot(w, z)
        errors = {
            "total": np.degrees(2.0 * np.arctan2(np.hypot(tilt, z), np.abs(w))),
            "heading": wrapped_deg(2.0 * np.arctan2(z, w)),
            "inclination": np.degrees(2.0 * np.arctan2(tilt, upright)),
        }
        steep = np.maximum(np.abs(self["pitch_rad"]), np.abs(self["true_pitch_rad"])) > MAX_PITCH_RAD
        for name in ("roll", "pitch", "yaw", "course"):
            undefined = steep | (self["course_reference"] == "arbitrary") if name == "course" else steep
            errors[name] = np.where(undefined, np.nan, wrapped_deg(self[f"{name}_rad"] - self[f"true_{name}_rad"]))
        errors["gyro_bias_deg_s"] = np.degrees(np.linalg.norm(self.bias_rad_s() - self.bias_rad_s("true_"), axis=1))
        return errors

    def rms(self) -> dict[str, float]:
        """Returns the RMS of each error over the scored ticks; `nan` for total, heading and yaw if the heading is arbitrary at the end."""
        known = self["heading_reference"] != "arbitrary"
        undefined = ("total", "heading", "yaw") if not known[self.scored][-1:].all() else ()
        masks = {"yaw": self.scored & known}
        errors = {name: rms(error, masks.get(name, self.scored)) for name, error in self.errors_deg().items()}
        return {name: math.nan if name in undefined else error for name, error in errors.items()}

    def normalised(self) -> dict[str, Array]:
        """Returns the errors divided by their reported standard deviations; `nan` for an arbitrary heading.

        Ideally, 68 % of the inclination ratios are below 1.51, and 68 % of the heading and course ratios are below 1.
        """
        errors = self.errors_deg()
        errors["heading"] = np.where(self["heading_reference"] == "arbitrary", np.nan, errors["heading"])
        with np.errstate(divide="ignore", invalid="ignore"):
            return {name: errors[name] / np.degrees(self[f"{name}_sd_rad"]) for name in ("inclination", "heading", "course")}


def read_table(path: str | Path) -> Table:
    """Reads a table that `plumb score --csv DIR` wrote."""
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise ScoreError(f"{path}: {cause}; expected a file written by `plumb score --csv DIR`") from cause
    head = lines[0].split(",") if lines else []
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise ScoreError(f"{path}:1: no column {', '.join(missing)}; write the table again with this version of plumb")
    rows = [line.split(",") for line in lines[1:]]
    for number, row in enumerate(rows, 2):
        if len(row) != len(head):
            raise ScoreError(f"{path}:{number}: {len(row)} values, expected {len(head)}; the file may be truncated, write it again")
    columns = list(zip(*rows)) or [()] * len(head)
    return Table({name: _array(path, name, column) for name, column in zip(head, columns)})


def _array(path: str | Path, name: str, column: Sequence[str]) -> Array:
    if name in TEXT_COLUMNS:
        return np.array(column, dtype=str)
    numbers = np.empty(len(column))
    for index, text in enumerate(column):
        try:
            numbers[index] = float(text)
        except ValueError:
            raise ScoreError(f"{path}:{index + 2}: {name} is {text!r}, expected a number; write the table again") from None
    return numbers


def read_scores(text: str) -> dict[str, Any]:
    """Parses the JSON object on the last line of the output of `plumb score … --json`."""
    last = (text.strip().splitlines() or [""])[-1]
    try:
        scores = json.loads(last)
    except json.JSONDecodeError:
        scores = None
    if not isinstance(scores, dict) or "stages" not in scores:
        raise ScoreError(f"no scores on the last line, found {last[:90]!r}; pass the standard output of `plumb score … --json`")
    return scores


@dataclass(frozen=True)
class Run:
    """Result of `plumb score`: the scores, and the folder with the tables."""

    scores: dict[str, Any]
    folder: Path | None

    def stage(self, fuser: str) -> dict[str, Any]:
        """Returns the scores of a fuser, with `trials` and `mean`."""
        fusers = [stage["fuser"] for stage in self.scores["stages"]]
        if fuser not in fusers:
            raise ScoreError(f"no fuser {fuser} in this run; available: {', '.join(fusers)}")
        return self.scores["stages"][fusers.index(fuser)]

    def to_pandas(self) -> pandas.DataFrame:
        """Returns the scores as a DataFrame with one row per fuser and trial, indexed by both."""
        frame = _pandas().json_normalize(self.scores["stages"], "trials", "fuser")
        return frame.rename(columns={"name": "trial"}).set_index(["fuser", "trial"])

    def table(self, fuser: str, trial: str = "*") -> Table:
        """Returns the table of a fuser. With several trials, `trial` is the file name without `.csv`."""
        if self.folder is None:
            raise ScoreError("no tables were written; pass `folder` to `run`")
        self.stage(fuser)
        folder = self.folder / fuser if len(self.scores["stages"]) > 1 else self.folder
        files = sorted(folder.glob(f"{trial}.csv"))
        if len(files) != 1:
            names = ", ".join(file.stem for file in files[:9])
            raise ScoreError(f"{folder}: {len(files)} tables of {fuser}, expected one; set `trial` to one of: {names}")
        return read_table(files[0])

    def curve(self, fuser: str, setting: str, error: str = "inclination") -> tuple[Array, Array]:
        """Returns the values of a setting that was given as `a..b`, and the error of a fuser at each value."""
        for swept in self.scores["swept"]:
            if (swept["fuser"], swept["setting"]) == (fuser, setting):
                points = swept["curve"]
                return tuple(np.array([point[name] for point in points], dtype=float) for name in ("value", error))
        raise ScoreError(f"no range of {setting} for {fuser}; pass one to `run`, as settings={{'{setting}': 'a..b'}}")


def run(plumb: str | Path, files: Sequence[str], fusers: Sequence[str] = (), folder: str | Path | None = None,
        settings: Mapping[str, float | str] | None = None, options: Sequence[str] = ()) -> Run:
    """Runs `plumb score` on recordings or simulations. If `folder` is given, the tables are written to it. It should be empty."""
    selected = [f"--fuser={fuser}" for fuser in fusers] + [f"--set={key}={value}" for key, value in (settings or {}).items()]
    tables = [] if folder is None else [f"--csv={folder}"]
    command = [str(plumb), "score", *files, *selected, *tables, *options, "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", stdin=subprocess.DEVNULL)
    except OSError as cause:
        raise ScoreError(f"{plumb}: cannot start: {cause}; build it with `cargo build --release`") from cause
    if done.returncode:
        raise ScoreError(f"{' '.join(command)} exited with {done.returncode}: {done.stderr.strip()}")
    return Run(read_scores(done.stdout), None if folder is None else Path(folder))
