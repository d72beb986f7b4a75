"""What `plumb score` tells, as numpy arrays: tables of every tick (`--csv DIR`) and scores (`--json`). Needs numpy alone.

Input: a table, standard output, or recordings and simulations to run over. Output: arrays with an element for each tick, in the
units of their names, errors in degrees; `nan` where something is not known. Time: the samples' own, s. Failure: `ScoreError`,
which names the place and the remedy.
"""

from __future__ import annotations

import json
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]

WORDS = ("chart", "course_reference", "heading_reference", "gyro_chart", "accel_chart", "true_chart")
ATTITUDE = ("qw", "qx", "qy", "qz", "chart", "u", "v", "z_rad", "yaw_rad", "pitch_rad", "roll_rad", "course_rad")
BIAS = ("bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s")
SENSORS = ("gyro_chart", "gyro_u", "gyro_v", "gyro_z_rad", "accel_chart", "accel_u", "accel_v")
COLUMNS = ("t_s", *ATTITUDE, "course_reference", *BIAS, "inclination_sd_rad", "course_sd_rad")
COLUMNS += ("heading_reference", "heading_sd_rad", *SENSORS, *("true_" + name for name in ATTITUDE + BIAS), "scored")
STEEPEST_RAD = math.radians(89.0)  # Nearer to the vertical a nose has no roll, yaw and course.


class ScoreError(ValueError):
    """What was read is not what `plumb score` writes, or it did not run to its end."""


def wrapped_deg(angle_rad: ArrayLike) -> Array:
    """Degrees in (-180, 180]: the short way round."""
    angle_deg = np.degrees(angle_rad)
    return angle_deg - 360.0 * np.ceil((angle_deg - 180.0) / 360.0)


def rms(values: Array, where: Array) -> float:
    """Root of the mean of the squares of what is known there; `nan` of nothing."""
    known = values[where & np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


@dataclass(frozen=True)
class Table:
    """What a chain of stages said at each tick, and the truth beside it: `table["roll_rad"]` is a column."""

    columns: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        if name not in self.columns:
            raise ScoreError(f"no column {name}; there are {', '.join(self.columns)}")
        return self.columns[name]

    @property
    def scored(self) -> Array:
        """The ticks that count."""
        return self["scored"] == 1.0

    def quaternion(self, of: str = "") -> Array:
        """w, x, y, z, body to earth, a row for each tick; of the stages, or `true_`."""
        return np.stack([self[f"{of}q{axis}"] for axis in "wxyz"], axis=1)

    def bias_rad_s(self, of: str = "") -> Array:
        """The gyro's bias in body axes, a row for each tick; as estimated, or `true_`."""
        return np.stack([self[f"{of}bias_{axis}_rad_s"] for axis in "xyz"], axis=1)

    def w(self, of: str = "") -> Array:
        """The up vector as the point u + jv of the upright chart; of the stages, `gyro_`, `accel_` or `true_`."""
        w = self[f"{of}u"] + 1j * self[f"{of}v"]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self[f"{of}chart"] == "inverted", 1.0 / w, w)

    def errors_deg(self) -> dict[str, Array]:
        """Estimate less truth, the short way round; of the whole, the inclination and the bias (°/s) the size.

        Yaw, `heading`, the turn about the vertical, and with it `total` drift where they are counted from nowhere; the course has no error then.
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
        steep = np.maximum(np.abs(self["pitch_rad"]), np.abs(self["true_pitch_rad"])) > STEEPEST_RAD
        for name in ("roll", "pitch", "yaw", "course"):
            lost = steep | (self["course_reference"] == "arbitrary") if name == "course" else steep
            errors[name] = np.where(lost, np.nan, wrapped_deg(self[f"{name}_rad"] - self[f"true_{name}_rad"]))
        errors["gyro_bias_deg_s"] = np.degrees(np.linalg.norm(self.bias_rad_s() - self.bias_rad_s("true_"), axis=1))
        return errors

    def rms(self) -> dict[str, float]:
        """Of each error over the ticks that count; `nan` for total, heading and yaw where they are counted from nowhere in the end."""
        known = self["heading_reference"] != "arbitrary"
        of_heading = ("total", "heading", "yaw") if not known[self.scored][-1:].all() else ()
        where = {"yaw": self.scored & known}
        of = {name: rms(error, where.get(name, self.scored)) for name, error in self.errors_deg().items()}
        return {name: math.nan if name in of_heading else error for name, error in of.items()}

    def normalised(self) -> dict[str, Array]:
        """Errors over the deviations told beside them, of a heading where it is counted from north. Ideal: 68 % of the inclination below 1.51, of heading and course below 1."""
        errors = self.errors_deg()
        errors["heading"] = np.where(self["heading_reference"] == "arbitrary", np.nan, errors["heading"])
        with np.errstate(divide="ignore", invalid="ignore"):
            return {name: errors[name] / np.degrees(self[f"{name}_sd_rad"]) for name in ("inclination", "heading", "course")}


def read_table(path: str | Path) -> Table:
    """Reads a table that `plumb score --csv DIR` wrote."""
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise ScoreError(f"{path}: {cause}; name a file that `plumb score --csv DIR` wrote") from cause
    head = lines[0].split(",") if lines else []
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise ScoreError(f"{path}:1: no column {', '.join(missing)}; write the table again by this version")
    rows = [line.split(",") for line in lines[1:]]
    for number, row in enumerate(rows, 2):
        if len(row) != len(head):
            raise ScoreError(f"{path}:{number}: {len(row)} values under {len(head)} names; was the file cut? Write it again")
    columns = list(zip(*rows)) or [()] * len(head)
    return Table({name: _array(path, name, column) for name, column in zip(head, columns)})


def _array(path: str | Path, name: str, column: Sequence[str]) -> Array:
    if name in WORDS:
        return np.array(column, dtype=str)
    numbers = np.empty(len(column))
    for at, text in enumerate(column):
        try:
            numbers[at] = float(text)
        except ValueError:
            raise ScoreError(f"{path}:{at + 2}: {name} is {text!r}, which is no number; write the table again") from None
    return numbers


def read_scores(text: str) -> dict[str, Any]:
    """Reads the object on the last line of what `plumb score … --json` printed."""
    last = (text.strip().splitlines() or [""])[-1]
    try:
        scores = json.loads(last)
    except json.JSONDecodeError:
        scores = None
    if not isinstance(scores, dict) or "stages" not in scores:
        raise ScoreError(f"no scores on the last line, but {last[:90]!r}; read the standard output of `plumb score … --json`")
    return scores


@dataclass(frozen=True)
class Run:
    """A run of `plumb score`: the scores as it tells them, and the folder with its tables."""

    scores: dict[str, Any]
    folder: Path | None

    def stage(self, fuser: str) -> dict[str, Any]:
        """The scores of a fuser: its `trials`, and their `mean`."""
        fusers = [stage["fuser"] for stage in self.scores["stages"]]
        if fuser not in fusers:
            raise ScoreError(f"no fuser {fuser}; this run has {', '.join(fusers)}")
        return self.scores["stages"][fusers.index(fuser)]

    def table(self, fuser: str, trial: str = "*") -> Table:
        """The table of a fuser; of several trials the one whose file has that name, without `.csv`."""
        if self.folder is None:
            raise ScoreError("no tables were written; give `run` a folder")
        self.stage(fuser)
        folder = self.folder / fuser if len(self.scores["stages"]) > 1 else self.folder
        files = sorted(folder.glob(f"{trial}.csv"))
        if len(files) != 1:
            names = ", ".join(file.stem for file in files[:9])
            raise ScoreError(f"{folder}: {len(files)} tables of {fuser}, not one; name one of these: {names}")
        return read_table(files[0])

    def curve(self, fuser: str, setting: str, error: str = "inclination") -> tuple[Array, Array]:
        """The values of a setting that was given as `a..b`, and the error of a fuser at each."""
        for swept in self.scores["swept"]:
            if (swept["fuser"], swept["setting"]) == (fuser, setting):
                points = swept["curve"]
                return tuple(np.array([point[name] for point in points], dtype=float) for name in ("value", error))
        raise ScoreError(f"no range of {setting} for {fuser}; give `run` one, as settings={{'{setting}': 'a..b'}}")


def run(plumb: str | Path, files: Sequence[str], fusers: Sequence[str] = (), folder: str | Path | None = None,
        settings: Mapping[str, float | str] | None = None, options: Sequence[str] = ()) -> Run:
    """Runs `plumb score` over recordings or simulations; the tables go to an empty folder, where one is given."""
    chosen = [f"--fuser={fuser}" for fuser in fusers] + [f"--set={key}={value}" for key, value in (settings or {}).items()]
    tables = [] if folder is None else [f"--csv={folder}"]
    command = [str(plumb), "score", *files, *chosen, *tables, *options, "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", stdin=subprocess.DEVNULL)
    except OSError as cause:
        raise ScoreError(f"{plumb}: cannot be started: {cause}; build it with `cargo build --release`") from cause
    if done.returncode:
        raise ScoreError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.strip()}")
    return Run(read_scores(done.stdout), None if folder is None else Path(folder))
