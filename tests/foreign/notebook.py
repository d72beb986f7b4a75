"""Runs the cells of a notebook in its folder, in order, with numpy but without Jupyter.

    python tests/foreign/notebook.py docs/reference/s1.ipynb

The results are compared with those of `plumb score`. The names of the executed cells and of those
with a picture are printed as one line of JSON.
"""

import ast
import json
import os
import re
import sys
from pathlib import Path

import numpy as np


def code_cells(path):
    """Returns the name and code of each code cell. Checks that no outputs are stored."""
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


def run_cell(source, name, space):
    """Runs a cell and returns the value that a notebook would display: its last expression."""
    tree = ast.parse(source, name)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, name, "exec"), space)
    return eval(compile(ast.Expression(last.value), name, "eval"), space) if last else None


def main(path):
    path = Path(path).resolve()
    cells = code_cells(path)
    os.chdir(path.parent)
    space = {}
    values = {name: run_cell(source, name, space) for name, source in cells}
    assert not {"matplotlib", "pandas", "IPython"} & set(sys.modules)
    pictures = {name: value._repr_svg_() for name, value in values.items() if value is not None}
    for name, picture in pictures.items():
        assert picture.startswith("<svg ") and picture.endswith("</svg>\n") and "nan" not in picture, name

    s1, tables, errors, w = (space[name] for name in ["s1", "tables", "errors", "w"])
    for fuser, table in tables.items():
        trial = s1.stage(fuser)["trials"][0]
        assert table.quaternion().shape == (trial["ticks"], 4) and table.scored.sum() == trial["scored"]
        assert all(len(column) == trial["ticks"] for column in table.columns.values())
        for name, error in errors[fuser].items():
            assert (trial[name] is None) == (name in ("total", "heading", "yaw", "course")), (fuser, name)
            assert trial[name] is None and np.isnan(error) or abs(error - trial[name]) < 1e-9, (fuser, name, error, trial[name])
        ratios = table.normalised()["inclination"][table.scored]
        quantiles = trial["normalised"]["inclination"]
        for probability, ratio in [(0.68, quantiles["quantile_68"]), (0.95, quantiles["quantile_95"])]:
            assert abs(np.quantile(ratios, probability) / ratio - 1.0) < 0.011, (fuser, probability)
    inclination = {fuser: error["inclination"] for fuser, error in errors.items()}
    assert 0.1 < inclination["wz-closed"] < inclination["wz-open"] < 0.25 and inclination["wz"] < 0.06, inclination

    # The accelerometer alone is noisy, the gyro alone drifts, and the fused estimate beats both.
    error_w = {name: np.abs(point - w["true"]) for name, point in w.items()}
    step = {name: np.abs(np.diff(point - w["true"])).mean() for name, point in w.items()}
    assert step["accelerometer"] > 10.0 * max(step["gyro"], step["fused"]), "accelerometer"
    assert error_w["gyro"][-1000:].mean() > 10.0 * error_w["gyro"][:1000].mean() and error_w["gyro"][-1] > 0.05, "gyro"
    assert all(error_w["fused"].mean() < 0.5 * error_w[name].mean() for name in ["accelerometer", "gyro"])

    for fuser, (value_s, error_deg) in space["curves"].items():
        assert (len(value_s), value_s[0], value_s[-1]) == (25, 0.1, 10.0)
        assert abs(error_deg[value_s == 1.0][0] - inclination[fuser]) < 1e-9, "the default value yields the same error"
        assert error_deg.min() < error_deg[[0, -1]].min(), "the minimum lies inside the range"
    print(json.dumps({"cells": [name for name, _ in cells], "pictures": sorted(pictures)}))


main(*sys.argv[1:])
