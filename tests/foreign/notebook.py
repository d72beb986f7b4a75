"""Runs a notebook as its reader would, cell after cell in its own folder, with numpy and nothing of a notebook's programs.

    python tests/foreign/notebook.py docs/s1.ipynb

What it shows is held against what `plumb score` itself tells. A line of JSON says what was run.
"""

import ast
import json
import os
import re
import sys
from pathlib import Path

import numpy as np


def cells_of(path):
    """The code of each cell that has some, of a notebook of ten cells and without outputs."""
    notebook = json.loads(path.read_text("utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert set(notebook) == {"cells", "metadata", "nbformat", "nbformat_minor"}
    cells = notebook["cells"]
    names = [cell["id"] for cell in cells]
    assert len(cells) == 10 and len(set(names)) == 10, names
    assert all(re.fullmatch("[a-zA-Z0-9_-]{1,64}", name) for name in names), names
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code), "stored with outputs"
    return [(cell["id"], "".join(cell["source"])) for cell in code]


def shown(source, name, space):
    """Runs a cell; the value of its last line, which a notebook shows."""
    tree = ast.parse(source, name)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, name, "exec"), space)
    return eval(compile(ast.Expression(last.value), name, "eval"), space) if last else None


def main(path):
    path = Path(path).resolve()
    cells = cells_of(path)
    os.chdir(path.parent)
    space = {}
    values = {name: shown(source, name, space) for name, source in cells}
    assert not {"matplotlib", "pandas", "IPython"} & set(sys.modules)
    pictures = {name: value._repr_svg_() for name, value in values.items() if value is not None}
    for name, picture in pictures.items():
        assert picture.startswith("<svg ") and picture.endswith("</svg>\n") and "nan" not in picture, name

    s1, tables, errors, w = (space[name] for name in ["s1", "tables", "errors", "w"])
    for fuser, table in tables.items():
        told = s1.stage(fuser)["trials"][0]
        assert table.quaternion().shape == (told["ticks"], 4) and table.scored.sum() == told["scored"]
        assert all(len(column) == told["ticks"] for column in table.columns.values())
        for name, error in errors[fuser].items():
            assert (told[name] is None) == (name in ("total", "heading", "yaw", "course")), (fuser, name)
            assert told[name] is None and np.isnan(error) or abs(error - told[name]) < 1e-9, (fuser, name, error, told[name])
        ratios = table.normalised()["inclination"][table.scored]
        quantiles = told["normalised"]["inclination"]
        for part, ratio in [(0.68, quantiles["quantile_68"]), (0.95, quantiles["quantile_95"])]:
            assert abs(np.quantile(ratios, part) / ratio - 1.0) < 0.011, (fuser, part)
    inclination = {fuser: error["inclination"] for fuser, error in errors.items()}
    assert 0.1 < inclination["wz-closed"] < inclination["wz-open"] < 0.25 and inclination["wz"] < 0.06, inclination

    # The accelerometer alone scatters, the gyro alone drifts, and fused is nearer to the truth than either.
    off = {name: np.abs(point - w["true"]) for name, point in w.items()}
    step = {name: np.abs(np.diff(point - w["true"])).mean() for name, point in w.items()}
    assert step["accelerometer"] > 10.0 * max(step["gyro"], step["fused"]), "accelerometer"
    assert off["gyro"][-1000:].mean() > 10.0 * off["gyro"][:1000].mean() and off["gyro"][-1] > 0.05, "gyro"
    assert all(off["fused"].mean() < 0.5 * off[name].mean() for name in ["accelerometer", "gyro"])

    for fuser, (value_s, off_deg) in space["curves"].items():
        assert (len(value_s), value_s[0], value_s[-1]) == (25, 0.1, 10.0)
        assert abs(off_deg[value_s == 1.0][0] - inclination[fuser]) < 1e-9, "the value before"
        assert off_deg.min() < off_deg[[0, -1]].min(), "the least is inside"
    print(json.dumps({"cells": [name for name, _ in cells], "pictures": sorted(pictures)}))


main(*sys.argv[1:])
