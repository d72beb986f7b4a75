"""Line charts as SVG for notebooks. Requires only numpy.

Input: named curves, each as two arrays.
Output: a drawing that a notebook displays.
Failure: `nan` points are left out; `ValueError` if no curve has a finite point.
"""

from __future__ import annotations

from html import escape
from typing import Any, Mapping

import numpy as np
from numpy.typing import NDArray

Curve = tuple[NDArray[Any], NDArray[Any]]

WIDTH, HEIGHT = 640, 320
LEFT, RIGHT, TOP, BOTTOM = 70, 620, 20, 270
COLORS = ("#CC79A7", "#E69F00", "#0072B2", "#000000")
# Maximum number of points per curve, the width of the plot in pixels.
MAX_POINTS = 550


class Picture:
    """Line chart of several curves; `text` is the SVG."""

    def __init__(self, curves: Mapping[str, Curve], x_label: str, y_label: str):
        finite = {name: [axis[np.isfinite(x) & np.isfinite(y)] for axis in (x, y)] for name, (x, y) in curves.items()}
        if not any(x.size for x, _ in finite.values()):
            raise ValueError(f"drawing {', '.join(curves) or 'no curve'}: no finite value; check that the trial has a reference")
        (left, right), (low, high) = [_range(np.concatenate(axis)) for axis in zip(*finite.values())]
        parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" style="font: 12px sans-serif">']
        parts.append(f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>')
        parts.append(f'<path d="M{LEFT} {TOP}V{BOTTOM}H{RIGHT}" fill="none" stroke="gray"/>')
        for index, (name, (x, y)) in enumerate(finite.items()):
            step, color = max(1, -(-x.size // MAX_POINTS)), COLORS[index % len(COLORS)]
            pixel_x = LEFT + (x[::step] - left) / (right - left) * (RIGHT - LEFT)
            pixel_y = BOTTOM - (y[::step] - low) / (high - low) * (BOTTOM - TOP)
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(pixel_x, pixel_y))
            parts.append(f'<polyline points="{points}" fill="none" stroke="{color}"/>')
            parts.append(_label(LEFT + 10 + 135 * index, TOP + 12, name, color=color))
        parts += [_label(LEFT, BOTTOM + 16, f"{left:.4g}"), _label(RIGHT, BOTTOM + 16, f"{right:.4g}", "end")]
        parts += [_label(LEFT - 6, BOTTOM, f"{low:.3g}", "end"), _label(LEFT - 6, TOP + 10, f"{high:.3g}", "end")]
        parts += [_label((LEFT + RIGHT) // 2, BOTTOM + 36, x_label, "middle"), _label(LEFT, TOP - 6, y_label)]
        self.text = "\n".join([*parts, "</svg>\n"])

    def _repr_svg_(self) -> str:
        return self.text


def _range(values: NDArray[Any]) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return (low, high) if low < high else (low - 0.5, high + 0.5)


def _label(x: int, y: int, text: str, anchor: str = "start", color: str = "black") -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="{color}">{escape(text)}</text>'
